/* _native.Region and _native.SlotInfo, and what the other channel types share. */
#include "py_channel.h"

#include <errno.h>
#include <sys/mman.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <time.h>

PyTypeObject *ch_region_type, *ch_writer_type, *ch_reader_type;
static PyTypeObject *slot_info_type;

/* ---------------------------------------------------------------- shared helpers */

PyObject *ch_raise_channel(int number, PyObject *path)
{
    PyObject *errors = PyImport_ImportModule("rosplc.errors");
    PyObject *code = PyUnicode_FromFormat("SHM%03d", number);
    PyObject *codes = NULL, *info = NULL, *title = NULL, *type = NULL, *args = NULL, *kwargs = NULL, *error = NULL;
    if (errors && code && (codes = PyObject_GetAttrString(errors, "CODES"))
        && (info = PyObject_GetItem(codes, code)) && (title = PyObject_GetAttrString(info, "title"))
        && (type = PyObject_GetAttrString(errors, "ChannelError")) && (args = PyTuple_Pack(2, code, title))
        && (kwargs = PyDict_New()) && !PyDict_SetItemString(kwargs, "where", path)
        && (error = PyObject_Call(type, args, kwargs)))
        PyErr_SetObject(type, error);
    Py_XDECREF(error);
    Py_XDECREF(kwargs);
    Py_XDECREF(args);
    Py_XDECREF(type);
    Py_XDECREF(title);
    Py_XDECREF(info);
    Py_XDECREF(codes);
    Py_XDECREF(code);
    Py_XDECREF(errors);
    return NULL;
}

static void pause_without_gil(void)
{
    struct timespec pause = {0, 50000};
    Py_BEGIN_ALLOW_THREADS;
    nanosleep(&pause, NULL);
    Py_END_ALLOW_THREADS;
}

int ch_gate_wait(ch_gate *gate)
{
    int interrupted = 0;
    gate->waiting++;
    while (gate->busy && !interrupted) {
        pause_without_gil();
        interrupted = PyErr_CheckSignals();
    }
    gate->waiting--;
    return interrupted ? -1 : 0;
}

PyThreadState *ch_gate_enter(ch_gate *gate, RegionObject *region)
{
    ch_region_pin(region);
    gate->busy = 1;
    return PyEval_SaveThread();
}

void ch_gate_leave(ch_gate *gate, RegionObject *region, PyThreadState *state)
{
    PyEval_RestoreThread(state);
    gate->busy = 0;
    /* A loop of copies would otherwise be back before a waiting thread has had a look. */
    for (int i = 0; i < 4 && gate->waiting && !gate->busy; i++)
        pause_without_gil();
    ch_region_unpin(region);
}

int ch_arguments(const char *method, const char *const *names, Py_ssize_t positional, Py_ssize_t required,
                 PyObject *const *args, Py_ssize_t count, PyObject *keywords, PyObject **out)
{
    Py_ssize_t named = keywords ? PyTuple_Size(keywords) : 0;
    Py_ssize_t known = 0;
    for (; names[known]; known++)
        out[known] = NULL;
    if (count > positional) {
        PyErr_Format(PyExc_TypeError, "%s() takes %zd positional arguments, not %zd", method, positional, count);
        return -1;
    }
    for (Py_ssize_t i = 0; i < count; i++)
        out[i] = args[i];
    for (Py_ssize_t i = 0; i < named; i++) {
        PyObject *keyword = PyTuple_GetItem(keywords, i);
        Py_ssize_t at = 0;
        while (at < known && PyUnicode_CompareWithASCIIString(keyword, names[at]))
            at++;
        if (at == known || out[at]) {
            PyErr_Format(PyExc_TypeError, "%s() got an unexpected or repeated argument %R", method, keyword);
            return -1;
        }
        out[at] = args[count + i];
    }
    for (Py_ssize_t i = 0; i < required; i++) {
        if (!out[i]) {
            PyErr_Format(PyExc_TypeError, "%s() is missing its argument '%s'", method, names[i]);
            return -1;
        }
    }
    return 0;
}

int ch_as_u64(PyObject *value, const char *name, uint64_t *out)
{
    unsigned long long number = PyLong_AsUnsignedLongLong(value);
    if (number == (unsigned long long)-1 && PyErr_Occurred()) {
        if (PyErr_ExceptionMatches(PyExc_OverflowError))
            PyErr_Format(PyExc_ValueError, "%s is not between 0 and 2**64 - 1", name);
        return -1;
    }
    *out = number;
    return 0;
}

int ch_as_u32(PyObject *value, const char *name, uint32_t *out)
{
    uint64_t number;
    if (ch_as_u64(value, name, &number))
        return -1;
    if (number > UINT32_MAX) {
        PyErr_Format(PyExc_ValueError, "%s is not between 0 and 2**32 - 1", name);
        return -1;
    }
    *out = (uint32_t)number;
    return 0;
}

int ch_reached(PyObject *seconds)
{
    struct timespec now;
    double limit = PyFloat_AsDouble(seconds);
    if (limit == -1.0 && PyErr_Occurred())
        return -1;
    clock_gettime(CLOCK_MONOTONIC_COARSE, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec >= limit;
}

int ch_random_claim(uint32_t *out)
{
    do {
        if (getrandom(out, sizeof *out, 0) != sizeof *out) {
            PyErr_SetFromErrno(PyExc_OSError);
            return -1;
        }
    } while (*out == 0);
    return 0;
}

/* ---------------------------------------------------------------- SlotInfo */

static PyStructSequence_Field slot_info_fields[] = {
    {"sequence", "The message's sequence number."},
    {"flags", "Bits: 1 first after the writer (re)started, 2 truncated, 4 substituted."},
    {"status", "0 for topics."},
    {"stamp_ns", "The source's time stamp, ns since its clock's epoch; 0 none."},
    {"stamp_clock", "0 none, 1 system clock (UTC), 2 ROS time, 3 the PLC's clock."},
    {"correlation", "0 for topics."},
    {"lost", "Messages missed since the one taken before."},
    {"client", "Whose call it is, or a goal's UUID: 16 bytes; 0 for topics."},
    {"reason", "Why a call ended as `status` shows; 0 for topics."},
    {NULL, NULL},
};

static PyStructSequence_Desc slot_info_description = {
    "rosplc._core._native.SlotInfo", "What a slot says about its message.", slot_info_fields, 9};

PyObject *ch_slot_info(const rosplc_take *take)
{
    PyObject *info = PyStructSequence_New(slot_info_type);
    if (!info)
        return NULL;
    PyStructSequence_SetItem(info, 0, PyLong_FromUnsignedLong(take->sequence));
    PyStructSequence_SetItem(info, 1, PyLong_FromUnsignedLong(take->flags));
    PyStructSequence_SetItem(info, 2, PyLong_FromUnsignedLong(take->status));
    PyStructSequence_SetItem(info, 3,
                             PyLong_FromUnsignedLongLong((uint64_t)take->stamp_hi << 32 | take->stamp_lo));
    PyStructSequence_SetItem(info, 4, PyLong_FromUnsignedLong(take->stamp_clock));
    PyStructSequence_SetItem(
        info, 5, PyLong_FromUnsignedLongLong((uint64_t)take->correlation_hi << 32 | take->correlation_lo));
    PyStructSequence_SetItem(info, 6, PyLong_FromUnsignedLong(take->lost));
    PyStructSequence_SetItem(info, 7,
                             PyBytes_FromStringAndSize((const char *)take->client, sizeof take->client));
    PyStructSequence_SetItem(info, 8, PyLong_FromUnsignedLong(take->reason));
    if (PyErr_Occurred()) {
        Py_DECREF(info);
        return NULL;
    }
    return info;
}

/* ---------------------------------------------------------------- Region */

static void region_unmap(RegionObject *self)
{
    if (self->mapped && !self->pins) {
        munmap(self->region.header, self->mapped);
        self->mapped = 0;
    }
}

int ch_region_usable(RegionObject *region)
{
    if (!region->closed)
        return 0;
    PyErr_Format(PyExc_ValueError, "%U has been closed", region->path);
    return -1;
}

void ch_region_pin(RegionObject *region)
{
    region->pins++;
}

void ch_region_unpin(RegionObject *region)
{
    region->pins--;
    if (region->closed)
        region_unmap(region);
}

static PyObject *region_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"fd", "identity", "writable", "path", NULL};
    int fd, writable, error;
    const char *identity;
    Py_ssize_t identity_size;
    PyObject *path;
    struct stat status;
    rosplc_geometry geometry;
    RegionObject *self;
    void *base;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "iy#pU:Region", names, &fd, &identity, &identity_size, &writable,
                                     &path))
        return NULL;
    if (fstat(fd, &status))
        return PyErr_SetFromErrno(PyExc_OSError);
    if (identity_size < (Py_ssize_t)ROSPLC_HEADER_SIZE)
        return ch_raise_channel(ROSPLC_ERROR_TOO_SMALL, path);
    error = rosplc_identity_check_kind((const uint8_t *)identity, (uint64_t)status.st_size, 0, 0, &geometry);
    if (error)
        return ch_raise_channel(error, path);
    base = mmap(NULL, geometry.object_size, writable ? PROT_READ | PROT_WRITE : PROT_READ, MAP_SHARED, fd, 0);
    if (base == MAP_FAILED)
        return PyErr_SetFromErrno(PyExc_OSError);
    self = py_allocate(type);
    if (!self) {
        munmap(base, geometry.object_size);
        return NULL;
    }
    self->region = (rosplc_region){base, geometry};
    self->mapped = geometry.object_size;
    self->writable = writable;
    Py_INCREF(path);
    self->path = path;
    return (PyObject *)self;
}

static void region_dealloc(RegionObject *self)
{
    self->pins = 0;
    region_unmap(self);
    Py_XDECREF(self->path);
    py_release(self);
}

static PyObject *region_close(RegionObject *self, PyObject *unused)
{
    (void)unused;
    self->closed = 1;
    region_unmap(self);
    Py_RETURN_NONE;
}

/* `count` words at `offset`, or NULL with an exception: aligned, and inside the mapping. */
static uint32_t *region_at(RegionObject *self, Py_ssize_t offset, Py_ssize_t count)
{
    if (ch_region_usable(self))
        return NULL;
    if (offset < 0 || offset % 4 || count < 0 || (size_t)offset > self->mapped
        || (size_t)count > (self->mapped - (size_t)offset) / 4) {
        PyErr_Format(PyExc_IndexError, "%zd words at offset %zd are not words of this object", count, offset);
        return NULL;
    }
    return (uint32_t *)((uint8_t *)self->region.header + offset);
}

static PyObject *region_word(RegionObject *self, PyObject *args)
{
    Py_ssize_t offset;
    uint32_t *word;
    if (!PyArg_ParseTuple(args, "n:word", &offset) || !(word = region_at(self, offset, 1)))
        return NULL;
    return PyLong_FromUnsignedLong(rosplc_load(word));
}

static PyObject *region_words(RegionObject *self, PyObject *args)
{
    Py_ssize_t offset, count, step = 1;
    uint32_t *words;
    PyObject *result;
    if (!PyArg_ParseTuple(args, "nn|n:words", &offset, &count, &step))
        return NULL;
    if (step < 1 || count < 0 || (count && step > PY_SSIZE_T_MAX / 4 / count))
        return PyErr_Format(PyExc_IndexError, "%zd words in steps of %zd are none", count, step);
    if (!(words = region_at(self, offset, count * step)))
        return NULL;
    if (!(result = PyTuple_New(count)))
        return NULL;
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *value = PyLong_FromUnsignedLong(rosplc_load(words + i * step));
        if (!value) {
            Py_DECREF(result);
            return NULL;
        }
        PyTuple_SetItem(result, i, value);
    }
    return result;
}

static int region_writable(RegionObject *self)
{
    if (self->writable)
        return 1;
    ch_raise_channel(ROSPLC_ERROR_READ_ONLY, self->path);
    return 0;
}

static PyObject *region_store(RegionObject *self, PyObject *args)
{
    Py_ssize_t offset;
    PyObject *object;
    uint32_t *word, value;
    if (!PyArg_ParseTuple(args, "nO:store", &offset, &object) || ch_as_u32(object, "value", &value)
        || !(word = region_at(self, offset, 1)) || !region_writable(self))
        return NULL;
    rosplc_store(word, value);
    Py_RETURN_NONE;
}

static PyObject *region_read(RegionObject *self, PyObject *args)
{
    Py_ssize_t offset, size;
    if (!PyArg_ParseTuple(args, "nn:read", &offset, &size) || ch_region_usable(self))
        return NULL;
    if (offset < 0 || size < 0 || (size_t)offset > self->mapped || (size_t)size > self->mapped - (size_t)offset)
        return PyErr_Format(PyExc_IndexError, "%zd bytes at offset %zd are not in this object", size, offset);
    return PyBytes_FromStringAndSize((const char *)self->region.header + offset, size);
}

static PyObject *region_check(RegionObject *self, PyObject *unused)
{
    int error;
    (void)unused;
    if (ch_region_usable(self))
        return NULL;
    error = rosplc_region_check(&self->region);
    return error ? ch_raise_channel(error, self->path) : Py_NewRef(Py_None);
}

/* One call for what a bridge looks at each second for each object. */
static PyObject *region_held(RegionObject *self, PyObject *args)
{
    const char *path, *lock, *identity;
    unsigned long long device, inode, lock_device, lock_inode;
    Py_ssize_t size;
    int fd;
    struct stat named, locked;
    if (!PyArg_ParseTuple(args, "yyiKKKKy#:held", &path, &lock, &fd, &device, &inode, &lock_device, &lock_inode,
                          &identity, &size)
        || ch_region_usable(self))
        return NULL;
    if (futimens(fd, NULL))
        return PyErr_SetFromErrno(PyExc_OSError);
    /* First the size: looking at an object that was cut to nothing is deadly. */
    return PyBool_FromLong(!lstat(path, &named) && named.st_dev == device && named.st_ino == inode
                           && !lstat(lock, &locked) && locked.st_dev == lock_device && locked.st_ino == lock_inode
                           && (uint64_t)named.st_size >= self->mapped && (size_t)size <= self->mapped
                           && !memcmp(self->region.header, identity, (size_t)size));
}

#define REGION_NUMBER(name, expression) \
    static PyObject *region_##name(RegionObject *self, void *unused) \
    { \
        (void)unused; \
        return PyLong_FromUnsignedLong(expression); \
    }
REGION_NUMBER(record_size, self->region.geometry.record_size)
REGION_NUMBER(slot_count, self->region.geometry.slot_count)
REGION_NUMBER(generation, self->region.geometry.generation)

static PyObject *region_path(RegionObject *self, void *unused)
{
    (void)unused;
    return Py_NewRef(self->path);
}

static PyObject *region_is_writable(RegionObject *self, void *unused)
{
    (void)unused;
    return PyBool_FromLong(self->writable);
}

static PyObject *region_is_closed(RegionObject *self, void *unused)
{
    (void)unused;
    return PyBool_FromLong(self->closed);
}

static PyMethodDef region_methods[] = {
    {"word", (PyCFunction)region_word, METH_VARARGS, "word(offset) -> the control word there."},
    {"words", (PyCFunction)region_words, METH_VARARGS, "words(offset, count, step=1) -> tuple of control words."},
    {"store", (PyCFunction)region_store, METH_VARARGS, "store(offset, value): one 32-bit store."},
    {"read", (PyCFunction)region_read, METH_VARARGS, "read(offset, size) -> bytes; constant parts only."},
    {"held", (PyCFunction)region_held, METH_VARARGS,
     "held(path, lock, fd, device, inode, lock_device, lock_inode, identity) -> whether they lead to object and lock."},
    {"check", (PyCFunction)region_check, METH_NOARGS, "Raise SHM111 or SHM112 if the object is no longer LIVE."},
    {"close", (PyCFunction)region_close, METH_NOARGS, "Unmap; later calls raise ValueError."},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef region_attributes[] = {
    {"record_size", (getter)region_record_size, NULL, "Bytes of a record.", NULL},
    {"slot_count", (getter)region_slot_count, NULL, "Number of slots.", NULL},
    {"generation", (getter)region_generation, NULL, "The object's generation.", NULL},
    {"path", (getter)region_path, NULL, "The object's path, for messages.", NULL},
    {"writable", (getter)region_is_writable, NULL, "Whether the mapping may be written.", NULL},
    {"closed", (getter)region_is_closed, NULL, "Whether close() has been called.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot region_slots[] = {
    {Py_tp_doc, "Region(fd, identity, writable, path): an object of spec/shm-format.md, mapped."},
    {Py_tp_new, (void *)region_new},
    {Py_tp_dealloc, (void *)region_dealloc},
    {Py_tp_methods, region_methods},
    {Py_tp_getset, region_attributes},
    {0, NULL},
};

static PyType_Spec region_spec = {"rosplc._core._native.Region", sizeof(RegionObject), 0, Py_TPFLAGS_DEFAULT,
                                  region_slots};

/* ---------------------------------------------------------------- module functions */

static PyObject *check_identity(PyObject *module, PyObject *args)
{
    Py_buffer view;
    unsigned long long size;
    unsigned int direction, kind = ROSPLC_KIND_TOPIC;
    uint8_t first[ROSPLC_HEADER_SIZE] = {0};
    rosplc_geometry geometry;
    (void)module;
    if (!PyArg_ParseTuple(args, "y*KI|I:check_identity", &view, &size, &direction, &kind))
        return NULL;
    memcpy(first, view.buf, (size_t)view.len < sizeof first ? (size_t)view.len : sizeof first);
    PyBuffer_Release(&view);
    return PyLong_FromLong(rosplc_identity_check_kind(first, size, kind, direction, &geometry));
}

static PyObject *distance(PyObject *module, PyObject *args)
{
    unsigned int a, b, slots;
    (void)module;
    if (!PyArg_ParseTuple(args, "III:distance", &a, &b, &slots))
        return NULL;
    return PyLong_FromUnsignedLong(rosplc_distance(a, b, slots));
}

static PyObject *next_sequence(PyObject *module, PyObject *args)
{
    unsigned int s, slots;
    (void)module;
    if (!PyArg_ParseTuple(args, "II:next_sequence", &s, &slots))
        return NULL;
    return PyLong_FromUnsignedLong(rosplc_next(s, slots));
}

static PyMethodDef functions[] = {
    {"check_identity", check_identity, METH_VARARGS,
     "check_identity(first, size, direction, kind=1) -> the first failing number of section 9, or 0.\n\n"
     "first: the object's first 512 bytes; size: the object's size; direction: 0 accepts both; kind: 0 accepts all."},
    {"distance", distance, METH_VARARGS, "distance(a, b, slot_count) -> messages from a to b (section 7.1)."},
    {"next_sequence", next_sequence, METH_VARARGS, "next_sequence(s, slot_count) -> the one after s (section 7.1)."},
    {NULL, NULL, 0, NULL},
};

int rosplc_add_channel(PyObject *module)
{
    slot_info_type = PyStructSequence_NewType(&slot_info_description);
    if (!slot_info_type || PyModule_AddObjectRef(module, "SlotInfo", (PyObject *)slot_info_type)
        || py_add_type(module, "Region", &region_spec, &ch_region_type) || ch_add_writer(module)
        || ch_add_reader(module))
        return -1;
    return PyModule_AddFunctions(module, functions);
}
