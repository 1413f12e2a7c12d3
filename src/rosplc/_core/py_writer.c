/* _native.Writer: publishing from Python. */
#include "py_channel.h"

#include <time.h>
#include <unistd.h>

static PyObject *writer_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"region", "expected", "beat_ms", NULL};
    RegionObject *owner;
    WriterObject *self;
    unsigned int expected, beat_ms;
    uint32_t epoch;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!II:Writer", names, ch_region_type, &owner, &expected, &beat_ms))
        return NULL;
    if (ch_region_usable(owner))
        return NULL;
    if (!owner->writable)
        return ch_raise_channel(ROSPLC_ERROR_READ_ONLY, owner->path);
    do {
        if (ch_random_claim(&epoch))
            return NULL;
    } while (epoch == expected);
    self = py_allocate(type);
    if (!self)
        return NULL;
    if (rosplc_writer_claim(&self->writer, &owner->region, expected, epoch, beat_ms, (uint32_t)getpid())) {
        Py_DECREF((PyObject *)self);
        return ch_raise_channel(ROSPLC_ERROR_CLAIMED, owner->path);
    }
    Py_INCREF((PyObject *)owner);
    self->owner = owner;
    return (PyObject *)self;
}

static void writer_dealloc(WriterObject *self)
{
    Py_XDECREF((PyObject *)self->owner);
    py_release(self);
}

static int writer_usable(WriterObject *self)
{
    if (ch_region_usable(self->owner))
        return -1;
    if (self->released) {
        PyErr_SetString(PyExc_ValueError, "the writer has been released");
        return -1;
    }
    while (self->gate.busy) {
        if (ch_gate_wait(&self->gate))
            return -1;
        if (self->released || self->owner->closed)
            return writer_usable(self);
    }
    return 0;
}

/* Optional arguments, in this order: */
#define META_NAMES "stamp_ns", "stamp_clock", "flags", "correlation", "status", "client", "reason"
enum { META_COUNT = 7 };

static int writer_meta(PyObject **values, rosplc_meta *meta)
{
    uint64_t stamp = 0, correlation = 0;
    uint32_t clock = 1, flags = 0, status = 0, reason = 0;
    char *client = NULL;
    Py_ssize_t client_size = 0;
    if ((values[0] && ch_as_u64(values[0], "stamp_ns", &stamp))
        || (values[1] && ch_as_u32(values[1], "stamp_clock", &clock))
        || (values[2] && ch_as_u32(values[2], "flags", &flags))
        || (values[3] && ch_as_u64(values[3], "correlation", &correlation))
        || (values[4] && ch_as_u32(values[4], "status", &status))
        || (values[5] && PyBytes_AsStringAndSize(values[5], &client, &client_size))
        || (values[6] && ch_as_u32(values[6], "reason", &reason)))
        return -1;
    if (clock > 3 || flags > 7) {
        PyErr_SetString(PyExc_ValueError, "stamp_clock is not between 0 and 3, or flags not between 0 and 7");
        return -1;
    }
    if (client_size != 0 && client_size != sizeof meta->client) {
        PyErr_Format(PyExc_ValueError, "client must have 16 bytes or none, not %zd", client_size);
        return -1;
    }
    *meta = (rosplc_meta){flags,
                      status,
                      (uint32_t)stamp,
                      (uint32_t)(stamp >> 32),
                      stamp ? clock : 0,
                      (uint32_t)correlation,
                      (uint32_t)(correlation >> 32),
                      {0},
                      reason};
    if (client_size)
        memcpy(meta->client, client, sizeof meta->client);
    return 0;
}

static PyObject *publish_bytes(WriterObject *self, const uint8_t *record, Py_ssize_t given, const rosplc_meta *meta)
{
    rosplc_slot_header *slot;
    uint32_t size, sequence = 0;
    rosplc_error error;
    /* Only now: getting a record may run Python code, which may close the region. */
    if (writer_usable(self))
        return NULL;
    size = self->owner->region.geometry.record_size;
    if (given != (Py_ssize_t)size)
        return PyErr_Format(PyExc_ValueError, "a record of %U has %lu bytes, not %zd", self->owner->path,
                            (unsigned long)size, given);
    slot = rosplc_writer_begin(&self->writer, &error);
    if (slot && size < CH_LONG_COPY) {
        ROSPLC_COPY_RECORD(rosplc_record(slot), record, size);
        sequence = rosplc_writer_commit(&self->writer, slot, meta);
    } else if (slot) {
        PyThreadState *unlocked = ch_gate_enter(&self->gate, self->owner);
        ROSPLC_COPY_RECORD(rosplc_record(slot), record, size);
        sequence = rosplc_writer_commit(&self->writer, slot, meta);
        ch_gate_leave(&self->gate, self->owner, unlocked);
    }
    return slot ? PyLong_FromUnsignedLong(sequence) : ch_raise_channel(error, self->owner->path);
}

static PyObject *writer_publish(WriterObject *self, PyObject *const *args, Py_ssize_t count, PyObject *keywords)
{
    static const char *const names[] = {"record", META_NAMES, NULL};
    PyObject *values[1 + META_COUNT];
    Py_buffer view;
    PyObject *result;
    rosplc_meta meta;
    if (ch_arguments("publish", names, 1, 1, args, count, keywords, values) || writer_meta(values + 1, &meta)
        || PyObject_GetBuffer(values[0], &view, PyBUF_SIMPLE))
        return NULL;
    result = publish_bytes(self, view.buf, view.len, &meta);
    PyBuffer_Release(&view);
    return result;
}

static PyObject *writer_publish_value(WriterObject *self, PyObject *const *args, Py_ssize_t count)
{
    uint8_t small[1024], *record = small;
    Py_ssize_t size;
    PyObject *values[META_COUNT] = {NULL}, *result = NULL;
    rosplc_meta meta;
    struct timespec now;
    int late;
    if (count != 4)
        return PyErr_Format(PyExc_TypeError, "publish_value(shape, value, stamp_ns, until) takes 4 arguments");
    values[0] = args[2] == Py_None ? NULL : args[2];
    if ((size = rp_shape_size(args[0])) < 0 || writer_meta(values, &meta) || (late = ch_reached(args[3])) < 0)
        return NULL;
    if (late)
        return PyLong_FromLong(0);
    if (!values[0]) {
        uint64_t ns;
        clock_gettime(CLOCK_REALTIME, &now);
        ns = (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
        meta.stamp_lo = (uint32_t)ns;
        meta.stamp_hi = (uint32_t)(ns >> 32);
        meta.stamp_clock = 1;
    }
    if (size > (Py_ssize_t)sizeof small && !(record = PyMem_Malloc((size_t)size)))
        return PyErr_NoMemory();
    if (!rp_shape_pack(args[0], args[1], record))
        result = publish_bytes(self, record, size, &meta);
    if (record != small)
        PyMem_Free(record);
    return result;
}

static PyObject *writer_publish_wire(WriterObject *self, PyObject *const *args, Py_ssize_t count,
                                     PyObject *keywords)
{
    static const char *const names[] = {"plan", "data", "truncate", META_NAMES, NULL};
    PyObject *values[3 + META_COUNT];
    const rp_plan *plan;
    Py_buffer view;
    rosplc_slot_header *slot;
    rosplc_meta meta;
    rp_fault fault = {0, 0, 0, 0};
    uint32_t size, sequence = 0, flags = 0;
    rosplc_error error;
    int truncate, refused = 0;
    if (ch_arguments("publish_wire", names, 2, 2, args, count, keywords, values) || writer_meta(values + 3, &meta)
        || !(plan = rp_plan_from_object(values[0])))
        return NULL;
    truncate = values[2] ? PyObject_IsTrue(values[2]) : 0;
    if (truncate < 0)
        return NULL;
    size = self->owner->region.geometry.record_size;
    if (plan->record_size != size)
        return PyErr_Format(PyExc_ValueError, "the plan's records have %lu bytes, those of %U have %lu",
                            (unsigned long)plan->record_size, self->owner->path, (unsigned long)size);
    if (PyObject_GetBuffer(values[1], &view, PyBUF_SIMPLE))
        return NULL;
    if (writer_usable(self)) {
        PyBuffer_Release(&view);
        return NULL;
    }
    slot = rosplc_writer_begin(&self->writer, &error);
    if (slot) {
        PyThreadState *unlocked = NULL;
        if (size >= CH_LONG_COPY || view.len >= (Py_ssize_t)CH_LONG_COPY)
            unlocked = ch_gate_enter(&self->gate, self->owner);
        refused = rp_decode(plan, view.buf, (size_t)view.len, rosplc_record(slot), truncate, &flags, &fault);
        if (refused) {
            rosplc_writer_refuse(&self->writer, 0);
        } else {
            meta.flags |= flags;
            sequence = rosplc_writer_commit(&self->writer, slot, &meta);
        }
        if (unlocked)
            ch_gate_leave(&self->gate, self->owner, unlocked);
    }
    PyBuffer_Release(&view);
    if (!slot)
        return ch_raise_channel(error, self->owner->path);
    if (refused)
        return rp_raise_fault(&fault);
    return Py_BuildValue("(kk)", (unsigned long)sequence, (unsigned long)flags);
}

static PyObject *writer_beat(WriterObject *self, PyObject *unused)
{
    (void)unused;
    if (ch_region_usable(self->owner))
        return NULL;
    if (!self->released)
        rosplc_writer_beat(&self->writer);
    Py_RETURN_NONE;
}

static PyObject *writer_check(WriterObject *self, PyObject *unused)
{
    int error;
    (void)unused;
    if (ch_region_usable(self->owner))
        return NULL;
    error = rosplc_writer_check(&self->writer);
    return error ? ch_raise_channel(error, self->owner->path) : Py_NewRef(Py_None);
}

static PyObject *writer_release(WriterObject *self, PyObject *unused)
{
    (void)unused;
    if (!self->released) {
        self->released = 1; /* first: a loop that publishes ends here */
        if (self->gate.busy && ch_gate_wait(&self->gate))
            return NULL;
        if (!self->owner->closed)
            rosplc_writer_release(&self->writer);
    }
    Py_RETURN_NONE;
}

static PyObject *writer_refuse(WriterObject *self, PyObject *args)
{
    unsigned int number = 0;
    if (!PyArg_ParseTuple(args, "|I:refuse", &number) || writer_usable(self))
        return NULL;
    rosplc_writer_refuse(&self->writer, number);
    Py_RETURN_NONE;
}

static PyObject *writer_set_sources(WriterObject *self, PyObject *value)
{
    uint32_t number;
    if (ch_as_u32(value, "sources", &number) || writer_usable(self))
        return NULL;
    rosplc_store(&self->owner->region.header->writer.sources, number);
    Py_RETURN_NONE;
}

static PyObject *writer_begun(WriterObject *self, PyObject *value)
{
    uint32_t first;
    if (ch_as_u32(value, "first", &first) || ch_region_usable(self->owner))
        return NULL;
    return PyBool_FromLong(rosplc_call_begun(&self->writer, first));
}

static PyObject *writer_head(WriterObject *self, void *unused)
{
    (void)unused;
    return PyLong_FromUnsignedLong(self->writer.head);
}

static PyObject *writer_epoch(WriterObject *self, void *unused)
{
    (void)unused;
    return PyLong_FromUnsignedLong(self->writer.epoch);
}

static PyMethodDef methods[] = {
    {"publish", (PyCFunction)(void (*)(void))writer_publish, METH_FASTCALL | METH_KEYWORDS,
     "publish(record, *, stamp_ns=0, stamp_clock=1, flags=0, correlation=0, status=0, client=b'', reason=0)"
     " -> sequence."},
    {"publish_value", (PyCFunction)(void (*)(void))writer_publish_value, METH_FASTCALL,
     "publish_value(shape, value, stamp_ns or None for now, until) -> sequence; 0: it is too late."},
    {"publish_wire", (PyCFunction)(void (*)(void))writer_publish_wire, METH_FASTCALL | METH_KEYWORDS,
     "publish_wire(plan, data, *, truncate=False, stamp_ns=0, stamp_clock=1, flags=0, correlation=0, status=0,"
     " client=b'', reason=0) -> (sequence, flags)."},
    {"beat", (PyCFunction)writer_beat, METH_NOARGS, "Show that this writer lives."},
    {"check", (PyCFunction)writer_check, METH_NOARGS, "Raise SHM111, SHM112 or SHM115 if publish would."},
    {"release", (PyCFunction)writer_release, METH_NOARGS, "Give the claim back; the object stays as it is."},
    {"refuse", (PyCFunction)writer_refuse, METH_VARARGS, "refuse(error=0): count a message that was not published."},
    {"begun", (PyCFunction)writer_begun, METH_O,
     "begun(first) -> whether the withdrawn call whose first message has that sequence may have been begun."},
    {"set_sources", (PyCFunction)writer_set_sources, METH_O, "Say how many ROS publishers are known behind this writer."},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef attributes[] = {
    {"head", (getter)writer_head, NULL, "Sequence of the newest message of this stream; 0 none.", NULL},
    {"epoch", (getter)writer_epoch, NULL, "The claim's random number.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_doc, "Writer(region, expected, beat_ms): claims the channel from `expected` (0: free), or raises SHM114."},
    {Py_tp_new, (void *)writer_new},
    {Py_tp_dealloc, (void *)writer_dealloc},
    {Py_tp_methods, methods},
    {Py_tp_getset, attributes},
    {0, NULL},
};

static PyType_Spec spec = {"rosplc._core._native.Writer", sizeof(WriterObject), 0, Py_TPFLAGS_DEFAULT, slots};

int ch_add_writer(PyObject *module)
{
    return py_add_type(module, "Writer", &spec, &ch_writer_type);
}
