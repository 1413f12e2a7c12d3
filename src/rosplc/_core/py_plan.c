/* _native.Plan and _native.Fault: the plan executor for Python. */
#include "py_plan.h"
#include "py_type.h"

enum { GIL_RELEASE_BYTES = 256 * 1024 }; /* below, giving the GIL away costs more than it frees */

typedef struct {
    PyObject_HEAD
    rp_plan plan;
    rp_op *ops;
} PlanObject;

/* One interpreter imports the module; other files reach the types without it. */
static PyTypeObject *plan_type;
static PyObject *fault_type;

const rp_plan *rp_plan_from_object(PyObject *object)
{
    if (!PyObject_TypeCheck(object, plan_type)) {
        PyErr_SetString(PyExc_TypeError, "a rosplc Plan is required");
        return NULL;
    }
    return &((PlanObject *)object)->plan;
}

PyObject *rp_raise_fault(const rp_fault *fault)
{
    PyObject *arguments = Py_BuildValue("(IIKK)", (unsigned)fault->code, (unsigned)fault->op,
                                        (unsigned long long)fault->size, (unsigned long long)fault->limit);
    if (arguments) {
        PyErr_SetObject(fault_type, arguments);
        Py_DECREF(arguments);
    }
    return NULL;
}

static PyObject *raise_size(Py_ssize_t given, uint64_t wanted)
{
    rp_fault fault = {.code = 9, .op = RP_NO_OP, .size = (uint64_t)given, .limit = wanted};
    return rp_raise_fault(&fault);
}

static int decode(const rp_plan *plan, const uint8_t *wire, size_t size, uint8_t *record, int truncate, uint32_t *flags)
{
    rp_fault fault;
    int result;
    if (size >= GIL_RELEASE_BYTES || plan->record_size >= GIL_RELEASE_BYTES) {
        Py_BEGIN_ALLOW_THREADS
        result = rp_decode(plan, wire, size, record, truncate, flags, &fault);
        Py_END_ALLOW_THREADS
    } else {
        result = rp_decode(plan, wire, size, record, truncate, flags, &fault);
    }
    if (result)
        rp_raise_fault(&fault);
    return result;
}

static int encode(const rp_plan *plan, const uint8_t *record, uint8_t *out, size_t size, size_t *used)
{
    rp_fault fault;
    int result;
    if (plan->record_size >= GIL_RELEASE_BYTES) {
        Py_BEGIN_ALLOW_THREADS
        result = rp_encode(plan, record, out, size, used, &fault);
        Py_END_ALLOW_THREADS
    } else {
        result = rp_encode(plan, record, out, size, used, &fault);
    }
    if (result)
        rp_raise_fault(&fault);
    return result;
}

static PyObject *plan_decode(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const rp_plan *plan = &((PlanObject *)self)->plan;
    int truncate = count == 2 ? PyObject_IsTrue(args[1]) : 0;
    Py_buffer wire;
    uint32_t flags;
    PyObject *record, *result = NULL;
    if (count < 1 || count > 2)
        return PyErr_Format(PyExc_TypeError, "decode(data, truncate=False) takes 1 or 2 arguments");
    if (truncate < 0 || PyObject_GetBuffer(args[0], &wire, PyBUF_SIMPLE))
        return NULL;
    record = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)plan->record_size);
    if (record) {
        if (!decode(plan, wire.buf, (size_t)wire.len, (uint8_t *)PyBytes_AsString(record), truncate, &flags)) {
            PyObject *number = PyLong_FromUnsignedLong(flags);
            if (number) {
                result = PyTuple_Pack(2, record, number);
                Py_DECREF(number);
            }
        }
        Py_DECREF(record);
    }
    PyBuffer_Release(&wire);
    return result;
}

static PyObject *plan_decode_into(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const rp_plan *plan = &((PlanObject *)self)->plan;
    int truncate = count == 3 ? PyObject_IsTrue(args[2]) : 0;
    Py_buffer wire, record;
    uint32_t flags;
    PyObject *result = NULL;
    if (count < 2 || count > 3)
        return PyErr_Format(PyExc_TypeError, "decode_into(data, out, truncate=False) takes 2 or 3 arguments");
    if (truncate < 0 || PyObject_GetBuffer(args[0], &wire, PyBUF_SIMPLE))
        return NULL;
    if (!PyObject_GetBuffer(args[1], &record, PyBUF_WRITABLE)) {
        if ((uint64_t)record.len != plan->record_size)
            raise_size(record.len, plan->record_size);
        else if (!decode(plan, wire.buf, (size_t)wire.len, record.buf, truncate, &flags))
            result = PyLong_FromUnsignedLong(flags);
        PyBuffer_Release(&record);
    }
    PyBuffer_Release(&wire);
    return result;
}

static PyObject *plan_encode(PyObject *self, PyObject *argument)
{
    const rp_plan *plan = &((PlanObject *)self)->plan;
    uint8_t small[4096], *out = small;
    Py_buffer record;
    size_t used;
    PyObject *result = NULL;
    if (PyObject_GetBuffer(argument, &record, PyBUF_SIMPLE))
        return NULL;
    if ((uint64_t)record.len != plan->record_size) {
        raise_size(record.len, plan->record_size);
    } else if (plan->bound > sizeof small && !(out = PyMem_Malloc(plan->bound))) {
        PyErr_NoMemory();
    } else {
        if (!encode(plan, record.buf, out, plan->bound, &used))
            result = PyBytes_FromStringAndSize((const char *)out, (Py_ssize_t)used);
        if (out != small)
            PyMem_Free(out);
    }
    PyBuffer_Release(&record);
    return result;
}

static PyObject *plan_encode_into(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const rp_plan *plan = &((PlanObject *)self)->plan;
    Py_buffer record, out;
    size_t used;
    PyObject *result = NULL;
    if (count != 2)
        return PyErr_Format(PyExc_TypeError, "encode_into(record, out) takes 2 arguments");
    if (PyObject_GetBuffer(args[0], &record, PyBUF_SIMPLE))
        return NULL;
    if (!PyObject_GetBuffer(args[1], &out, PyBUF_WRITABLE)) {
        if ((uint64_t)record.len != plan->record_size)
            raise_size(record.len, plan->record_size);
        else if (!encode(plan, record.buf, out.buf, (size_t)out.len, &used))
            result = PyLong_FromSize_t(used);
        PyBuffer_Release(&out);
    }
    PyBuffer_Release(&record);
    return result;
}

static PyObject *plan_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    Py_buffer blob;
    PlanObject *self = NULL;
    rp_op *ops;
    const char *reason = "plan is shorter than its head";
    if (keywords && PyDict_Size(keywords))
        return PyErr_Format(PyExc_TypeError, "Plan(blob) takes no keyword arguments");
    if (!PyArg_ParseTuple(args, "y*:Plan", &blob))
        return NULL;
    ops = PyMem_Malloc((size_t)blob.len + 1);
    if (!ops) {
        PyErr_NoMemory();
    } else {
        rp_plan plan;
        reason = rp_plan_load(&plan, ops, blob.buf, (size_t)blob.len);
        if (reason) {
            PyErr_SetString(PyExc_ValueError, reason);
        } else {
            self = py_allocate(type);
            if (self) {
                self->plan = plan;
                self->ops = ops;
                ops = NULL;
            }
        }
        PyMem_Free(ops);
    }
    PyBuffer_Release(&blob);
    return (PyObject *)self;
}

static void plan_dealloc(PyObject *self)
{
    PyMem_Free(((PlanObject *)self)->ops);
    py_release(self);
}

static PyObject *plan_record_size(PyObject *self, void *closure)
{
    (void)closure;
    return PyLong_FromUnsignedLong(((PlanObject *)self)->plan.record_size);
}

static PyObject *plan_encoded_bound(PyObject *self, void *closure)
{
    (void)closure;
    return PyLong_FromSize_t(rp_encoded_bound(&((PlanObject *)self)->plan));
}

static PyMethodDef plan_methods[] = {
    {"decode", (PyCFunction)(void (*)(void))plan_decode, METH_FASTCALL,
     "decode(data, truncate=False) -> (record, flags)"},
    {"decode_into", (PyCFunction)(void (*)(void))plan_decode_into, METH_FASTCALL,
     "decode_into(data, out, truncate=False) -> flags"},
    {"encode", plan_encode, METH_O, "encode(record) -> bytes"},
    {"encode_into", (PyCFunction)(void (*)(void))plan_encode_into, METH_FASTCALL,
     "encode_into(record, out) -> bytes used"},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef plan_attributes[] = {
    {"record_size", plan_record_size, NULL, "Bytes of a record.", NULL},
    {"encoded_bound", plan_encoded_bound, NULL, "The most bytes that a record takes on the wire.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot plan_slots[] = {
    {Py_tp_doc, "Plan(blob): wire bytes to record and back; ValueError if the blob is not a sound plan."},
    {Py_tp_new, plan_new},
    {Py_tp_dealloc, plan_dealloc},
    {Py_tp_methods, plan_methods},
    {Py_tp_getset, plan_attributes},
    {0, NULL},
};

static PyType_Spec plan_spec = {
    .name = "rosplc._core._native.Plan",
    .basicsize = sizeof(PlanObject),
    .flags = Py_TPFLAGS_DEFAULT,
    .slots = plan_slots,
};

int rosplc_add_plan(PyObject *module)
{
    fault_type = PyErr_NewExceptionWithDoc("rosplc._core._native.Fault",
                                           "A message or record was refused: (code, op, size, limit).", NULL, NULL);
    if (!fault_type || py_add_type(module, "Plan", &plan_spec, &plan_type))
        return -1;
    return PyModule_AddObjectRef(module, "Fault", fault_type);
}
