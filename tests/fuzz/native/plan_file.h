/* Reads the file that tests/fuzz/export_plans.py writes: plans, and messages of each to begin with.
 *
 *   u32 number of plans, then for each: u32 size, plan blob; u32 number of messages, then for each:
 *   u32 size, message. Everything little-endian. */
#ifndef PLAN_FILE_H
#define PLAN_FILE_H

#include <stdio.h>
#include <stdlib.h>

#include "plan.h"

typedef struct {
    uint8_t *data;
    uint32_t size;
} blob;

typedef struct {
    blob source;
    rp_plan plan;
    uint32_t messages;
    blob *message;
} plan_case;

static void stop(const char *what)
{
    fprintf(stderr, "FAILED: %s\n", what);
    abort();
}

/* Heap memory of exactly `size` bytes, so that the sanitizer sees one byte too many. */
static uint8_t *exact(size_t size)
{
    uint8_t *memory = malloc(size ? size : 1);
    if (!memory)
        stop("out of memory");
    return size ? memory : memory + 1;
}

static void release(uint8_t *memory, size_t size)
{
    free(size ? memory : memory - 1);
}

static uint32_t read_u32(FILE *file)
{
    uint32_t value;
    if (fread(&value, 4, 1, file) != 1)
        stop("plan file ends too early");
    return value;
}

static blob read_blob(FILE *file)
{
    blob result;
    result.size = read_u32(file);
    result.data = result.size ? exact(result.size) : NULL;
    if (result.size && fread(result.data, result.size, 1, file) != 1)
        stop("plan file ends too early");
    return result;
}

static plan_case *read_plans(const char *path, uint32_t *count)
{
    FILE *file = fopen(path, "rb");
    plan_case *cases;
    if (!file)
        stop("plan file cannot be opened");
    *count = read_u32(file);
    cases = calloc(*count, sizeof *cases);
    if (!cases || !*count)
        stop("no plans");
    for (uint32_t i = 0; i < *count; i++) {
        plan_case *one = &cases[i];
        const char *reason;
        one->source = read_blob(file);
        reason = rp_plan_load(&one->plan, malloc(one->source.size), one->source.data, one->source.size);
        if (reason)
            stop(reason);
        one->messages = read_u32(file);
        one->message = calloc(one->messages + 1, sizeof *one->message);
        for (uint32_t k = 0; k < one->messages; k++)
            one->message[k] = read_blob(file);
    }
    fclose(file);
    return cases;
}

static inline void free_plans(plan_case *cases, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        for (uint32_t k = 0; k < cases[i].messages; k++)
            free(cases[i].message[k].data);
        free(cases[i].message);
        free((void *)(uintptr_t)cases[i].plan.ops);
        release(cases[i].source.data, cases[i].source.size);
    }
    free(cases);
}

#endif
