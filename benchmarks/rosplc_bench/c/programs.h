/* Translated Structured Text: its programs and their variables by name. */
#ifndef ROSPLC_BENCH_PROGRAMS_H
#define ROSPLC_BENCH_PROGRAMS_H

#include <strings.h>

#include "common.h"
#include "st_runtime.h"

static const struct st_program *program(const char *name)
{
    for (const struct st_program *p = st_programs; p->name; p++)
        if (!strcasecmp(p->name, name))
            return p;
    fail("no program %s", name);
    return NULL;
}

static const void *variable(const struct st_program *p, const char *name)
{
    for (const struct st_member *m = st_members; m->owner; m++)
        if (!strcasecmp(m->owner, p->name) && !strcasecmp(m->name, name))
            return (const uint8_t *)*p->instance + m->offset;
    fail("no variable %s", name);
    return NULL;
}

#endif
