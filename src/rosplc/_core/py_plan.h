/* What py_channel.c and py_group.c need from py_plan.c. */
#ifndef ROSPLC_PY_PLAN_H
#define ROSPLC_PY_PLAN_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "plan.h"

/* The plan of a _native.Plan object, borrowed: it lives as long as the object. NULL with TypeError if it
 * is another object. */
const rp_plan *rp_plan_from_object(PyObject *object);

/* Raise _native.Fault(code, op, size, limit). Returns NULL. */
PyObject *rp_raise_fault(const rp_fault *fault);

#endif
