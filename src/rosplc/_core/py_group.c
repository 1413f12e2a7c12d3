#define PY_SSIZE_T_CLEAN
#include <Python.h>

int rosplc_add_group(PyObject *module)
{
    (void)module;
    return 0;
}
