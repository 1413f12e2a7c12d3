/* Wire bytes <-> record, by a plan: a validated array of ops, compiled once per layout and wire.
 *
 * Plain C without Python and without allocation. Whoever builds the ops (rosplc/codec/compile.py) is
 * not trusted: rp_plan_load() proves that no op leaves the record or its loop's element, so that a
 * damaged plan is refused and never writes out of bounds. Wire bytes and records are never trusted.
 *
 * A plan has one list of ops for little-endian wires, which decoding and encoding share, and for CDR a
 * second one for big-endian input, where every number is swapped. The op table:
 *
 *   op      fields used                                    on the wire            in the record
 *   COPY    at, n, align                                   n bytes, aligned       the same n bytes
 *   SWAP    at, n, width                                   n numbers, other order n numbers
 *   BOOLS   n, back                                        checks (decode) or makes 0/1 (encode) the n
 *                                                          bytes that begin `back` before the position;
 *                                                          follows the COPY they are part of
 *   ZERO    at, n                                          nothing                n zeros (decode)
 *   SKIP    n                                              n bytes without use    nothing
 *   STRING  at, n = capacity, room, bound                  length, text           text, zeros up to room
 *   SEQ     count_at, at, n = capacity, stride, align,     count, elements in     count, elements,
 *           width (> 1: swapped numbers), room, bound,     one piece              zeros up to room
 *           flags (RP_BOOL)
 *   LOOP    count_at, at, n = capacity, stride, bound,     count, then `body`     count, elements,
 *           room, body                                     for each element       zeros up to room
 *   ARRAY   at, n = length, stride, body                   `body` n times         elements
 *
 * `at` and `count_at` are bytes from the start of the record or of the enclosing loop's element.
 * Strings and counts have alignment 4 in CDR and 1 in ROS 1. The rules that this obeys: XCDR version 1
 * (OMG DDS-XTypes 1.3, 7.4.1), the ROS 1 wire format (wiki.ros.org/msg), spec/type-mapping.md 2.3 and 4.
 */
#ifndef ROSPLC_PLAN_H
#define ROSPLC_PLAN_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "records are little-endian, and so must be the machine"
#endif

enum { RP_COPY = 1, RP_SWAP, RP_BOOLS, RP_ZERO, RP_SKIP, RP_STRING, RP_SEQ, RP_LOOP, RP_ARRAY };
enum { RP_BOOL = 1 };                  /* flag of SEQ */
enum { RP_CDR = 0, RP_ROS1 = 1 };      /* wires */
enum { RP_TRUNCATED = 2 };             /* bit of a slot's flags (spec/shm-format.md, section 5) */
enum { RP_MAX_DEPTH = 32 };            /* loops inside loops */
#define RP_MAGIC 0x4E4C5052u           /* "RPLN" */
#define RP_NO_OP 0xFFFFFFFFu           /* a fault of the message as a whole */
#define RP_MAX_RECORD ((uint32_t)1 << 30)

typedef struct {
    uint8_t code, align, width, flags;
    uint32_t at, n, count_at, stride, room, bound;
    uint32_t body; /* LOOP, ARRAY: number of ops in the body; BOOLS: `back` */
    uint32_t least; /* LOOP, ARRAY: fewest wire bytes of one element; computed at load */
} rp_op;

typedef struct {
    uint32_t magic, wire, record_size, native_count, swapped_count, reserved;
} rp_plan_head;

typedef struct rp_plan {
    const rp_op *ops; /* the native list, then the swapped one */
    uint32_t native_count, swapped_count;
    uint32_t record_size;
    uint32_t wire;
    size_t bound;
} rp_plan;

/* code 0: fine; 1..9: COD001..COD009. What size and limit mean depends on the code:
 * 1 bytes needed at least, bytes there; 2 bytes there, bytes at most; 3 encapsulation id, 0;
 * 4 string's length, capacity or bound; 5 count, capacity; 6 value, 1; 7 length as
 * on the wire, offset of the NUL or of the missing terminator; 8 count, bound; 9 bytes given, bytes wanted. */
typedef struct {
    uint32_t code;
    uint32_t op;
    uint64_t size;
    uint64_t limit;
} rp_fault;

/* ---------------------------------------------------------------- loading */

static inline uint64_t rp_add(uint64_t a, uint64_t b)
{
    return a > UINT64_MAX - b ? UINT64_MAX : a + b;
}

static inline uint64_t rp_times(uint64_t a, uint64_t b)
{
    return b && a > UINT64_MAX / b ? UINT64_MAX : a * b;
}

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
        return "number of ops does not agree with the size";
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

/* ---------------------------------------------------------------- both directions */

static inline uint32_t rp_load32(const uint8_t *from)
{
    uint32_t value;
    memcpy(&value, from, 4);
    /* The record may change while it is read: make the compiler keep this one value. */
    __asm__ volatile("" : "+r"(value));
    return value;
}

static inline void rp_store32(uint8_t *to, uint32_t value)
{
    memcpy(to, &value, 4);
}

static inline void rp_swap_copy(uint8_t *to, const uint8_t *from, size_t n, unsigned width)
{
    uint16_t v2;
    uint32_t v4;
    uint64_t v8;
    switch (width) {
    case 2:
        for (; n; n--, to += 2, from += 2) {
            memcpy(&v2, from, 2);
            v2 = __builtin_bswap16(v2);
            memcpy(to, &v2, 2);
        }
        break;
    case 4:
        for (; n; n--, to += 4, from += 4) {
            memcpy(&v4, from, 4);
            v4 = __builtin_bswap32(v4);
            memcpy(to, &v4, 4);
        }
        break;
    case 8:
        for (; n; n--, to += 8, from += 8) {
            memcpy(&v8, from, 8);
            v8 = __builtin_bswap64(v8);
            memcpy(to, &v8, 8);
        }
        break;
    default:
        memcpy(to, from, n);
    }
}

__attribute__((noinline, cold, unused)) static int rp_fail(rp_fault *fault, uint32_t code, uint32_t op, uint64_t size, uint64_t limit)
{
    fault->code = code;
    fault->op = op;
    fault->size = size;
    fault->limit = limit;
    return -1;
}

/* ---------------------------------------------------------------- decoding */

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
    memcpy(count, from, 4);
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

/* ---------------------------------------------------------------- encoding */

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
