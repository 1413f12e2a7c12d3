/* Record to wire bytes. The record is never trusted: it may hold anything, and change meanwhile. */
#ifndef ROSPLC_PLAN_ENCODE_H
#define ROSPLC_PLAN_ENCODE_H

#include "plan_ops.h"

typedef struct {
    uint8_t *out;
    size_t size, at;
    size_t mask;
    uint8_t ros1;
} rp_encoder;

/* Room for `bytes` at the next multiple of mask + 1, the gap zeroed; or NULL. */
static inline uint8_t *rp_put(rp_encoder *e, size_t mask, size_t bytes)
{
    size_t at = (e->at + mask) & ~mask;
    if (at > e->size || bytes > e->size - at)
        return NULL;
    while (e->at < at)
        e->out[e->at++] = 0;
    e->at = at + bytes;
    return e->out + at;
}

static inline int rp_encode_string(rp_encoder *e, const rp_op *op, const uint8_t *base)
{
    const uint8_t *text = base + op->at, *nul = memchr(text, 0, op->n);
    uint32_t length = nul ? (uint32_t)(nul - text) : op->n;
    uint8_t *to = rp_put(e, e->mask, 4 + (size_t)length + !e->ros1);
    if (!to)
        return -1;
    memcpy(to + 4, text, length);
    /* The record may have changed since: what counts is the copy. */
    nul = length ? memchr(to + 4, 0, length) : NULL;
    if (nul) {
        e->at -= length - (uint32_t)(nul - (to + 4));
        length = (uint32_t)(nul - (to + 4));
    }
    if (!e->ros1)
        to[4 + (size_t)length] = 0;
    rp_store32(to, length + !e->ros1);
    return 0;
}

static inline int rp_encode_ops(rp_encoder *e, const rp_op *op, const rp_op *end, const uint8_t *base)
{
    for (; op < end; op++) {
        uint8_t *to;
        uint32_t count;
        switch (op->code) {
        case RP_COPY:
            to = rp_put(e, op->align - 1u, op->n);
            if (!to)
                return -1;
            memcpy(to, base + op->at, op->n);
            break;
        case RP_BOOLS:
            to = e->out + e->at - op->body;
            for (uint32_t i = 0; i < op->n; i++)
                to[i] = to[i] != 0;
            break;
        case RP_SKIP:
            to = rp_put(e, 0, op->n);
            if (!to)
                return -1;
            memset(to, 0, op->n);
            break;
        case RP_STRING:
            if (rp_encode_string(e, op, base))
                return -1;
            break;
        case RP_SEQ:
        case RP_LOOP:
            to = rp_put(e, e->mask, 4);
            if (!to)
                return -1;
            count = rp_load32(base + op->count_at);
            if (count > op->n)
                count = op->n;
            rp_store32(to, count);
            if (op->code == RP_LOOP) {
                for (uint32_t i = 0; op->least && i < count; i++)
                    if (rp_encode_ops(e, op + 1, op + 1 + op->body, base + op->at + (size_t)i * op->stride))
                        return -1;
                op += op->body;
            } else if (count) {
                size_t bytes = (size_t)count * op->stride;
                to = rp_put(e, op->align - 1u, bytes);
                if (!to)
                    return -1;
                memcpy(to, base + op->at, bytes);
                if (op->flags & RP_BOOL)
                    for (size_t i = 0; i < bytes; i++)
                        to[i] = to[i] != 0;
            }
            break;
        case RP_ARRAY:
            for (uint32_t i = 0; op->least && i < op->n; i++)
                if (rp_encode_ops(e, op + 1, op + 1 + op->body, base + op->at + (size_t)i * op->stride))
                    return -1;
            op += op->body;
            break;
        default: /* ZERO: padding is no part of the wire; SWAP: the native list has none */
            break;
        }
    }
    return 0;
}

/* The most bytes that a record can take on the wire. */
static inline size_t rp_encoded_bound(const rp_plan *plan)
{
    return plan->bound;
}

/* Turn a record into a message, little-endian; CDR with its encapsulation and padded to a multiple of 4.
 * The record may hold anything, and may change meanwhile: counts beyond a capacity read as the capacity.
 * Fails (code 9) only if `out_size` is too small, which rp_encoded_bound() bytes never are. */
static inline int rp_encode(const rp_plan *plan, const uint8_t *record, uint8_t *out, size_t out_size, size_t *used,
                            rp_fault *fault)
{
    static const uint8_t little_endian[4] = {0, 1, 0, 0};
    rp_encoder e = {.out = out, .size = out_size};
    size_t head = 0;
    fault->code = 0;
    if (plan->wire == RP_ROS1) {
        e.ros1 = 1;
    } else {
        if (out_size < 4)
            return rp_fail(fault, 9, RP_NO_OP, out_size, plan->bound);
        memcpy(out, little_endian, 4);
        e.out += 4;
        e.size -= 4;
        e.mask = 3;
        head = 4;
    }
    if (rp_encode_ops(&e, plan->ops, plan->ops + plan->native_count, record) || !rp_put(&e, e.mask, 0))
        return rp_fail(fault, 9, RP_NO_OP, out_size, plan->bound);
    *used = head + e.at;
    return 0;
}

#endif
