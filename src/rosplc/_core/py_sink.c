/* _native.Sink: messages from another extension module straight into a channel. */
#include "py_channel.h"
#include "py_sink.h"

typedef struct {
    SinkObject head;
    WriterObject *writer; /* pinned while it is set */
    PyObject *plan_object;
    const rp_plan *plan;
    int truncate;
    uint64_t truncated;
} ChannelSinkObject;

static int pass(rosplc_sink *base, const uint8_t *wire, size_t size, int64_t stamp_ns)
{
    ChannelSinkObject *self = sink_object(base);
    rosplc_writer *writer = &self->writer->writer;
    rosplc_meta meta = {.stamp_lo = (uint32_t)stamp_ns, .stamp_hi = (uint32_t)(stamp_ns >> 32), .stamp_clock = 1};
    rosplc_error error;
    rp_fault fault;
    rosplc_slot_header *slot = rosplc_writer_begin(writer, &error);
    /* Python tries what was refused again, counts it and explains it. */
    if (!slot || rp_decode(self->plan, wire, size, rosplc_record(slot), self->truncate, &meta.flags, &fault))
        return -1;
    rosplc_writer_commit(writer, slot, &meta);
    self->truncated += (meta.flags & RP_TRUNCATED) != 0;
    return 0;
}

static PyObject *channel_sink_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {NULL};
    return PyArg_ParseTupleAndKeywords(args, kwargs, ":Sink", names) ? sink_new(type, pass) : NULL;
}

static void let_writer_go(ChannelSinkObject *self)
{
    WriterObject *writer = self->writer;
    PyObject *plan_object = self->plan_object;
    self->writer = NULL;
    self->plan_object = NULL;
    if (writer)
        ch_region_unpin(writer->owner);
    Py_XDECREF((PyObject *)writer);
    Py_XDECREF(plan_object);
}

static void channel_sink_dealloc(ChannelSinkObject *self)
{
    let_writer_go(self);
    sink_dealloc(&self->head);
}

static PyObject *channel_sink_close(ChannelSinkObject *self, PyObject *unused)
{
    (void)unused;
    sink_close(&self->head);
    let_writer_go(self);
    Py_RETURN_NONE;
}

static PyObject *channel_sink_open(ChannelSinkObject *self, PyObject *args)
{
    WriterObject *writer;
    PyObject *plan_object;
    const rp_plan *plan;
    int truncate;
    long long limit_ns;
    if (!PyArg_ParseTuple(args, "O!OpL:open", ch_writer_type, &writer, &plan_object, &truncate, &limit_ns)
        || !(plan = rp_plan_from_object(plan_object)) || ch_region_usable(writer->owner))
        return NULL;
    if (writer->released || plan->record_size != writer->owner->region.geometry.record_size)
        return PyErr_Format(PyExc_ValueError, "the writer of %U was released, or its records have another size",
                            writer->owner->path);
    sink_close(&self->head);
    let_writer_go(self);
    Py_INCREF((PyObject *)writer);
    Py_INCREF(plan_object);
    ch_region_pin(writer->owner);
    self->writer = writer;
    self->plan_object = plan_object;
    self->plan = plan;
    self->truncate = truncate;
    sink_open(&self->head, limit_ns);
    Py_RETURN_NONE;
}

static PyObject *channel_sink_truncated(ChannelSinkObject *self, void *unused)
{
    uint64_t truncated;
    (void)unused;
    pthread_mutex_lock(&self->head.sink.mutex);
    truncated = self->truncated;
    pthread_mutex_unlock(&self->head.sink.mutex);
    return PyLong_FromUnsignedLongLong(truncated);
}

static PyMethodDef methods[] = {
    {"open", (PyCFunction)channel_sink_open, METH_VARARGS,
     "open(writer, plan, truncate, limit_ns): pass messages on, until one cannot be or comes after a longer silence."},
    {"close", (PyCFunction)channel_sink_close, METH_NOARGS, "Pass nothing on any more."},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef attributes[] = {
    SINK_ATTRIBUTES,
    {"truncated", (getter)channel_sink_truncated, NULL, "How many of the messages were shortened.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot slots[] =
    SINK_SLOTS("Sink(): takes messages for a channel from another extension module, without the GIL.",
               channel_sink_new, channel_sink_dealloc, methods, attributes);

static PyType_Spec spec = {"rosplc._core._native.Sink", sizeof(ChannelSinkObject), 0, Py_TPFLAGS_DEFAULT, slots};

int rosplc_add_sink(PyObject *module)
{
    return py_add_type(module, "Sink", &spec, NULL);
}
