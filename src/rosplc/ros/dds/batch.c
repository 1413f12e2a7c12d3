/* rosplc.ros.dds._batch: messages between DDS and sinks (_core/sink.h) without Python work for each of them.
 *
 * The cyclonedds wheel comes without headers. What is used of its C library is declared here as in dds.h of the
 * release that native.py names; load() finds it in the library that the wheel has loaded, and native.py tries it out
 * before it is used.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <dlfcn.h>
#include <stdbool.h>
#include <stddef.h>
#include <sys/uio.h>

#include "py_sink.h"

typedef struct {
    uint32_t sample_state, view_state, instance_state;
    bool valid_data;
    int64_t source_timestamp;
    uint64_t instance_handle, publication_handle;
    uint32_t disposed_generation_count, no_writers_generation_count;
    uint32_t sample_rank, generation_rank, absolute_generation_rank;
} dds_sample_info;

typedef struct ddsi_serdata ddsi_serdata; /* opaque: a message, serialized */
typedef struct ddsi_sertype ddsi_sertype;
typedef int32_t (*collector)(void *, const dds_sample_info *, const ddsi_sertype *, ddsi_serdata *);

/* A sample of a type of the wheel's (clayer/pysertype.c). */
typedef struct {
    void *data;
    size_t size;
} wheel_sample;

enum { ANY_STATE = 127, BATCH = 256, MOST_KEYS = 1 << 20 };

static struct {
    int32_t (*waitset_wait)(int32_t waitset, intptr_t *keys, size_t room, int64_t timeout_ns);
    int32_t (*take)(int32_t reader, uint32_t most, uint64_t instance, uint32_t mask, collector, void *);
    int32_t (*write_ts)(int32_t writer, const void *sample, int64_t stamp_ns);
    int32_t (*take_status)(int32_t entity, uint32_t *status, uint32_t mask);
    uint32_t (*size)(const ddsi_serdata *);
    ddsi_serdata *(*ref)(const ddsi_serdata *, size_t at, size_t size, struct iovec *);
    void (*unref)(ddsi_serdata *, const struct iovec *);
} dds;

static PyObject *batch_load(PyObject *module, PyObject *args)
{
    static const struct {
        const char *name;
        void *place;
    } needed[] = {
        {"dds_waitset_wait", &dds.waitset_wait},
        {"dds_take_with_collector", &dds.take},
        {"dds_write_ts", &dds.write_ts},
        {"dds_take_status", &dds.take_status},
        {"ddsi_serdata_size", &dds.size},
        {"ddsi_serdata_to_ser_ref", &dds.ref},
        {"ddsi_serdata_to_ser_unref", &dds.unref},
    };
    const char *path;
    void *library;
    (void)module;
    if (!PyArg_ParseTuple(args, "s:load", &path))
        return NULL;
    library = dlopen(path, RTLD_NOW | RTLD_NOLOAD);
    if (!library)
        return PyErr_Format(PyExc_OSError, "%s is not loaded", path);
    for (size_t i = 0; i < sizeof needed / sizeof *needed; i++) {
        void *found = dlsym(library, needed[i].name);
        if (!found)
            return PyErr_Format(PyExc_OSError, "%s has no %s", path, needed[i].name);
        memcpy(needed[i].place, &found, sizeof found);
    }
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------- from DDS */

typedef struct {
    ddsi_serdata *data;
    struct iovec bytes;
    int64_t stamp_ns;
} message;

typedef struct {
    int32_t reader; /* 0: a free entry */
    PyObject *capsule;
    rosplc_sink *sink;
} Entry;

typedef struct {
    intptr_t key;
    message message;
} Left;

typedef struct {
    PyObject_HEAD
    pthread_mutex_t mutex; /* guards the table; nobody waits for the GIL while holding it */
    int ready;
    Entry *entries; /* by key */
    size_t room;
    intptr_t *keys;
    size_t keys_room;
    int waits; /* whether a thread is in wait(), to which all that follows belongs */
    message batch[BATCH];
    int batch_count;
    Left left[BATCH]; /* what no sink took */
    int left_count;
} InletObject;

static PyObject *inlet_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {NULL};
    InletObject *self;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, ":Inlet", names))
        return NULL;
    if (!dds.unref)
        return PyErr_Format(PyExc_RuntimeError, "load() comes first");
    self = py_allocate(type);
    if (!self)
        return NULL;
    if (pthread_mutex_init(&self->mutex, NULL)) {
        Py_DECREF((PyObject *)self);
        return PyErr_NoMemory();
    }
    self->ready = 1;
    return (PyObject *)self;
}

static void inlet_dealloc(InletObject *self)
{
    for (size_t key = 0; key < self->room; key++)
        Py_XDECREF(self->entries[key].capsule);
    PyMem_Free(self->entries);
    PyMem_Free(self->keys);
    if (self->ready)
        pthread_mutex_destroy(&self->mutex);
    py_release(self);
}

/* Puts an entry, whose reference passes, into the table; lets go of the one before. */
static void inlet_set(InletObject *self, size_t key, Entry entry)
{
    Entry before;
    Py_BEGIN_ALLOW_THREADS;
    pthread_mutex_lock(&self->mutex);
    before = self->entries[key];
    self->entries[key] = entry;
    pthread_mutex_unlock(&self->mutex);
    Py_END_ALLOW_THREADS;
    Py_XDECREF(before.capsule);
}

static PyObject *inlet_add(InletObject *self, PyObject *args)
{
    Py_ssize_t key;
    int reader;
    PyObject *capsule;
    rosplc_sink *sink;
    if (!PyArg_ParseTuple(args, "niO:add", &key, &reader, &capsule)
        || !(sink = PyCapsule_GetPointer(capsule, ROSPLC_SINK)))
        return NULL;
    if (key < 0 || key >= MOST_KEYS || reader <= 0)
        return PyErr_Format(PyExc_ValueError, "a key must be between 0 and %d, and a reader greater than 0", MOST_KEYS - 1);
    if ((size_t)key >= self->room) {
        size_t room = 2 * (size_t)key + 16;
        Entry *grown = PyMem_Calloc(room, sizeof *grown), *old;
        if (!grown)
            return PyErr_NoMemory();
        pthread_mutex_lock(&self->mutex);
        old = self->entries;
        if (old)
            memcpy(grown, old, self->room * sizeof *grown);
        self->entries = grown;
        self->room = room;
        pthread_mutex_unlock(&self->mutex);
        PyMem_Free(old);
    }
    Py_INCREF(capsule);
    inlet_set(self, (size_t)key, (Entry){reader, capsule, sink});
    Py_RETURN_NONE;
}

static PyObject *inlet_remove(InletObject *self, PyObject *args)
{
    Py_ssize_t key;
    if (!PyArg_ParseTuple(args, "n:remove", &key))
        return NULL;
    if (key >= 0 && (size_t)key < self->room)
        inlet_set(self, (size_t)key, (Entry){0, NULL, NULL});
    Py_RETURN_NONE;
}

/* Called by the library under a lock of its own: keeps a reference, and no more. */
static int32_t collect(void *argument, const dds_sample_info *info, const ddsi_sertype *type, ddsi_serdata *data)
{
    InletObject *self = argument;
    message *one = &self->batch[self->batch_count];
    (void)type;
    if (!info->valid_data) /* a peer has gone: no message */
        return 0;
    if (self->batch_count == BATCH)
        return -1;
    one->data = dds.ref(data, 0, dds.size(data), &one->bytes);
    one->stamp_ns = info->source_timestamp;
    self->batch_count++;
    return 0;
}

/* Passes on what a reader has. Returns 0 if that is for Python to do: the reader has no open sink. */
static int inlet_pass(InletObject *self, intptr_t key)
{
    int found, mine = 0;
    pthread_mutex_lock(&self->mutex);
    if (key >= 0 && (size_t)key < self->room && self->entries[key].reader) {
        Entry *entry = &self->entries[key];
        mine = __atomic_load_n(&entry->sink->open, __ATOMIC_RELAXED);
        found = mine ? dds.take(entry->reader, BATCH, 0, ANY_STATE, collect, self) : 0;
        mine = mine && found >= 0; /* Python meets the error again, and reports it */
        int left = 0;
        for (int i = 0; i < self->batch_count; i++) {
            message *one = &self->batch[i];
            left = left || rosplc_sink_put(entry->sink, one->bytes.iov_base, one->bytes.iov_len, one->stamp_ns);
            if (left) /* this one and, to keep their order, those behind it */
                self->left[self->left_count++] = (Left){key, *one};
            else
                dds.unref(one->data, &one->bytes);
        }
        self->batch_count = 0;
    }
    pthread_mutex_unlock(&self->mutex);
    return mine;
}

/* A new list of numbers; NULL with an exception. */
static PyObject *numbers(const intptr_t *values, Py_ssize_t count)
{
    PyObject *list = PyList_New(0);
    for (Py_ssize_t i = 0; list && i < count; i++) {
        PyObject *value = PyLong_FromSsize_t(values[i]);
        if (!value || PyList_Append(list, value))
            Py_CLEAR(list);
        Py_XDECREF(value);
    }
    return list;
}

/* The messages that no sink took, as a list; their references are given up. NULL with an exception. */
static PyObject *inlet_left(InletObject *self)
{
    PyObject *list = PyList_New(0);
    for (int i = 0; i < self->left_count; i++) {
        Left *one = &self->left[i];
        PyObject *item = list ? sink_bytes(one->message.bytes.iov_base, one->message.bytes.iov_len) : NULL;
        if (item)
            item = Py_BuildValue("(nNL)", (Py_ssize_t)one->key, item, (long long)one->message.stamp_ns);
        if (list && (!item || PyList_Append(list, item)))
            Py_CLEAR(list);
        Py_XDECREF(item);
        dds.unref(one->message.data, &one->message.bytes);
    }
    self->left_count = 0;
    return list;
}

static PyObject *inlet_wait(InletObject *self, PyObject *args)
{
    int waitset;
    Py_ssize_t room;
    long long timeout_ns;
    int64_t deadline;
    PyObject *keys, *messages;
    int count = 0, others = 0;
    if (!PyArg_ParseTuple(args, "inL:wait", &waitset, &room, &timeout_ns))
        return NULL;
    if (room < 1 || room > MOST_KEYS || timeout_ns < 0)
        return PyErr_Format(PyExc_ValueError, "room must be 1 to %d keys, and the timeout not negative", MOST_KEYS);
    if (self->waits)
        return PyErr_Format(PyExc_RuntimeError, "another thread is already waiting");
    if ((size_t)room > self->keys_room) {
        intptr_t *grown = PyMem_Realloc(self->keys, 2 * (size_t)room * sizeof *grown);
        if (!grown)
            return PyErr_NoMemory();
        self->keys = grown;
        self->keys_room = 2 * (size_t)room;
    }
    deadline = rosplc_sink_now();
    deadline = timeout_ns > INT64_MAX - deadline ? INT64_MAX : deadline + timeout_ns;
    self->waits = 1;
    Py_BEGIN_ALLOW_THREADS;
    for (int64_t now = 0; !others && !self->left_count && now < deadline; now = rosplc_sink_now()) {
        count = dds.waitset_wait(waitset, self->keys, self->keys_room, now ? deadline - now : timeout_ns);
        if (count > 0 && (size_t)count > self->keys_room)
            count = (int)self->keys_room;
        for (int i = 0; i < count; i++) {
            intptr_t key = self->keys[i];
            /* What is left fits into its table once: the readers behind it keep theirs, and are reported again. */
            if (self->left_count)
                break;
            if (!inlet_pass(self, key))
                self->keys[others++] = key;
        }
        if (count < 0)
            break;
    }
    Py_END_ALLOW_THREADS;
    messages = inlet_left(self);
    keys = numbers(self->keys, others);
    self->waits = 0;
    if (!keys || !messages) {
        Py_XDECREF(keys);
        Py_XDECREF(messages);
        return NULL;
    }
    return Py_BuildValue("(NN)", keys, messages);
}

static PyMethodDef inlet_methods[] = {
    {"add", (PyCFunction)inlet_add, METH_VARARGS,
     "add(key, reader, capsule): put what the reader with that key receives into a sink."},
    {"remove", (PyCFunction)inlet_remove, METH_VARARGS, "remove(key): once this returns, the sink is not used."},
    {"wait", (PyCFunction)inlet_wait, METH_VARARGS,
     "wait(waitset, room, timeout_ns) -> (keys, messages): sleep, and pass on what sinks take, until something else"
     " is ready, or until the time is over. messages: (key, payload, stamp_ns), which the sinks did not take."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot inlet_slots[] = {
    {Py_tp_doc, "Inlet(): what has arrived for many readers, into their sinks, in one call; for one thread."},
    {Py_tp_new, (void *)inlet_new},
    {Py_tp_dealloc, (void *)inlet_dealloc},
    {Py_tp_methods, inlet_methods},
    {0, NULL},
};

static PyType_Spec inlet_spec = {"rosplc.ros.dds._batch.Inlet", sizeof(InletObject), 0, Py_TPFLAGS_DEFAULT,
                                 inlet_slots};

/* ---------------------------------------------------------------- to DDS */

typedef struct {
    SinkObject head;
    int32_t writer;
    size_t most; /* bytes of the largest message that is nothing special */
} OutletObject;

static int outlet_pass(rosplc_sink *base, const uint8_t *wire, size_t size, int64_t stamp_ns)
{
    OutletObject *self = sink_object(base);
    wheel_sample sample = {(void *)(uintptr_t)wire, (size + 3) & ~(size_t)3}; /* as ROS 2 does: whole words */
    return sample.size > self->most || dds.write_ts(self->writer, &sample, stamp_ns) < 0;
}

static PyObject *outlet_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"writer", NULL};
    OutletObject *self;
    int writer;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "i:Outlet", names, &writer))
        return NULL;
    if (!dds.unref)
        return PyErr_Format(PyExc_RuntimeError, "load() comes first");
    self = sink_new(type, outlet_pass);
    if (self)
        self->writer = writer;
    return (PyObject *)self;
}

static PyObject *outlet_open(OutletObject *self, PyObject *args)
{
    long long limit_ns;
    Py_ssize_t most;
    if (!PyArg_ParseTuple(args, "nL:open", &most, &limit_ns))
        return NULL;
    sink_close(&self->head);
    self->most = most < 0 ? 0 : (size_t)most;
    sink_open(&self->head, limit_ns);
    Py_RETURN_NONE;
}

static PyObject *outlet_write(OutletObject *self, PyObject *args)
{
    const char *wire;
    Py_ssize_t size;
    long long stamp_ns;
    if (!PyArg_ParseTuple(args, "y#L:write", &wire, &size, &stamp_ns))
        return NULL;
    if (size % 4)
        return PyErr_Format(PyExc_ValueError, "a message must consist of whole words");
    return PyBool_FromLong(!rosplc_sink_put(&self->head.sink, (const uint8_t *)wire, (size_t)size, stamp_ns));
}

static PyMethodDef outlet_methods[] = {
    {"open", (PyCFunction)outlet_open, METH_VARARGS,
     "open(most, limit_ns): send messages of up to `most` bytes, until one is not sent or comes after a longer silence."},
    SINK_CLOSE,
    {"write", (PyCFunction)outlet_write, METH_VARARGS, "write(payload, stamp_ns) -> whether it was sent."},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef outlet_attributes[] = {SINK_ATTRIBUTES, {NULL, NULL, NULL, NULL, NULL}};

static PyType_Slot outlet_slots[] =
    SINK_SLOTS("Outlet(writer): a sink that sends messages with one of the wheel's writers.", outlet_new, sink_dealloc,
               outlet_methods, outlet_attributes);

static PyType_Spec outlet_spec = {"rosplc.ros.dds._batch.Outlet", sizeof(OutletObject), 0, Py_TPFLAGS_DEFAULT,
                                  outlet_slots};

static int exec_module(PyObject *module)
{
    return py_only_interpreter() || py_add_type(module, "Inlet", &inlet_spec, NULL)
                   || py_add_type(module, "Outlet", &outlet_spec, NULL)
               ? -1
               : 0;
}

/* Without the library, or with an error of its, anything may have changed. */
static PyObject *batch_changed(PyObject *module, PyObject *args)
{
    Py_buffer pairs;
    Py_ssize_t count, found = 0;
    intptr_t *places;
    PyObject *list;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*:changed", &pairs))
        return NULL;
    count = pairs.len / (Py_ssize_t)sizeof(int32_t[2]);
    places = PyMem_Calloc((size_t)count + 1, sizeof *places);
    if (!places) {
        PyBuffer_Release(&pairs);
        return PyErr_NoMemory();
    }
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; i < count; i++) {
        int32_t pair[2];
        uint32_t flags = 0;
        memcpy(pair, (const char *)pairs.buf + i * (Py_ssize_t)sizeof pair, sizeof pair);
        if (!dds.take_status || dds.take_status(pair[0], &flags, (uint32_t)pair[1]) || flags)
            places[found++] = i;
    }
    Py_END_ALLOW_THREADS;
    PyBuffer_Release(&pairs);
    list = numbers(places, found);
    PyMem_Free(places);
    return list;
}

static PyMethodDef functions[] = {
    {"changed", (PyCFunction)batch_changed, METH_VARARGS,
     "changed(pairs) -> the places of those whose statuses may have changed since this was last called.\n\n"
     "pairs: of 32-bit integers, an entity and a mask of its statuses."},
    {"load", batch_load, METH_VARARGS, "load(path): use this library, which is loaded already. Raises OSError."},
    {NULL, NULL, 0, NULL},
};

static PyModuleDef_Slot module_slots[] = {{Py_mod_exec, (void *)exec_module}, {0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "rosplc.ros.dds._batch", "Messages between DDS and sinks.", 0, functions, module_slots,
    NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__batch(void)
{
    return PyModuleDef_Init(&definition);
}
