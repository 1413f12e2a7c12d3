/* What Python sees of a rosplc_sink: the same for all of them. Include after Python.h. */
#ifndef ROSPLC_PY_SINK_H
#define ROSPLC_PY_SINK_H

#include <string.h>

#include "py_type.h"
#include "sink.h"

enum { SINK_LONG = 256 * 1024 }; /* bytes from which on a copy releases the GIL: below, that costs more than it gives */

/* The head of every object that is a sink. */
typedef struct {
    PyObject_HEAD
    rosplc_sink sink;
} SinkObject;

static void *sink_new(PyTypeObject *type, int (*pass)(rosplc_sink *, const uint8_t *, size_t, int64_t))
{
    SinkObject *self = py_allocate(type);
    if (self && pthread_mutex_init(&self->sink.mutex, NULL)) {
        py_release(self);
        return PyErr_NoMemory();
    }
    if (self)
        self->sink.pass = pass;
    return self;
}

static void sink_dealloc(SinkObject *self)
{
    pthread_mutex_destroy(&self->sink.mutex);
    py_release(self);
}

/* The object that a sink is in. */
static void *sink_object(rosplc_sink *sink)
{
    return (char *)sink - offsetof(SinkObject, sink);
}

static void sink_open(SinkObject *self, int64_t limit_ns)
{
    pthread_mutex_lock(&self->sink.mutex); /* what pass() needs has been set before */
    self->sink.limit_ns = limit_ns;
    self->sink.last_ns = rosplc_sink_now();
    self->sink.open = 1;
    pthread_mutex_unlock(&self->sink.mutex);
}

/* Once this returns, nothing is passed on until it is opened again. */
static void sink_close(SinkObject *self)
{
    pthread_mutex_lock(&self->sink.mutex);
    self->sink.open = 0;
    pthread_mutex_unlock(&self->sink.mutex);
}

static inline PyObject *sink_stop(SinkObject *self, PyObject *unused)
{
    (void)unused;
    sink_close(self);
    Py_RETURN_NONE;
}

static rosplc_sink sink_look(SinkObject *self)
{
    rosplc_sink seen;
    pthread_mutex_lock(&self->sink.mutex);
    memcpy(&seen, &self->sink, sizeof seen);
    pthread_mutex_unlock(&self->sink.mutex);
    return seen;
}

static void sink_let_go(PyObject *capsule)
{
    Py_XDECREF((PyObject *)PyCapsule_GetContext(capsule));
}

static PyObject *sink_capsule(SinkObject *self, void *unused)
{
    PyObject *capsule = PyCapsule_New(&self->sink, ROSPLC_SINK, sink_let_go);
    (void)unused;
    if (capsule && !PyCapsule_SetContext(capsule, self))
        Py_INCREF((PyObject *)self);
    return capsule;
}

static PyObject *sink_messages(SinkObject *self, void *unused)
{
    (void)unused;
    return PyLong_FromUnsignedLongLong(sink_look(self).messages);
}

static PyObject *sink_last_ns(SinkObject *self, void *unused)
{
    (void)unused;
    return PyLong_FromLongLong(sink_look(self).last_ns);
}

/* A message for Python. Other threads go on while a long one is copied, which has to stay in its place meanwhile. */
static inline PyObject *sink_bytes(const void *message, size_t size)
{
    PyObject *bytes = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)size);
    char *to = bytes ? PyBytes_AsString(bytes) : NULL;
    if (to && size < SINK_LONG) {
        memcpy(to, message, size);
    } else if (to) {
        Py_BEGIN_ALLOW_THREADS;
        memcpy(to, message, size);
        Py_END_ALLOW_THREADS;
    }
    return bytes;
}

/* What is in the tables of the types. */
#define SINK_CLOSE {"close", (PyCFunction)sink_stop, METH_NOARGS, "Pass nothing on any more."}
#define SINK_ATTRIBUTES \
    {"capsule", (getter)sink_capsule, NULL, "What another extension module puts messages into.", NULL}, \
    {"messages", (getter)sink_messages, NULL, "Messages passed on.", NULL}, \
    {"last_ns", (getter)sink_last_ns, NULL, "Monotonic time of the last one, or of open().", NULL}
#define SINK_SLOTS(doc, make, end, methods, attributes) \
    { \
        {Py_tp_doc, doc}, {Py_tp_new, (void *)make}, {Py_tp_dealloc, (void *)end}, {Py_tp_methods, (void *)methods}, \
            {Py_tp_getset, (void *)attributes}, {0, NULL}, \
    }

#endif
