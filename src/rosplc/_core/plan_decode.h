/* Wire bytes to record. The wire is never trusted, and its words are read once. */
#ifndef ROSPLC_PLAN_DECODE_H
#define ROSPLC_PLAN_DECODE_H

#include "plan_ops.h"

typedef struct {
    const uint8_t *in; /* alignment counts from here: after the encapsulation */
    size_t size, at;   /* at <= size always */
    size_t mask;       /* alignment of lengths and counts, minus one */
    const rp_op *first;
    rp_fault *fault;
    uint32_t head; /* bytes before `in`, for messages */
    uint32_t flags;
    uint8_t swap, ros1, truncate;
} rp_decoder;

__attribute__((noinline, cold, unused)) static int rp_short(rp_decoder *d, const rp_op *op, uint64_t needed)
{
    return rp_fail(d->fault, 1, (uint32_t)(op - d->first), rp_add(d->head, needed), (uint64_t)d->head + d->size);
}

/* `bytes` at the next multiple of mask + 1, or NULL. */
static inline const uint8_t *rp_take(rp_decoder *d, const rp_op *op, size_t mask, size_t bytes)
{
    size_t at = (d->at + mask) & ~mask;
    if (at > d->size || bytes > d->size - at) {
        rp_short(d, op, rp_add(at, bytes));
        return NULL;
    }
    d->at = at + bytes;
    return d->in + at;
}

static inline int rp_take_count(rp_decoder *d, const rp_op *op, uint32_t *count)
{
    const uint8_t *from = rp_take(d, op, d->mask, 4);
    if (!from)
        return -1;
    *count = rp_load32(from);
    if (d->swap)
        *count = __builtin_bswap32(*count);
    return 0;
}

/* Where a text of more than `capacity` bytes ends without splitting a UTF-8 sequence. */
static inline uint32_t rp_utf8_cut(const uint8_t *text, uint32_t capacity)
{
    for (uint32_t back = 0; back < 4 && back <= capacity; back++)
        if ((text[capacity - back] & 0xC0) != 0x80)
            return capacity - back;
    return capacity; /* not UTF-8 */
}

static inline int rp_decode_string(rp_decoder *d, const rp_op *op, uint8_t *base)
{
    uint32_t length, keep;
    const uint8_t *text, *nul;
    if (rp_take_count(d, op, &length))
        return -1;
    text = rp_take(d, op, 0, length);
    if (!text)
        return -1;
    if (!d->ros1 && length) {
        length--;
        if (text[length])
            return rp_fail(d->fault, 7, (uint32_t)(op - d->first), (uint64_t)length + 1, length);
    }
    keep = length;
    nul = length ? memchr(text, 0, length) : NULL;
    if (nul) {
        if (!d->truncate)
            return rp_fail(d->fault, 7, (uint32_t)(op - d->first), (uint64_t)length + !d->ros1,
                           (uint64_t)(nul - text));
        keep = (uint32_t)(nul - text);
        d->flags |= RP_TRUNCATED;
    }
    if (op->bound && length > op->bound)
        return rp_fail(d->fault, 4, (uint32_t)(op - d->first), length, op->bound);
    if (!base)
        return 0;
    if (keep > op->n) {
        if (!d->truncate)
            return rp_fail(d->fault, 4, (uint32_t)(op - d->first), length, op->n);
        keep = rp_utf8_cut(text, op->n);
        d->flags |= RP_TRUNCATED;
    }
    memcpy(base + op->at, text, keep);
    memset(base + op->at + keep, 0, op->room - keep);
    return 0;
}

/* Check a count whose elements take at least `least` bytes each, and find how many are kept. */
static inline int rp_decode_count(rp_decoder *d, const rp_op *op, const uint8_t *base, uint32_t least, uint32_t *count,
                                  uint32_t *keep)
{
    if (rp_take_count(d, op, count))
        return -1;
    /* Before anything loops: a count that the bytes left cannot hold is refused. */
    if (least && *count > (d->size - d->at) / least)
        return rp_short(d, op, rp_add(d->at, (uint64_t)*count * least));
    if (op->bound && *count > op->bound)
        return rp_fail(d->fault, 8, (uint32_t)(op - d->first), *count, op->bound);
    *keep = *count;
    if (*count > op->n) {
        if (!d->truncate && base)
            return rp_fail(d->fault, 5, (uint32_t)(op - d->first), *count, op->n);
        *keep = op->n;
        d->flags |= RP_TRUNCATED;
    }
    return 0;
}

/* Run `ops` on one element; without `base` the wire is checked and passed over, and nothing is stored. */
static inline int rp_decode_ops(rp_decoder *d, const rp_op *op, const rp_op *end, uint8_t *base)
{
    for (; op < end; op++) {
        const uint8_t *from;
        uint32_t count, keep;
        switch (op->code) {
        case RP_COPY:
            from = rp_take(d, op, op->align - 1u, op->n);
            if (!from)
                return -1;
            if (base)
                memcpy(base + op->at, from, op->n);
            break;
        case RP_SWAP:
            from = rp_take(d, op, op->width - 1u, (size_t)op->n * op->width);
            if (!from)
                return -1;
            if (base)
                rp_swap_copy(base + op->at, from, op->n, op->width);
            break;
        case RP_BOOLS:
            from = d->in + d->at - op->body;
            for (uint32_t i = 0; i < op->n; i++)
                if (from[i] > 1)
                    return rp_fail(d->fault, 6, (uint32_t)(op - d->first), from[i], 1);
            break;
        case RP_ZERO:
            if (base)
                memset(base + op->at, 0, op->n);
            break;
        case RP_SKIP:
            if (!rp_take(d, op, 0, op->n))
                return -1;
            break;
        case RP_STRING:
            if (rp_decode_string(d, op, base))
                return -1;
            break;
        case RP_SEQ:
            if (rp_decode_count(d, op, base, op->stride, &count, &keep))
                return -1;
            from = rp_take(d, op, count ? op->align - 1u : 0u, (size_t)count * op->stride);
            if (!from)
                return -1;
            if (op->flags & RP_BOOL)
                for (uint32_t i = 0; i < count; i++)
                    if (from[i] > 1)
                        return rp_fail(d->fault, 6, (uint32_t)(op - d->first), from[i], 1);
            if (base) {
                size_t bytes = (size_t)keep * op->stride;
                rp_store32(base + op->count_at, keep);
                if (op->width == 1)
                    memcpy(base + op->at, from, bytes);
                else
                    rp_swap_copy(base + op->at, from, bytes / op->width, op->width);
                memset(base + op->at + bytes, 0, op->room - bytes);
            }
            break;
        case RP_LOOP:
            if (rp_decode_count(d, op, base, op->least, &count, &keep))
                return -1;
            if (base) {
                size_t bytes = (size_t)keep * op->stride;
                rp_store32(base + op->count_at, keep);
                for (uint32_t i = 0; i < keep; i++)
                    if (rp_decode_ops(d, op + 1, op + 1 + op->body, base + op->at + (size_t)i * op->stride))
                        return -1;
                memset(base + op->at + bytes, 0, op->room - bytes);
            } else {
                keep = 0;
            }
            /* Elements without wire bytes are passed over at once: their number may be 2^32 - 1. */
            for (uint32_t i = keep; op->least && i < count; i++)
                if (rp_decode_ops(d, op + 1, op + 1 + op->body, NULL))
                    return -1;
            op += op->body;
            break;
        case RP_ARRAY:
            if (base) {
                for (uint32_t i = 0; i < op->n; i++)
                    if (rp_decode_ops(d, op + 1, op + 1 + op->body, base + op->at + (size_t)i * op->stride))
                        return -1;
                memset(base + op->at + (size_t)op->n * op->stride, 0, op->room - (size_t)op->n * op->stride);
            } else {
                for (uint32_t i = 0; op->least && i < op->n; i++)
                    if (rp_decode_ops(d, op + 1, op + 1 + op->body, NULL))
                        return -1;
            }
            op += op->body;
            break;
        }
    }
    return 0;
}

/* Turn a message of `wire_size` bytes into a record of plan->record_size bytes; every byte of the record
 * is written. Returns 0 and the slot's flags (RP_TRUNCATED), or -1 and the fault: then the record holds
 * anything. */
static inline int rp_decode(const rp_plan *plan, const uint8_t *wire, size_t wire_size, uint8_t *record, int truncate,
                            uint32_t *flags, rp_fault *fault)
{
    rp_decoder d = {.in = wire ? wire : (const uint8_t *)"", .size = wire_size, .first = plan->ops, .fault = fault, .truncate = !!truncate};
    const rp_op *ops = plan->ops;
    uint32_t count = plan->native_count;
    size_t spare = 0;
    fault->code = 0;
    *flags = 0;
    if (plan->wire == RP_ROS1) {
        d.ros1 = 1;
    } else {
        if (wire_size < 4)
            return rp_fail(fault, 1, RP_NO_OP, 4, wire_size);
        if (wire[0] != 0 || wire[1] > 1)
            return rp_fail(fault, 3, RP_NO_OP, (uint64_t)wire[0] << 8 | wire[1], 0);
        if (wire[1] == 0) {
            d.swap = 1;
            ops += plan->native_count;
            count = plan->swapped_count;
        }
        d.in = wire + 4;
        d.size = wire_size - 4;
        d.head = 4;
        d.mask = 3;
        spare = 3;
    }
    if (rp_decode_ops(&d, ops, ops + count, record))
        return -1;
    if (d.size - d.at > spare)
        return rp_fail(fault, 2, RP_NO_OP, wire_size, (uint64_t)d.head + d.at + spare);
    *flags = d.flags;
    return 0;
}

#endif
