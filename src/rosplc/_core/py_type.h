/* What the types of all extension modules share. Include after Python.h. */
#ifndef ROSPLC_PY_TYPE_H
#define ROSPLC_PY_TYPE_H

/* 0 in the first interpreter of the process that asks, else -1 with ImportError: types are kept in static variables, and
 * another interpreter's would take their place. */
static inline int py_only_interpreter(void)
{
    static int64_t first = -1;
    int64_t mine = PyInterpreterState_GetID(PyInterpreterState_Get());
    if (first < 0)
        first = mine;
    if (first == mine)
        return 0;
    PyErr_SetString(PyExc_ImportError, "rosplc supports only one interpreter per process; another one has loaded it");
    return -1;
}

/* A new object, all of its fields 0; or NULL. */
static inline void *py_allocate(PyTypeObject *type)
{
    return ((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0);
}

/* The end of an object, once its fields hold nothing any more. */
static inline void py_release(void *object)
{
    PyTypeObject *type = Py_TYPE((PyObject *)object);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(object);
    Py_DECREF((PyObject *)type);
}

/* Adds a type to a module; `place`, unless NULL, gets a reference. */
static inline int py_add_type(PyObject *module, const char *name, PyType_Spec *spec, PyTypeObject **place)
{
    PyObject *type = PyType_FromSpec(spec);
    int failed = !type || PyModule_AddObjectRef(module, name, type) ? -1 : 0;
    if (place && !failed)
        *place = (PyTypeObject *)type;
    else
        Py_XDECREF(type);
    return failed;
}

#endif
