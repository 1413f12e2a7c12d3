/* Values into a record. This runs Python code of the values (__float__, __iter__, properties), which never
 * sees the record that is being filled, but may change the value meanwhile. */
#include "py_record.h"

/* Replace the exception that tells that a value does not fit by `what` (stolen). Returns -1. */
static int refuse(misfit *m, PyObject *what)
{
    if (what)
        PyErr_Clear();
    m->what = what;
    return -1;
}

/* "<value> is not a valid <kind>", or of a type: the value's repr is cut. */
static int is_no(misfit *m, PyObject *value, const char *kind, PyObject *type)
{
    PyObject *text, *name = NULL, *what = NULL;
    PyErr_Clear();
    if ((text = PyObject_Repr(value)) && (name = PyObject_GetAttrString((PyObject *)Py_TYPE(value), "__name__")))
        what = PyUnicode_FromFormat(PyUnicode_GetLength(text) <= 60 ? "%U (%S) is not a valid %V"
                                                                    : "%.57U... (%S) is not a valid %V",
                                    text, name, type, kind);
    Py_XDECREF(name);
    Py_XDECREF(text);
    return refuse(m, what);
}

/* A conversion failed: a misfit, unless the value's own code raised something else. */
static int not_convertible(misfit *m, PyObject *value, const char *kind)
{
    if (PyErr_ExceptionMatches(PyExc_TypeError) || PyErr_ExceptionMatches(PyExc_ValueError)
        || PyErr_ExceptionMatches(PyExc_OverflowError))
        return is_no(m, value, kind, NULL);
    return -1;
}

/* Put a part in front of a misfit's path (stolen). Returns -1. */
static int below(misfit *m, PyObject *part)
{
    PyObject *rest = m->path;
    if (!m->what) {
        Py_XDECREF(part);
        return -1;
    }
    if (part && rest) {
        int element = PyUnicode_ReadChar(rest, 0) == '[';
        m->path = PyUnicode_FromFormat("%U%s%U", part, element ? "" : ".", rest);
        Py_DECREF(part);
    } else {
        m->path = part;
    }
    Py_XDECREF(rest);
    if (!m->path)
        Py_CLEAR(m->what);
    return -1;
}

void rp_raise_misfit(ShapeObject *shape, misfit *m)
{
    PyObject *arguments, *names = NULL, *error = NULL;
    if (m->what) {
        arguments = Py_BuildValue("(sO)", "LAY006", m->what);
        names = Py_BuildValue("{sO}", "where", m->path ? m->path : shape->type_name);
        if (arguments && names && (error = PyObject_Call(rp_layout_error, arguments, names)))
            PyErr_SetObject(rp_layout_error, error);
        Py_XDECREF(error);
        Py_XDECREF(names);
        Py_XDECREF(arguments);
    }
    Py_CLEAR(m->what);
    Py_CLEAR(m->path);
}

static int put_real(const number_kind *kind, uint8_t *to, PyObject *value, misfit *m)
{
    double real;
    float single;
    if (PyFloat_Check(value)) {
        real = PyFloat_AsDouble(value);
    } else {
        PyObject *number = NULL;
        if (PyUnicode_Check(value) || PyBytes_Check(value) || PyByteArray_Check(value))
            return is_no(m, value, kind->name, NULL);
        if (!(number = PyNumber_Float(value)))
            return not_convertible(m, value, kind->name);
        real = PyFloat_AsDouble(number);
        Py_DECREF(number);
    }
    if (kind->code == 'd') {
        memcpy(to, &real, sizeof real);
        return 0;
    }
    single = (float)real;
    if (__builtin_isinf(single) && !__builtin_isinf(real))
        return is_no(m, value, kind->name, NULL);
    memcpy(to, &single, sizeof single);
    return 0;
}

/* 1: `value`, no int, is a truth value of numpy, which has no __index__. */
static int is_truth(PyObject *value)
{
    PyObject *name = PyObject_GetAttrString((PyObject *)Py_TYPE(value), "__name__");
    int found = !name ? -1
                      : PyUnicode_Check(name)
                            && (!PyUnicode_CompareWithASCIIString(name, "bool_")
                                || !PyUnicode_CompareWithASCIIString(name, "bool"));
    Py_XDECREF(name);
    return found;
}

static int put_number(const number_kind *kind, uint8_t *to, PyObject *value, misfit *m)
{
    PyObject *number;
    uint64_t bits = 0;
    int truth, fits;
    if (kind->code == 'd' || kind->code == 'f')
        return put_real(kind, to, value, m);
    if (kind->code == '?' && !PyLong_Check(value) && (truth = is_truth(value))) {
        truth = truth < 0 ? truth : PyObject_IsTrue(value);
        *to = truth > 0;
        return truth < 0 ? not_convertible(m, value, kind->name) : 0;
    }
    if (kind->code == 'O' && PyBytes_Check(value) && PyBytes_Size(value) == 1) { /* rclpy's form of a byte */
        *to = (uint8_t)PyBytes_AsString(value)[0];
        return 0;
    }
    number = PyLong_Check(value) ? Py_NewRef(value) : PyNumber_Index(value);
    if (!number)
        return not_convertible(m, value, kind->name);
    if (kind->code == 'B') {
        bits = PyLong_AsUnsignedLongLong(number);
        fits = kind->size == 8 || bits >> (8 * kind->size) == 0;
    } else {
        int64_t least = -128, most = 255, whole = PyLong_AsLongLong(number); /* rospy's byte is signed */
        bits = (uint64_t)whole;
        if (kind->code == '?') {
            least = 0;
            most = 1;
        } else if (kind->code == 'b') {
            most = INT64_MAX >> (64 - 8 * kind->size);
            least = -most - 1;
        }
        fits = whole >= least && whole <= most;
    }
    Py_DECREF(number);
    if (bits == UINT64_MAX && PyErr_Occurred())
        return not_convertible(m, value, kind->name);
    if (!fits)
        return is_no(m, value, kind->name, NULL);
    memcpy(to, &bits, kind->size);
    return 0;
}

static int put_string(const FieldObject *field, uint8_t *to, PyObject *value, misfit *m)
{
    Py_ssize_t size = -1, capacity = (Py_ssize_t)field->stride - 1;
    PyObject *encoded = NULL;
    const char *text = NULL;
    char *own = NULL;
    int result = 0;
    if (PyUnicode_Check(value)) {
        if (!(text = PyUnicode_AsUTF8AndSize(value, &size))) { /* surrogates stand for other bytes */
            PyErr_Clear();
            if (!(encoded = PyUnicode_AsEncodedString(value, "utf-8", "surrogateescape")))
                return PyErr_ExceptionMatches(PyExc_UnicodeEncodeError) ? is_no(m, value, "Unicode string", NULL) : -1;
        }
    } else if (PyByteArray_Check(value)) {
        text = PyByteArray_AsString(value);
        size = PyByteArray_Size(value);
    } else if (PyBytes_Check(value)) {
        encoded = Py_NewRef(value);
    } else {
        return is_no(m, value, "string", NULL);
    }
    if (encoded && !PyBytes_AsStringAndSize(encoded, &own, &size))
        text = own;
    if (!text)
        result = -1;
    else if (memchr(text, 0, (size_t)size))
        result = refuse(m, PyUnicode_FromString("a string cannot contain a NUL"));
    else if (size > capacity)
        result = refuse(m, PyUnicode_FromFormat("the string has %zd bytes, but its limit is %zd", size, capacity));
    else {
        memcpy(to, text, (size_t)size);
        memset(to + size, 0, (size_t)(capacity + 1 - size));
    }
    Py_XDECREF(encoded);
    return result;
}

static int put_one(const FieldObject *field, uint8_t *to, PyObject *value, misfit *m)
{
    if (!field->kind)
        return rp_put_struct(field->shape, to, value, m);
    return field->kind->code == 's' ? put_string(field, to, value, m) : put_number(field->kind, to, value, m);
}

static int is_mapping(PyObject *value)
{
    return PyDict_Check(value) ? 1 : PyObject_IsInstance(value, rp_mapping_type);
}

/* Whether a buffer is one row of numbers; others, as numpy's in the other byte order, are asked for a list. */
static int is_row(const Py_buffer *buffer, const char **letter)
{
    const char *at = buffer->format ? buffer->format : "B";
    *letter = at + strspn(at, "<=@");
    return buffer->ndim == 1 && strlen(*letter) == 1 && strchr("bBhHiIlLqQfd?", **letter);
}

/* A list or tuple of the elements; NULL with a misfit or exception. Sets `row` and returns None for a buffer
 * whose bytes are those of the record: it is to be released. */
static PyObject *elements_of(const FieldObject *field, PyObject *value, Py_buffer *row, misfit *m)
{
    PyObject *made = NULL, *list = NULL;
    const char *letter;
    int mapping;
    if (PyList_Check(value) || PyTuple_Check(value))
        return Py_NewRef(value);
    if ((mapping = PyUnicode_Check(value) ? 1 : is_mapping(value))) {
        if (mapping > 0)
            is_no(m, value, "sequence", NULL);
        return NULL;
    }
    if (PyObject_CheckBuffer(value) && !PyObject_GetBuffer(value, row, PyBUF_FULL_RO)) {
        int numbers = is_row(row, &letter);
        if (numbers && field->kind && *field->kind->bulk && row->itemsize == field->kind->size
            && letter - (row->format ? row->format : letter) < 2 && strchr(field->kind->bulk, *letter))
            return Py_NewRef(Py_None);
        PyBuffer_Release(row);
        if (numbers && !(made = PyMemoryView_FromObject(value)))
            return NULL;
    } else if (PyErr_Occurred()) {
        if (!PyErr_ExceptionMatches(PyExc_BufferError) && !PyErr_ExceptionMatches(PyExc_TypeError)
            && !PyErr_ExceptionMatches(PyExc_ValueError))
            return NULL;
        PyErr_Clear();
    }
    row->obj = NULL;
    if (!made)
        made = Py_NewRef(value);
    if (PyObject_HasAttrString(made, "tolist")) { /* numpy: its own numbers would be converted one by one */
        PyObject *plain = PyObject_CallMethod(made, "tolist", NULL);
        Py_DECREF(made);
        if (!(made = plain))
            return NULL;
    }
    if (!PyType_GetSlot(Py_TYPE(made), Py_tp_iter))
        is_no(m, made, "sequence", NULL);
    else
        list = PySequence_List(made);
    Py_DECREF(made);
    return list;
}

void rp_lay_initial(const FieldObject *field, uint8_t *to, size_t count)
{
    const char *initial = PyBytes_AsString(field->shape->initial);
    for (size_t i = 0; i < count; i++)
        memcpy(to + i * field->stride, initial, field->shape->size);
}

static int put_many(const FieldObject *field, uint8_t *base, PyObject *value, misfit *m)
{
    Py_buffer row = {.obj = NULL};
    PyObject *items = elements_of(field, value, &row, m);
    uint8_t *to = base + field->at;
    Py_ssize_t count;
    int failed = 0, listed;
    if (!items)
        return -1;
    listed = PyList_Check(items);
    count = row.obj ? row.len / row.itemsize : listed ? PyList_Size(items) : PyTuple_Size(items);
    if (count < 0) {
        failed = -1;
    } else if (field->many == ARRAY && count != (Py_ssize_t)field->n) {
        failed = refuse(m, PyUnicode_FromFormat("got %zd elements for an array of %u", count, field->n));
    } else if (count > (Py_ssize_t)field->n) {
        failed = refuse(m, PyUnicode_FromFormat("%zd elements, but the limit is %u", count, field->n));
    } else if (field->many == SEQUENCE) {
        size_t before = rp_load32(base + field->count_at), size = (size_t)count;
        before = before < field->n ? before : field->n;
        if (before > size) /* a default value that is longer: unused elements are zero */
            memset(to + size * field->stride, 0, (before - size) * field->stride);
        if (field->shape)
            rp_lay_initial(field, to, size);
    }
    if (!failed && row.obj) {
        failed = PyBuffer_ToContiguous(to, &row, row.len, 'C');
        for (Py_ssize_t i = 0; field->kind->code == '?' && i < count; i++)
            to[i] = to[i] != 0; /* a PLC's BOOL holds 0 or 1, a mask of numpy's also 255 */
    }
    for (Py_ssize_t i = 0; !failed && !row.obj && i < count; i++) {
        /* Converting an element may have shortened the list. */
        PyObject *item = Py_XNewRef(listed ? PyList_GetItem(items, i) : PyTuple_GetItem(items, i));
        failed = item ? put_one(field, to + (size_t)i * field->stride, item, m)
                      : refuse(m, PyUnicode_FromString("the elements changed while they were packed"));
        Py_XDECREF(item);
        if (failed)
            below(m, m->what ? PyUnicode_FromFormat("[%zd]", i) : NULL);
    }
    if (!failed && field->many == SEQUENCE)
        rp_store32(base + field->count_at, (uint32_t)count);
    if (row.obj)
        PyBuffer_Release(&row);
    Py_DECREF(items);
    return failed;
}

static int put_field(const FieldObject *field, uint8_t *base, PyObject *value, misfit *m)
{
    int failed = field->many ? put_many(field, base, value, m) : put_one(field, base + field->at, value, m);
    return failed ? below(m, m->what ? Py_NewRef(field->name) : NULL) : 0;
}

/* Find the key that is no field. */
static int refuse_key(ShapeObject *shape, PyObject *dict, misfit *m)
{
    PyObject *names = PyObject_GetAttrString((PyObject *)shape->view, "_names"), *key, *value;
    Py_ssize_t at = 0;
    int known = names ? 1 : -1;
    while (known > 0 && PyDict_Next(dict, &at, &key, &value)) {
        Py_INCREF(key);
        if (!(known = PySequence_Contains(names, key)))
            refuse(m, PyUnicode_FromFormat("%U has no field %R", shape->type_name, key));
        Py_DECREF(key);
    }
    Py_XDECREF(names);
    return known > 0 ? 0 : -1;
}

static int put_dict(ShapeObject *shape, uint8_t *to, PyObject *dict, misfit *m)
{
    Py_ssize_t count = PyTuple_Size(shape->fields), found = 0;
    for (Py_ssize_t i = 0; i < count; i++) {
        FieldObject *field = field_of(shape, i);
        PyObject *item = PyDict_GetItemWithError(dict, field->name);
        int failed;
        if (!item) {
            if (PyErr_Occurred())
                return -1;
            continue;
        }
        Py_INCREF(item);
        failed = put_field(field, to, item, m);
        Py_DECREF(item);
        if (failed)
            return -1;
        found++;
    }
    return found == PyDict_Size(dict) ? 0 : refuse_key(shape, dict, m);
}

/* A new reference, or NULL without an exception if there is no such attribute. */
static PyObject *attribute(PyObject *value, PyObject *name)
{
    PyObject *item = PyObject_GetAttr(value, name);
    if (!item && PyErr_ExceptionMatches(PyExc_AttributeError))
        PyErr_Clear();
    return item;
}

static int put_attributes(ShapeObject *shape, uint8_t *to, PyObject *value, misfit *m)
{
    Py_ssize_t count = PyTuple_Size(shape->fields);
    int found = !count;
    for (Py_ssize_t i = 0; i < count; i++) {
        FieldObject *field = field_of(shape, i);
        PyObject *item = attribute(value, field->name);
        int failed = 0;
        if (!item && !PyErr_Occurred() && field->other && (item = attribute(value, field->other))
            && is_genpy(field->other)) { /* its nsecs are signed: the bits are kept */
            if (PyLong_Check(item)) {
                rp_store32(to + field->at, (uint32_t)PyLong_AsUnsignedLongMask(item));
                found = 1;
            }
            Py_CLEAR(item);
        }
        if (item) {
            found = 1;
            failed = put_field(field, to, item, m);
            Py_DECREF(item);
        }
        if (failed || PyErr_Occurred())
            return -1;
    }
    return found ? 0 : is_no(m, value, NULL, shape->type_name);
}

int rp_put_struct(ShapeObject *shape, uint8_t *to, PyObject *value, misfit *m)
{
    PyObject *items, *dict;
    int mapping, failed;
    if (PyDict_CheckExact(value))
        return put_dict(shape, to, value, m);
    mapping = PyObject_TypeCheck(value, rp_view_type) ? 0 : is_mapping(value);
    if (mapping <= 0)
        return mapping ? -1 : put_attributes(shape, to, value, m);
    items = PyObject_CallMethod(value, "items", NULL);
    dict = items ? PyDict_New() : NULL;
    failed = !dict || PyDict_MergeFromSeq2(dict, items, 1) ? -1 : put_dict(shape, to, dict, m);
    Py_XDECREF(dict);
    Py_XDECREF(items);
    return failed;
}

