/* _native.Shape, Field and View: the fields of a record as Python objects.
 *
 * Who builds the shapes (rosplc/layout/view.py) is not trusted: no field leaves its struct. What records hold
 * is never trusted: counts are clamped, strings end at their capacity.
 */
#include "py_record.h"

static const number_kind kinds[] = {
    {"bool", "?", '?', 1},       {"byte", "B", 'O', 1},        {"char", "B", 'O', 1},       {"uint8", "B", 'B', 1},
    {"int8", "b", 'b', 1},       {"uint16", "BHILQ", 'B', 2},  {"int16", "bhilq", 'b', 2},  {"uint32", "BHILQ", 'B', 4},
    {"int32", "bhilq", 'b', 4},  {"uint64", "BHILQ", 'B', 8},  {"int64", "bhilq", 'b', 8},  {"float32", "fd", 'f', 4},
    {"float64", "fd", 'd', 8},   {"string", "", 's', 0},
};

static PyTypeObject *shape_type, *field_type;
PyTypeObject *rp_view_type;
PyObject *rp_mapping_type, *rp_layout_error;

/* How nested structs are returned: as views of bytes of `owner`, or as dicts, whose arrays have at most
 * `most` elements where an `excerpt` type is given. */
typedef struct {
    PyObject *owner;
    PyObject *excerpt;
    uint32_t most;
} reading;

static PyObject *get_dict(const ShapeObject *shape, const uint8_t *data, const reading *how);

static PyObject *view_new(ShapeObject *shape, const uint8_t *data, PyObject *owner)
{
    ViewObject *view = (ViewObject *)PyType_GenericAlloc(shape->view, 0);
    if (view) {
        view->shape = (ShapeObject *)Py_NewRef((PyObject *)shape);
        view->data = data;
        view->owner = Py_NewRef(owner);
    }
    return (PyObject *)view;
}

static PyObject *get_one(const FieldObject *field, const uint8_t *from, const reading *how)
{
    const number_kind *kind = field->kind;
    uint64_t bits = 0;
    double real;
    float single;
    if (!kind)
        return how->owner ? view_new(field->shape, from, how->owner) : get_dict(field->shape, from, how);
    switch (kind->code) {
    case 's': {
        const uint8_t *nul = memchr(from, 0, field->stride - 1);
        Py_ssize_t size = nul ? nul - from : (Py_ssize_t)field->stride - 1;
        return PyUnicode_DecodeUTF8((const char *)from, size, "surrogateescape");
    }
    case 'd':
        memcpy(&real, from, sizeof real);
        return PyFloat_FromDouble(real);
    case 'f':
        memcpy(&single, from, sizeof single);
        return PyFloat_FromDouble((double)single);
    case '?':
        return PyBool_FromLong(*from);
    }
    memcpy(&bits, from, kind->size);
    if (kind->code != 'b')
        return bits > LONG_MAX ? PyLong_FromUnsignedLongLong(bits) : PyLong_FromLong((long)bits);
    return PyLong_FromLongLong((int64_t)(bits << (64 - 8 * kind->size)) >> (64 - 8 * kind->size));
}

static PyObject *get_field(const FieldObject *field, const uint8_t *base, const reading *how)
{
    const uint8_t *from = base + field->at;
    uint32_t count = field->n, shown;
    PyObject *list;
    if (field->many == SINGLE)
        return get_one(field, from, how);
    if (field->many == SEQUENCE) {
        uint32_t there = rp_load32(base + field->count_at);
        count = there < count ? there : count;
    }
    shown = how->excerpt && count > how->most ? how->most : count;
    list = PyList_New((Py_ssize_t)shown);
    for (uint32_t i = 0; list && i < shown; i++) {
        PyObject *item = get_one(field, from + (size_t)i * field->stride, how);
        if (item)
            PyList_SetItem(list, (Py_ssize_t)i, item);
        else
            Py_CLEAR(list);
    }
    return list && shown < count ? PyObject_CallFunction(how->excerpt, "NI", list, (unsigned)count) : list;
}

static PyObject *get_dict(const ShapeObject *shape, const uint8_t *data, const reading *how)
{
    PyObject *dict = PyDict_New();
    Py_ssize_t count = PyTuple_Size(shape->fields);
    for (Py_ssize_t i = 0; dict && i < count; i++) {
        const FieldObject *field = field_of(shape, i);
        PyObject *value = get_field(field, data, how);
        if (!value || PyDict_SetItem(dict, field->name, value))
            Py_CLEAR(dict);
        Py_XDECREF(value);
    }
    return dict;
}

/* ---------------------------------------------------------------- View */

static void view_dealloc(ViewObject *self)
{
    Py_DECREF(self->owner);
    Py_DECREF((PyObject *)self->shape);
    py_release(self);
}

static PyObject *view_getattr(PyObject *self, PyObject *name)
{
    PyObject *value = PyObject_GenericGetAttr(self, name);
    if (!value && PyErr_ExceptionMatches(PyExc_AttributeError) && PyUnicode_Check(name)
        && PyUnicode_GetLength(name) && PyUnicode_ReadChar(name, 0) != '_') {
        PyErr_Clear();
        PyErr_Format(PyExc_AttributeError, "%U has no field %R", ((ViewObject *)self)->shape->type_name, name);
    }
    return value;
}

static PyObject *view_copy(ViewObject *self, PyObject *unused)
{
    (void)unused;
    return view_new(self->shape, self->data, self->owner);
}

static PyObject *view_deepcopy(ViewObject *self, PyObject *memo)
{
    PyObject *bytes = PyBytes_FromStringAndSize((const char *)self->data, (Py_ssize_t)self->shape->size), *copy;
    (void)memo;
    copy = bytes ? rp_shape_view((PyObject *)self->shape, bytes) : NULL;
    Py_XDECREF(bytes);
    return copy;
}

static PyObject *view_to_dict(ViewObject *self, PyObject *const *args, Py_ssize_t count)
{
    reading how = {NULL, NULL, 0};
    if (count != 0 && count != 2)
        return PyErr_Format(PyExc_TypeError, "_to_dict() takes 0 or 2 arguments");
    if (count) {
        if (ch_as_u32(args[0], "elements", &how.most))
            return NULL;
        how.excerpt = args[1];
    }
    return get_dict(self->shape, self->data, &how);
}

static PyMethodDef view_methods[] = {
    {"__copy__", (PyCFunction)view_copy, METH_NOARGS, "Return another view of the same bytes."},
    {"__deepcopy__", (PyCFunction)view_deepcopy, METH_O, "Return a view of a copy of the bytes, which stays as it is."},
    {"_to_dict", (PyCFunction)(void (*)(void))view_to_dict, METH_FASTCALL,
     "_to_dict() or _to_dict(elements, excerpt): the message as nested dicts and lists."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot view_slots[] = {
    {Py_tp_doc, "What rosplc.layout.RecordView is made of."},
    {Py_tp_dealloc, (void *)view_dealloc},
    {Py_tp_getattro, (void *)view_getattr},
    {Py_tp_methods, view_methods},
    {0, NULL},
};

static PyType_Spec view_spec = {"rosplc._core._native.View", sizeof(ViewObject), 0,
                                Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_DISALLOW_INSTANTIATION,
                                view_slots};

/* ---------------------------------------------------------------- Field */

static void field_dealloc(FieldObject *self)
{
    Py_XDECREF(self->name);
    Py_XDECREF(self->other);
    Py_XDECREF((PyObject *)self->shape);
    py_release(self);
}

/* Any view may come here, through the class of another struct. */
static PyObject *field_get(PyObject *self, PyObject *object, PyObject *type)
{
    const FieldObject *field = (FieldObject *)self;
    ViewObject *view = (ViewObject *)object;
    (void)type;
    if (!object)
        return Py_NewRef(self);
    if (!PyObject_TypeCheck(object, rp_view_type) || view->shape->size < field->end)
        return PyErr_Format(PyExc_TypeError, "%R is read from views of its own type", field->name);
    return get_field(field, view->data, &(reading){view->owner, NULL, 0});
}

static PyType_Slot field_slots[] = {
    {Py_tp_doc, "A field of a Shape, as an attribute of its views."},
    {Py_tp_dealloc, (void *)field_dealloc},
    {Py_tp_descr_get, (void *)field_get},
    {0, NULL},
};

static PyType_Spec field_spec = {"rosplc._core._native.Field", sizeof(FieldObject), 0,
                                 Py_TPFLAGS_DEFAULT | Py_TPFLAGS_DISALLOW_INSTANTIATION, field_slots};

/* From (name, other name or None, kind or Shape, at, stride, n or -1, count_at or -1). */
static FieldObject *field_new(PyObject *item, uint32_t size)
{
    PyObject *name, *other, *what;
    unsigned int at, stride;
    Py_ssize_t n, count_at;
    const char *kind = NULL;
    uint64_t end;
    FieldObject *self;
    if (!PyArg_ParseTuple(item, "UOOIInn:Field", &name, &other, &what, &at, &stride, &n, &count_at)
        || (PyUnicode_Check(what) && !(kind = PyUnicode_AsUTF8AndSize(what, NULL)))
        || !(self = PyObject_New(FieldObject, field_type)))
        return NULL;
    *self = (FieldObject){.ob_base = self->ob_base, .at = at, .stride = stride};
    self->name = Py_NewRef(name);
    PyUnicode_InternInPlace(&self->name);
    self->other = other == Py_None ? NULL : Py_NewRef(other);
    self->many = n < 0 ? SINGLE : count_at < 0 ? ARRAY : SEQUENCE;
    self->n = n < 0 ? 1 : (uint32_t)n;
    self->count_at = count_at < 0 ? 0 : (uint32_t)count_at;
    if (PyObject_TypeCheck(what, shape_type))
        self->shape = (ShapeObject *)Py_NewRef(what);
    for (size_t i = 0; kind && i < sizeof kinds / sizeof *kinds; i++)
        if (!strcmp(kind, kinds[i].name))
            self->kind = kinds + i;
    end = rp_add(at, rp_times(self->n, stride));
    self->end = (uint32_t)end;
    if (n <= RP_MAX_RECORD && count_at <= RP_MAX_RECORD && end <= size
        && (self->many != SEQUENCE || self->count_at + 4 <= size)
        && (!self->other || (PyUnicode_Check(other) && (!is_genpy(other) || stride == 4)))
        && (self->shape ? self->shape->size <= stride
            : self->kind && (self->kind->code == 's' ? stride > 0 : self->kind->size == stride))) {
        if (self->many == SEQUENCE && self->end < self->count_at + 4)
            self->end = self->count_at + 4;
        return self;
    }
    PyErr_Format(PyExc_ValueError, "%R is not a field of a record of %lu bytes", item, (unsigned long)size);
    Py_DECREF((PyObject *)self);
    return NULL;
}

/* ---------------------------------------------------------------- Shape */

static void shape_dealloc(ShapeObject *self)
{
    Py_XDECREF(self->type_name);
    Py_XDECREF(self->fields);
    Py_XDECREF(self->initial);
    Py_XDECREF((PyObject *)self->view);
    py_release(self);
}

/* Its initial bytes: those of the structs in it, and `defaults`. */
static int shape_fill(ShapeObject *self, PyObject *defaults)
{
    misfit m = {NULL, NULL};
    uint8_t *image;
    if (!(self->initial = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)self->size)))
        return -1;
    image = (uint8_t *)PyBytes_AsString(self->initial);
    memset(image, 0, self->size);
    for (Py_ssize_t i = 0; i < PyTuple_Size(self->fields); i++) {
        const FieldObject *field = field_of(self, i);
        if (field->shape && field->many != SEQUENCE)
            rp_lay_initial(field, image + field->at, field->n);
    }
    if (!rp_put_struct(self, image, defaults, &m))
        return 0;
    rp_raise_misfit(self, &m);
    return -1;
}

static PyObject *shape_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    PyObject *type_name, *fields, *defaults, *base, *attributes, *names;
    unsigned int size;
    Py_ssize_t count;
    ShapeObject *self;
    if (keywords && PyDict_Size(keywords))
        return PyErr_Format(PyExc_TypeError, "Shape() takes no keyword arguments");
    if (!PyArg_ParseTuple(args, "UIO!O!O!:Shape", &type_name, &size, &PyTuple_Type, &fields, &PyDict_Type, &defaults,
                          &PyType_Type, &base))
        return NULL;
    if (size > RP_MAX_RECORD || !PyType_IsSubtype((PyTypeObject *)base, rp_view_type))
        return PyErr_Format(PyExc_ValueError, "the size or the base class is not valid");
    if (!(self = PyObject_New(ShapeObject, type)))
        return NULL;
    count = PyTuple_Size(fields);
    *self = (ShapeObject){.ob_base = self->ob_base, .type_name = Py_NewRef(type_name), .size = size};
    self->fields = PyTuple_New(count);
    names = PyTuple_New(count);
    attributes = Py_BuildValue("{s()sO}", "__slots__", "_type_name", type_name);
    for (Py_ssize_t i = 0; self->fields && i < count; i++) {
        FieldObject *field = field_new(PyTuple_GetItem(fields, i), size);
        if (!field)
            break;
        PyTuple_SetItem(self->fields, i, (PyObject *)field);
        if (!names || !attributes || PyTuple_SetItem(names, i, Py_NewRef(field->name))
            || PyDict_SetItem(attributes, field->name, (PyObject *)field)
            || (field->other && !is_genpy(field->other)
                && PyDict_SetItem(attributes, field->other, (PyObject *)field)))
            break;
    }
    if (!PyErr_Occurred() && !PyDict_SetItemString(attributes, "_names", names))
        self->view = (PyTypeObject *)PyObject_CallFunction((PyObject *)&PyType_Type, "s(O)O", "RecordView", base,
                                                           attributes);
    Py_XDECREF(attributes);
    Py_XDECREF(names);
    if (!self->view || shape_fill(self, defaults)) {
        Py_DECREF((PyObject *)self);
        return NULL;
    }
    return (PyObject *)self;
}

int rp_shape_pack(PyObject *shape, PyObject *value, uint8_t *record)
{
    ShapeObject *self = (ShapeObject *)shape;
    misfit m = {NULL, NULL};
    memcpy(record, PyBytes_AsString(self->initial), self->size);
    if (!rp_put_struct(self, record, value, &m))
        return 0;
    rp_raise_misfit(self, &m);
    return -1;
}

PyObject *rp_shape_view(PyObject *shape, PyObject *bytes)
{
    return view_new((ShapeObject *)shape, (const uint8_t *)PyBytes_AsString(bytes), bytes);
}

Py_ssize_t rp_shape_size(PyObject *shape)
{
    if (PyObject_TypeCheck(shape, shape_type))
        return (Py_ssize_t)((ShapeObject *)shape)->size;
    PyErr_SetString(PyExc_TypeError, "a rosplc Shape is required");
    return -1;
}

static PyObject *shape_pack(ShapeObject *self, PyObject *value)
{
    PyObject *record = PyByteArray_FromStringAndSize(NULL, (Py_ssize_t)self->size);
    if (record && rp_shape_pack((PyObject *)self, value, (uint8_t *)PyByteArray_AsString(record)))
        Py_CLEAR(record);
    return record;
}

static PyObject *shape_view(ShapeObject *self, PyObject *buffer)
{
    PyObject *owner = PyBytes_CheckExact(buffer) ? Py_NewRef(buffer) : PyMemoryView_FromObject(buffer), *view = NULL;
    Py_buffer bytes;
    if (owner && !PyObject_GetBuffer(owner, &bytes, PyBUF_SIMPLE)) {
        if (bytes.len < (Py_ssize_t)self->size) {
            PyObject *what = PyUnicode_FromFormat("the buffer has %zd bytes, but a record has %u", bytes.len, self->size);
            rp_raise_misfit(self, &(misfit){what, NULL});
        } else {
            view = view_new(self, bytes.buf, owner);
        }
        PyBuffer_Release(&bytes); /* the owner keeps the bytes where they are */
    }
    Py_XDECREF(owner);
    return view;
}

static PyObject *shape_initial(ShapeObject *self, void *unused)
{
    (void)unused;
    return Py_NewRef(self->initial);
}

static PyMethodDef shape_methods[] = {
    {"pack", (PyCFunction)shape_pack, METH_O, "pack(value) -> the record, a bytearray. Raises LayoutError LAY006."},
    {"view", (PyCFunction)shape_view, METH_O, "view(buffer) -> a view of the record at its start."},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef shape_attributes[] = {
    {"initial", (getter)shape_initial, NULL, "The record of a message that nobody has filled.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot shape_slots[] = {
    {Py_tp_doc, "Shape(type_name, size, fields, defaults, base): a struct's fields, checked."},
    {Py_tp_new, (void *)shape_new},
    {Py_tp_dealloc, (void *)shape_dealloc},
    {Py_tp_methods, shape_methods},
    {Py_tp_getset, shape_attributes},
    {0, NULL},
};

static PyType_Spec shape_spec = {"rosplc._core._native.Shape", sizeof(ShapeObject), 0, Py_TPFLAGS_DEFAULT, shape_slots};

int rosplc_add_record(PyObject *module)
{
    PyObject *abc = PyImport_ImportModule("collections.abc"), *errors = PyImport_ImportModule("rosplc.errors");
    rp_mapping_type = abc ? PyObject_GetAttrString(abc, "Mapping") : NULL;
    rp_layout_error = errors ? PyObject_GetAttrString(errors, "LayoutError") : NULL;
    Py_XDECREF(abc);
    Py_XDECREF(errors);
    return !rp_mapping_type || !rp_layout_error || py_add_type(module, "View", &view_spec, &rp_view_type)
                   || py_add_type(module, "Field", &field_spec, &field_type)
                   || py_add_type(module, "Shape", &shape_spec, &shape_type)
               ? -1
               : 0;
}
