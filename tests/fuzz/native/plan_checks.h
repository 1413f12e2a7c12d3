/* What must hold for any plan and any input; shared by the driver and the fuzzer. */
#ifndef PLAN_CHECKS_H
#define PLAN_CHECKS_H

#include "plan_file.h"

static uint64_t digest = 0xcbf29ce484222325u; /* FNV-1a of all results: machines must agree */

static void note(const void *data, size_t size)
{
    const uint8_t *bytes = data;
    for (size_t i = 0; i < size; i++)
        digest = (digest ^ bytes[i]) * 0x100000001b3u;
}

/* Encode a record of any contents: always possible within the bound, and what comes out decodes and
 * gives the same bytes again. Returns the message's size. */
static size_t check_record(const rp_plan *plan, const uint8_t *data)
{
    size_t bound = rp_encoded_bound(plan), used = 0, again = 0;
    uint8_t *record = exact(plan->record_size), *out = exact(bound), *wire, *second = exact(bound);
    uint32_t flags;
    rp_fault fault;
    memcpy(record, data, plan->record_size);
    if (rp_encode(plan, record, out, bound, &used, &fault) || used > bound)
        stop("a record cannot be encoded");
    wire = exact(used);
    memcpy(wire, out, used);
    note(wire, used);
    if (rp_decode(plan, wire, used, record, 0, &flags, &fault) || flags)
        stop("an encoded record cannot be decoded");
    if (rp_encode(plan, record, second, bound, &again, &fault) || again != used || memcmp(second, wire, used))
        stop("encoding again gives other bytes");
    release(second, bound);
    release(wire, used);
    release(out, bound);
    release(record, plan->record_size);
    return used;
}

/* Decode bytes of any contents. A message that is accepted fills every byte of the record. Returns the
 * fault's code. */
static uint32_t check_wire(const rp_plan *plan, const uint8_t *data, size_t size, int truncate)
{
    uint8_t *wire = exact(size), *record = exact(plan->record_size), *other = exact(plan->record_size);
    uint32_t flags = 0, same = 0;
    rp_fault fault, second;
    int result;
    if (size)
        memcpy(wire, data, size);
    memset(record, 0x00, plan->record_size);
    memset(other, 0xFF, plan->record_size);
    result = rp_decode(plan, wire, size, record, truncate, &flags, &fault);
    if (result != rp_decode(plan, wire, size, other, truncate, &same, &second) || fault.code != second.code)
        stop("decoding twice gives two results");
    if (result ? fault.code < 1 || fault.code > 8 : fault.code != 0)
        stop("fault code does not agree with the result");
    if (result && fault.op != RP_NO_OP && fault.op >= plan->native_count + plan->swapped_count)
        stop("fault names no op of the plan");
    if (!result) {
        if (memcmp(record, other, plan->record_size))
            stop("decoding leaves bytes of the record as they were");
        if (flags & ~(uint32_t)RP_TRUNCATED || (flags && !truncate) || flags != same)
            stop("flags are wrong");
        check_record(plan, record);
        note(record, plan->record_size);
    }
    note(&fault.code, sizeof fault.code);
    release(other, plan->record_size);
    release(record, plan->record_size);
    release(wire, size);
    return fault.code;
}

/* Load a damaged plan; if it loads all the same, it must still be harmless. */
static void check_blob(const uint8_t *data, size_t size, const uint8_t *input, size_t input_size)
{
    uint8_t *source = exact(size);
    rp_op *ops = malloc(size + 1);
    rp_plan plan;
    memcpy(source, data, size);
    if (!rp_plan_load(&plan, ops, source, size) && plan.record_size <= 1 << 16 &&
        plan.bound <= 1 << 20) {
        uint8_t *record = exact(plan.record_size), *out = exact(plan.bound), *wire = exact(input_size);
        uint32_t flags;
        size_t used;
        rp_fault fault;
        if (input_size)
            memcpy(wire, input, input_size);
        memset(record, 0x5A, plan.record_size);
        rp_decode(&plan, wire, input_size, record, 1, &flags, &fault);
        if (rp_encode(&plan, record, out, plan.bound, &used, &fault))
            stop("a plan that loads exceeds its own bound");
        release(wire, input_size);
        release(out, plan.bound);
        release(record, plan.record_size);
    }
    free(ops);
    release(source, size);
}

#endif
