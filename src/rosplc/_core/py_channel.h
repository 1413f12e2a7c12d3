/* What py_channel.c, py_writer.c, py_reader.c and py_group.c share. */
#ifndef ROSPLC_PY_CHANNEL_H
#define ROSPLC_PY_CHANNEL_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <rosplc/channel.h>
#include "plan.h"
#include "py_plan.h"
#include "py_type.h"

/* From this many bytes on a copy releases the GIL: below, the release costs more than it gives. */
#define CH_LONG_COPY (256u * 1024u)

typedef struct {
    PyObject_HEAD
    rosplc_region region;
    size_t mapped;  /* bytes; 0: unmapped */
    PyObject *path; /* for messages */
    int writable, closed;
    int pins; /* users without the GIL, and groups: the mapping outlives close() for them */
} RegionObject;

/* Keeps threads apart while one of them copies without the GIL; all fields belong to the GIL. */
typedef struct {
    int busy, waiting;
} ch_gate;

typedef struct {
    PyObject_HEAD
    RegionObject *owner;
    rosplc_writer writer;
    ch_gate gate;
    int released;
} WriterObject;

typedef struct {
    PyObject_HEAD
    RegionObject *owner;
    rosplc_reader reader;
    uint8_t *shadow; /* a rejected copy never reaches the caller's buffer (M12) */
    uint8_t *wire;   /* of `wire_size` bytes */
    size_t wire_size;
    ch_gate gate;
    rosplc_take taken; /* what view() returned last */
} ReaderObject;

extern PyTypeObject *ch_region_type, *ch_writer_type, *ch_reader_type;

/* Raise ChannelError "SHM<number>" about the object at `path`. Returns NULL. */
PyObject *ch_raise_channel(int number, PyObject *path);

/* 0, or -1 with ValueError once the region is closed. */
int ch_region_usable(RegionObject *region);
void ch_region_pin(RegionObject *region);
void ch_region_unpin(RegionObject *region);

/* Let another thread finish its copy. -1 on a signal's exception. */
int ch_gate_wait(ch_gate *gate);
/* Begin and end a long copy: without the GIL in between. */
PyThreadState *ch_gate_enter(ch_gate *gate, RegionObject *region);
void ch_gate_leave(ch_gate *gate, RegionObject *region, PyThreadState *state);

/* Keyword-only and positional arguments of a METH_FASTCALL | METH_KEYWORDS method, by position in
 * `names` (NULL-terminated): out[i] is borrowed or NULL. -1 with TypeError. */
int ch_arguments(const char *method, const char *const *names, Py_ssize_t positional, Py_ssize_t required,
                 PyObject *const *args, Py_ssize_t count, PyObject *keywords, PyObject **out);

/* An int of 0 ... 2^32-1 or 2^64-1. -1 with an exception. */
int ch_as_u32(PyObject *value, const char *name, uint32_t *out);
int ch_as_u64(PyObject *value, const char *name, uint64_t *out);

/* A new SlotInfo. */
PyObject *ch_slot_info(const rosplc_take *take);

/* py_record.c: the size of a _native.Shape's records, or -1 with TypeError for another object; a value as a
 * record, -1 with LayoutError or what the value's own code raises; the fields of a record in a bytes object. */
Py_ssize_t rp_shape_size(PyObject *shape);
int rp_shape_pack(PyObject *shape, PyObject *value, uint8_t *record);
PyObject *rp_shape_view(PyObject *shape, PyObject *bytes);

/* Whether the monotonic clock has reached a float, in seconds, to a few ms; -1 with TypeError. */
int ch_reached(PyObject *seconds);

/* Random and not 0: claims. -1 with OSError. */
int ch_random_claim(uint32_t *out);

int ch_add_writer(PyObject *module); /* py_writer.c */
int ch_add_reader(PyObject *module); /* py_reader.c */

#endif
