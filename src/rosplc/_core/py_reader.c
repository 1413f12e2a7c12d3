/* _native.Reader: taking messages from Python. */
#include "py_channel.h"

#include <unistd.h>

static PyObject *reader_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"region", "last", NULL};
    RegionObject *owner;
    ReaderObject *self;
    unsigned int last;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!I:Reader", names, ch_region_type, &owner, &last))
        return NULL;
    if (ch_region_usable(owner))
        return NULL;
    self = py_allocate(type);
    if (!self)
        return NULL;
    rosplc_reader_observe(&self->reader, &owner->region, last);
    Py_INCREF((PyObject *)owner);
    self->owner = owner;
    return (PyObject *)self;
}

static void reader_dealloc(ReaderObject *self)
{
    Py_XDECREF((PyObject *)self->owner);
    PyMem_Free(self->shadow);
    PyMem_Free(self->wire);
    py_release(self);
}

static PyObject *reader_claim(ReaderObject *self, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"index", "expected", "beat_ms", "task", "answer", NULL};
    unsigned int index, expected, beat_ms;
    int answer = 0;
    rosplc_error error;
    const char *task;
    Py_ssize_t task_size;
    uint32_t claim;
    uint8_t name[16] = {0};
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "IIIs#|p:claim", names, &index, &expected, &beat_ms, &task,
                                     &task_size, &answer)
        || ch_region_usable(self->owner))
        return NULL;
    if (index >= ROSPLC_READER_LINES || (answer && index))
        return PyErr_Format(PyExc_ValueError, "there is no reader line %u%s", index, answer ? " for an answerer" : "");
    if (!self->owner->writable)
        return ch_raise_channel(ROSPLC_ERROR_READ_ONLY, self->owner->path);
    do {
        if (ch_random_claim(&claim))
            return NULL;
    } while (claim == expected);
    error = answer ? rosplc_answerer_claim(&self->reader, expected, claim, beat_ms, (uint32_t)getpid())
                   : rosplc_reader_claim(&self->reader, index, expected, claim, beat_ms, (uint32_t)getpid());
    if (error)
        return ch_raise_channel(ROSPLC_ERROR_CLAIMED, self->owner->path);
    memcpy(name, task, task_size < 15 ? (size_t)task_size : 15);
    memcpy(self->owner->region.header->reader[index].task, name, sizeof name);
    Py_RETURN_NONE;
}

/* 0 when the object can be read now, -1 with an exception; beats in passing. */
static int reader_usable(ReaderObject *self)
{
    int error;
    while (self->gate.busy) {
        if (ch_gate_wait(&self->gate))
            return -1;
    }
    if (ch_region_usable(self->owner))
        return -1;
    error = rosplc_region_check(&self->owner->region);
    if (error) {
        ch_raise_channel(error, self->owner->path);
        return -1;
    }
    rosplc_reader_beat(&self->reader);
    return 0;
}

static PyThreadState *reader_unlock(ReaderObject *self, size_t size)
{
    return size < CH_LONG_COPY ? NULL : ch_gate_enter(&self->gate, self->owner);
}

static void reader_lock(ReaderObject *self, PyThreadState *state)
{
    if (state)
        ch_gate_leave(&self->gate, self->owner, state);
}

/* 1 when `out` was filled, 0 when there was nothing to take, -1 with an exception. */
static int reader_fill(ReaderObject *self, PyObject *out, rosplc_take *take)
{
    size_t size = self->owner->region.geometry.record_size;
    PyThreadState *state;
    Py_buffer view;
    int accepted;
    if (PyObject_GetBuffer(out, &view, PyBUF_WRITABLE))
        return -1;
    /* Only now: getting a buffer may run Python code, which may close the region. */
    if (reader_usable(self)) {
        PyBuffer_Release(&view);
        return -1;
    }
    if (view.len < (Py_ssize_t)size) {
        PyErr_Format(PyExc_ValueError, "a record of %U has %zu bytes, but the buffer has %zd", self->owner->path, size,
                     view.len);
        PyBuffer_Release(&view);
        return -1;
    }
    if (!self->shadow && !(self->shadow = PyMem_Malloc(size))) {
        PyBuffer_Release(&view);
        PyErr_NoMemory();
        return -1;
    }
    state = reader_unlock(self, size);
    accepted = rosplc_take_record(&self->reader, take, self->shadow);
    if (accepted)
        memcpy(view.buf, self->shadow, size);
    reader_lock(self, state);
    PyBuffer_Release(&view);
    return accepted;
}

static PyObject *reader_take(ReaderObject *self, PyObject *out, int mode)
{
    rosplc_take take = rosplc_take_start(mode);
    int filled = reader_fill(self, out, &take);
    if (filled < 0)
        return NULL;
    return filled ? ch_slot_info(&take) : Py_NewRef(Py_None);
}

/* A loop mostly wants the bytes alone: making a SlotInfo costs more than taking a small record. */
static PyObject *reader_update(ReaderObject *self, PyObject *out)
{
    rosplc_take take = rosplc_take_start(ROSPLC_TAKE_NEWEST);
    int filled = reader_fill(self, out, &take);
    return filled < 0 ? NULL : PyBool_FromLong(filled);
}

static PyObject *reader_latest(ReaderObject *self, PyObject *out)
{
    return reader_take(self, out, ROSPLC_TAKE_NEWEST);
}

static PyObject *reader_next(ReaderObject *self, PyObject *out)
{
    return reader_take(self, out, ROSPLC_TAKE_NEXT);
}

static PyObject *reader_peek(ReaderObject *self, PyObject *out)
{
    return reader_take(self, out, ROSPLC_TAKE_PEEK);
}

/* A bytes object, or None. Nobody sees it before it is returned: it needs no shadow. */
static PyObject *reader_bytes(ReaderObject *self, rosplc_take *take)
{
    PyThreadState *state;
    PyObject *record;
    size_t size = self->owner->region.geometry.record_size;
    int accepted;
    if (reader_usable(self))
        return NULL;
    /* Before a large object is made for nothing. */
    if (take->mode != ROSPLC_TAKE_PEEK && !rosplc_reader_news(&self->reader))
        Py_RETURN_NONE;
    if (!(record = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)size)))
        return NULL;
    state = reader_unlock(self, size);
    accepted = rosplc_take_record(&self->reader, take, PyBytes_AsString(record));
    reader_lock(self, state);
    if (accepted)
        return record;
    Py_DECREF(record);
    Py_RETURN_NONE;
}

static PyObject *reader_take_record(ReaderObject *self, int mode)
{
    rosplc_take take = rosplc_take_start(mode);
    PyObject *record = reader_bytes(self, &take), *info;
    if (!record || record == Py_None)
        return record;
    if ((info = ch_slot_info(&take)) != NULL)
        return Py_BuildValue("(NN)", record, info);
    Py_DECREF(record);
    return NULL;
}

static PyObject *reader_view(ReaderObject *self, PyObject *const *args, Py_ssize_t count)
{
    size_t size = self->owner->region.geometry.record_size;
    PyObject *record, *view;
    rosplc_take take;
    Py_ssize_t wanted;
    uint32_t mode;
    int late;
    if (count != 3)
        return PyErr_Format(PyExc_TypeError, "view(shape, mode, until) takes 3 arguments");
    if ((wanted = rp_shape_size(args[0])) < 0 || ch_as_u32(args[1], "mode", &mode) || (late = ch_reached(args[2])) < 0)
        return NULL;
    if (late)
        Py_RETURN_FALSE;
    if ((size_t)wanted != size || mode > ROSPLC_TAKE_PEEK)
        return PyErr_Format(PyExc_ValueError, "the shape has %zd-byte records, %U has %zu, or mode %u is not valid",
                            wanted, self->owner->path, size, (unsigned)mode);
    take = rosplc_take_start((int)mode);
    record = reader_bytes(self, &take);
    if (!record || record == Py_None)
        return record;
    self->taken = take;
    view = rp_shape_view(args[0], record);
    Py_DECREF(record);
    return view;
}

static PyObject *reader_get_info(ReaderObject *self, void *unused)
{
    (void)unused;
    return self->taken.sequence ? ch_slot_info(&self->taken) : Py_NewRef(Py_None);
}

static PyObject *reader_latest_record(ReaderObject *self, PyObject *unused)
{
    (void)unused;
    return reader_take_record(self, ROSPLC_TAKE_NEWEST);
}

static PyObject *reader_next_record(ReaderObject *self, PyObject *unused)
{
    (void)unused;
    return reader_take_record(self, ROSPLC_TAKE_NEXT);
}

static PyObject *reader_peek_record(ReaderObject *self, PyObject *unused)
{
    (void)unused;
    return reader_take_record(self, ROSPLC_TAKE_PEEK);
}

static PyObject *reader_take_wire(ReaderObject *self, PyObject *plan_object, int mode)
{
    const rp_plan *plan = rp_plan_from_object(plan_object);
    rosplc_take take = rosplc_take_start(mode);
    rp_fault fault = {0, 0, 0, 0};
    PyThreadState *state;
    PyObject *info, *result = NULL;
    uint8_t *wire;
    size_t bound, used = 0;
    int accepted = 0, failed = 0;
    if (!plan || reader_usable(self))
        return NULL;
    if (plan->record_size != self->owner->region.geometry.record_size)
        return PyErr_Format(PyExc_ValueError, "the plan's records have %lu bytes, those of %U have %lu",
                            (unsigned long)plan->record_size, self->owner->path,
                            (unsigned long)self->owner->region.geometry.record_size);
    bound = rp_encoded_bound(plan);
    /* Ours until the bytes object is made: another thread that takes meanwhile gets a buffer of its own. */
    wire = self->wire_size >= bound ? self->wire : PyMem_Malloc(bound);
    if (!wire)
        return PyErr_NoMemory();
    if (wire == self->wire) {
        self->wire = NULL;
        self->wire_size = 0;
    }
    state = reader_unlock(self, plan->record_size);
    while (rosplc_take_begin(&self->reader, &take)) {
        int outcome = rp_encode(plan, rosplc_record(take.slot), wire, bound, &used, &fault);
        if (rosplc_take_check(&self->reader, &take)) {
            rosplc_take_accept(&self->reader, &take);
            accepted = 1;
            failed = outcome;
        }
    }
    reader_lock(self, state);
    if (failed)
        rp_raise_fault(&fault);
    else if (!accepted)
        result = Py_NewRef(Py_None);
    else if ((info = ch_slot_info(&take)) != NULL)
        result = Py_BuildValue("(y#N)", (const char *)wire, (Py_ssize_t)used, info);
    PyMem_Free(self->wire);
    self->wire = wire;
    self->wire_size = bound;
    return result;
}

static PyObject *reader_latest_wire(ReaderObject *self, PyObject *plan)
{
    return reader_take_wire(self, plan, ROSPLC_TAKE_NEWEST);
}

static PyObject *reader_next_wire(ReaderObject *self, PyObject *plan)
{
    return reader_take_wire(self, plan, ROSPLC_TAKE_NEXT);
}

static PyObject *reader_peek_wire(ReaderObject *self, PyObject *plan)
{
    return reader_take_wire(self, plan, ROSPLC_TAKE_PEEK);
}

static PyObject *reader_begin(ReaderObject *self, PyObject *unused)
{
    (void)unused;
    return reader_usable(self) ? NULL : PyBool_FromLong(rosplc_call_begin(&self->reader));
}

static PyObject *reader_beat(ReaderObject *self, PyObject *unused)
{
    (void)unused;
    if (ch_region_usable(self->owner))
        return NULL;
    rosplc_reader_beat(&self->reader);
    Py_RETURN_NONE;
}

static PyObject *reader_release(ReaderObject *self, PyObject *unused)
{
    (void)unused;
    if (self->gate.busy && ch_gate_wait(&self->gate))
        return NULL;
    if (!self->owner->closed)
        rosplc_reader_release(&self->reader);
    self->reader.line = NULL;
    Py_RETURN_NONE;
}

static PyObject *reader_set_word(ReaderObject *self, PyObject *value, const char *name, size_t offset)
{
    uint32_t number;
    rosplc_reader_line *line;
    if (ch_as_u32(value, name, &number) || ch_region_usable(self->owner))
        return NULL;
    line = rosplc_reader_owned(&self->reader);
    if (line)
        rosplc_store((uint32_t *)(void *)((uint8_t *)line + offset), number);
    Py_RETURN_NONE;
}

static PyObject *reader_set_sinks(ReaderObject *self, PyObject *value)
{
    return reader_set_word(self, value, "sinks", offsetof(rosplc_reader_line, sinks));
}

static PyObject *reader_set_error(ReaderObject *self, PyObject *value)
{
    return reader_set_word(self, value, "error", offsetof(rosplc_reader_line, error));
}

#define READER_NUMBER(name, expression) \
    static PyObject *reader_get_##name(ReaderObject *self, void *unused) \
    { \
        (void)unused; \
        return PyLong_FromUnsignedLong(expression); \
    }
READER_NUMBER(last, self->reader.last)
READER_NUMBER(lost, self->reader.lost)
READER_NUMBER(retries, self->reader.retries)
READER_NUMBER(discontinuities, self->reader.discontinuities)

static PyObject *reader_get_line(ReaderObject *self, void *unused)
{
    rosplc_reader_line *line = self->owner->closed ? NULL : rosplc_reader_owned(&self->reader);
    (void)unused;
    if (!line)
        Py_RETURN_NONE;
    return PyLong_FromSsize_t(line - self->owner->region.header->reader);
}

static PyMethodDef methods[] = {
    {"claim", (PyCFunction)(void (*)(void))reader_claim, METH_VARARGS | METH_KEYWORDS,
     "claim(index, expected, beat_ms, task, answer=False): claim a reader line from `expected` (0: free), or raise"
     " SHM114."},
    {"latest", (PyCFunction)reader_latest, METH_O, "latest(out) -> SlotInfo of the newest message, None if not new."},
    {"update", (PyCFunction)reader_update, METH_O, "update(out) -> whether a new message is in out now."},
    {"next", (PyCFunction)reader_next, METH_O, "next(out) -> SlotInfo of the message after the last, or None."},
    {"peek", (PyCFunction)reader_peek, METH_O, "peek(out) -> SlotInfo of the current message, new or not, or None."},
    {"latest_record", (PyCFunction)reader_latest_record, METH_NOARGS, "latest_record() -> (bytes, SlotInfo) or None."},
    {"next_record", (PyCFunction)reader_next_record, METH_NOARGS, "next_record() -> (bytes, SlotInfo) or None."},
    {"peek_record", (PyCFunction)reader_peek_record, METH_NOARGS, "peek_record() -> (bytes, SlotInfo) or None."},
    {"view", (PyCFunction)(void (*)(void))reader_view, METH_FASTCALL,
     "view(shape, mode, until) -> a view of the newest (mode 0), next (1) or current (2) message, or None."},
    {"latest_wire", (PyCFunction)reader_latest_wire, METH_O, "latest_wire(plan) -> (wire bytes, SlotInfo) or None."},
    {"next_wire", (PyCFunction)reader_next_wire, METH_O, "next_wire(plan) -> (wire bytes, SlotInfo) or None."},
    {"peek_wire", (PyCFunction)reader_peek_wire, METH_O, "peek_wire(plan) -> (wire bytes, SlotInfo) or None."},
    {"begin", (PyCFunction)reader_begin, METH_NOARGS,
     "begin() -> whether the message just taken may be acted on: it is still the newest, and line 0 ours."},
    {"beat", (PyCFunction)reader_beat, METH_NOARGS, "Show that this reader lives; taking does so too."},
    {"release", (PyCFunction)reader_release, METH_NOARGS, "Give the line back; go on as an observer."},
    {"set_sinks", (PyCFunction)reader_set_sinks, METH_O, "Say how many ROS subscribers are known behind this reader."},
    {"set_error", (PyCFunction)reader_set_error, METH_O, "Show an error number of section 9 in the line, 0 none."},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef attributes[] = {
    {"last", (getter)reader_get_last, NULL, "Sequence of the newest message taken.", NULL},
    {"lost", (getter)reader_get_lost, NULL, "Messages missed.", NULL},
    {"retries", (getter)reader_get_retries, NULL, "Copies thrown away.", NULL},
    {"discontinuities", (getter)reader_get_discontinuities, NULL, "Times that the stream jumped.", NULL},
    {"info", (getter)reader_get_info, NULL, "SlotInfo of the message that view() returned last, or None.", NULL},
    {"line", (getter)reader_get_line, NULL, "Index of the claimed line; None for an observer.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_doc, "Reader(region, last): an observer that starts after `last`; see claim()."},
    {Py_tp_new, (void *)reader_new},
    {Py_tp_dealloc, (void *)reader_dealloc},
    {Py_tp_methods, methods},
    {Py_tp_getset, attributes},
    {0, NULL},
};

static PyType_Spec spec = {"rosplc._core._native.Reader", sizeof(ReaderObject), 0, Py_TPFLAGS_DEFAULT, slots};

int ch_add_reader(PyObject *module)
{
    return py_add_type(module, "Reader", &spec, &ch_reader_type);
}
