/* What py_pack.c and py_record.c share: a Shape is a struct of a layout, a Field one of its members. */
#ifndef ROSPLC_PY_RECORD_H
#define ROSPLC_PY_RECORD_H

#include "py_channel.h"

typedef struct {
    const char *name, *bulk; /* `bulk`: the letters of buffers whose bytes are the record's */
    char code;
    uint8_t size;
} number_kind;

typedef struct {
    PyObject_HEAD
    PyObject *type_name;
    PyObject *fields;       /* tuple of Fields */
    PyObject *initial;      /* bytes: what a record holds that nobody has filled */
    PyTypeObject *view;     /* the subclass of RecordView with the fields as attributes */
    uint32_t size;
} ShapeObject;

typedef struct {
    PyObject_HEAD
    PyObject *name;
    PyObject *other;          /* the attribute that has the value where `name` is none; or NULL */
    const number_kind *kind;  /* of numbers and strings; NULL: a struct */
    ShapeObject *shape;       /* of structs */
    uint32_t at, stride, n;   /* `n` elements have room, `stride` bytes apart */
    uint32_t count_at, end;
    enum { SINGLE, ARRAY, SEQUENCE } many;
} FieldObject;

typedef struct ViewObject {
    PyObject_HEAD
    ShapeObject *shape;
    const uint8_t *data;
    PyObject *owner; /* of the bytes: a bytes object or a memoryview */
} ViewObject;

/* A value that does not fit: what, and the path, which grows from the inside out. While `what` is NULL, -1
 * means that a Python exception is set. */
typedef struct {
    PyObject *what, *path;
} misfit;

extern PyTypeObject *rp_view_type;
extern PyObject *rp_mapping_type, *rp_layout_error;

/* Write a value's fields; those that it lacks keep what is there. -1 with a misfit or an exception. */
int rp_put_struct(ShapeObject *shape, uint8_t *to, PyObject *value, misfit *m);
/* Start structs of an array from their initial values. */
void rp_lay_initial(const FieldObject *field, uint8_t *to, size_t count);
/* Raise LayoutError LAY006, unless another exception is set. */
void rp_raise_misfit(ShapeObject *shape, misfit *m);

static inline FieldObject *field_of(const ShapeObject *shape, Py_ssize_t index)
{
    return (FieldObject *)PyTuple_GetItem(shape->fields, index);
}

/* Whether another name is a word of a time in genpy's own classes, not a keyword of Python with an underscore. */
static inline int is_genpy(PyObject *other)
{
    return !PyUnicode_CompareWithASCIIString(other, "secs") || !PyUnicode_CompareWithASCIIString(other, "nsecs");
}

#endif
