/* The extension module: one file per part registers its types and functions here. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "py_type.h"

int rosplc_add_channel(PyObject *module); /* py_channel.c */
int rosplc_add_plan(PyObject *module);    /* py_plan.c */
int rosplc_add_group(PyObject *module);   /* py_group.c */
int rosplc_add_sink(PyObject *module);    /* py_sink.c */
int rosplc_add_record(PyObject *module);  /* py_record.c */

static int exec_module(PyObject *module)
{
    if (py_only_interpreter() || rosplc_add_channel(module) || rosplc_add_plan(module) || rosplc_add_group(module)
        || rosplc_add_sink(module) || rosplc_add_record(module))
        return -1;
    return 0;
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)exec_module}, {0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "rosplc._core._native", "rosplc's C core.", 0, NULL, slots, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__native(void)
{
    return PyModuleDef_Init(&definition);
}
