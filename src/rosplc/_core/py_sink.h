/* What Python sees of a rosplc_sink: the same for all of them. Include after Python.h. */
#ifndef ROSPLC_PY_SINK_H
#define ROSPLC_PY_SINK_H

#include <string.h>

#include "sink.h"

/* The head of every object that is a sink. */
typedef struct {
    PyObject_HEAD
    rosplc_sink sink;
} SinkObject;

static int sink_init(SinkObject *self, int (*pass)(rosplc_sink *, const uint8_t *, size_t, int64_t))
{
    self->sink.pass = pass;
    if (pthread_mutex_init(&self->sink.mutex, NULL)) {
        self->sink.pass = NULL;
        PyErr_NoMemory();
        return -1;
    }
    return 0;
}

static void sink_fini(SinkObject *self)
{
    if (self->sink.pass)
        pthread_mutex_destroy(&self->sink.mutex);
}

static void sink_open(SinkObject *self, int64_t limit_ns)
{
    self->sink.limit_ns = limit_ns;
    self->sink.last_ns = rosplc_sink_now();
    self->sink.open = 1;
}

/* Once this returns, nothing is passed on until it is opened again. */
static void sink_close(SinkObject *self)
{
    pthread_mutex_lock(&self->sink.mutex);
    self->sink.open = 0;
    pthread_mutex_unlock(&self->sink.mutex);
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

#define SINK_ATTRIBUTES \
    {"capsule", (getter)sink_capsule, NULL, "What another extension module puts messages into.", NULL}, \
    {"messages", (getter)sink_messages, NULL, "Messages passed on.", NULL}, \
    {"last_ns", (getter)sink_last_ns, NULL, "Monotonic time of the last one, or of open().", NULL}

#endif
