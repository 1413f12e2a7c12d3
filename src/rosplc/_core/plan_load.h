/* Loading a plan: proof that no op leaves the record, or the element of the loop that it is in. */
#ifndef ROSPLC_PLAN_LOAD_H
#define ROSPLC_PLAN_LOAD_H

#include "plan_ops.h"

static inline int rp_is_width(uint32_t value)
{
    return value == 1 || value == 2 || value == 4 || value == 8;
}

/* Validate ops[0..count) against an element of `extent` bytes, fill in `least`, and add up the fewest
 * and most wire bytes. Returns NULL, or what is wrong. */
static inline const char *rp_check_ops(rp_op *ops, uint32_t count, uint64_t extent, int depth, uint64_t *least,
                                       uint64_t *most)
{
    uint64_t run = 0; /* bytes of the COPY that BOOLS may look back on */
    if (depth > RP_MAX_DEPTH)
        return "loops are nested too deeply";
    for (uint32_t i = 0; i < count; i++) {
        rp_op *op = &ops[i];
        uint64_t n = op->n, inner_least = 0, inner_most = 0;
        const char *reason;
        if (!rp_is_width(op->align) || !rp_is_width(op->width))
            return "alignment or width is not 1, 2, 4 or 8";
        if (op->code != RP_BOOLS && op->code != RP_ZERO)
            run = 0;
        switch (op->code) {
        case RP_COPY:
            if (op->at + n > extent)
                return "COPY leaves its element";
            run = n;
            *least = rp_add(*least, n);
            *most = rp_add(*most, n + op->align - 1);
            break;
        case RP_SWAP:
            if (op->at + n * op->width > extent)
                return "SWAP leaves its element";
            *least = rp_add(*least, n * op->width);
            *most = rp_add(*most, n * op->width + op->width - 1);
            break;
        case RP_BOOLS:
            if (op->body > run || n > op->body)
                return "BOOLS does not follow its COPY";
            break;
        case RP_ZERO:
            if (op->at + n > extent)
                return "ZERO leaves its element";
            break;
        case RP_SKIP:
            *least = rp_add(*least, n);
            *most = rp_add(*most, n);
            break;
        case RP_STRING:
            if (op->room < n + 1 || op->at + (uint64_t)op->room > extent)
                return "STRING leaves its element";
            *least = rp_add(*least, 4);
            *most = rp_add(*most, 3 + 4 + n + 1);
            break;
        case RP_SEQ:
            if (!op->stride || op->stride % op->width != 0 || ((op->flags & RP_BOOL) && op->stride != 1))
                return "SEQ has no usable element size";
            if (op->room < n * op->stride || op->at + (uint64_t)op->room > extent || op->count_at + 4ull > extent)
                return "SEQ leaves its element";
            *least = rp_add(*least, 4);
            *most = rp_add(*most, 3 + 4 + 7 + n * op->stride);
            break;
        case RP_LOOP:
        case RP_ARRAY:
            if (op->body > count - i - 1)
                return "loop is longer than the plan";
            if (!op->stride)
                return "loop has no element size";
            if (op->room < n * op->stride || op->at + (uint64_t)op->room > extent)
                return "loop leaves its element";
            if (op->code == RP_LOOP && op->count_at + 4ull > extent)
                return "count leaves its element";
            reason = rp_check_ops(op + 1, op->body, op->stride, depth + 1, &inner_least, &inner_most);
            if (reason)
                return reason;
            op->least = inner_least > UINT32_MAX ? UINT32_MAX : (uint32_t)inner_least;
            *least = rp_add(*least, op->code == RP_LOOP ? 4 : rp_times(n, inner_least));
            *most = rp_add(*most, rp_add(rp_times(n, inner_most), op->code == RP_LOOP ? 7 : 0));
            i += op->body;
            break;
        default:
            return "unknown op";
        }
    }
    return NULL;
}

/* Load a plan out of `blob` (an rp_plan_head and its ops) into `plan` and `ops`, which must have room
 * for size - sizeof(rp_plan_head) bytes and stay in place while the plan is used. Returns NULL, or what
 * is wrong with the blob. */
static inline const char *rp_plan_load(rp_plan *plan, rp_op *ops, const uint8_t *blob, size_t size)
{
    rp_plan_head head;
    uint64_t least = 0, most = 0, ignored = 0;
    const char *reason;
    if (size < sizeof head)
        return "plan is shorter than its head";
    memcpy(&head, blob, sizeof head);
    if (head.magic != RP_MAGIC || head.wire > RP_ROS1 || head.reserved)
        return "not a plan";
    if (head.record_size < 1 || head.record_size > RP_MAX_RECORD)
        return "record size is out of range";
    if (((uint64_t)head.native_count + head.swapped_count) * sizeof(rp_op) != size - sizeof head)
        return "number of ops does not match the size";
    if (size > sizeof head)
        memcpy(ops, blob + sizeof head, size - sizeof head);
    reason = rp_check_ops(ops, head.native_count, head.record_size, 0, &least, &most);
    if (!reason)
        reason = rp_check_ops(ops + head.native_count, head.swapped_count, head.record_size, 0, &least, &ignored);
    if (reason)
        return reason;
    most = rp_add(most, 4 + 3); /* encapsulation and padding at the end */
    if (most > SIZE_MAX / 2)
        return "messages can be larger than this machine's memory";
    plan->ops = ops;
    plan->native_count = head.native_count;
    plan->swapped_count = head.swapped_count;
    plan->record_size = head.record_size;
    plan->wire = head.wire;
    plan->bound = (size_t)most;
    return NULL;
}

#endif
