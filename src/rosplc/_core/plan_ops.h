/* The ops of a plan, and what decoding and encoding share.
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
#ifndef ROSPLC_PLAN_OPS_H
#define ROSPLC_PLAN_OPS_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "records are little-endian, and so must be the machine"
#endif

enum { RP_COPY = 1, RP_SWAP, RP_BOOLS, RP_ZERO, RP_SKIP, RP_STRING, RP_SEQ, RP_LOOP, RP_ARRAY };
enum { RP_BOOL = 1 };             /* flag of SEQ */
enum { RP_CDR = 0, RP_ROS1 = 1 }; /* wires */
enum { RP_TRUNCATED = 2 };        /* bit of a slot's flags (spec/shm-format.md, section 5) */
enum { RP_MAX_DEPTH = 32 };       /* loops inside loops */
#define RP_MAGIC 0x4E4C5052u      /* "RPLN" */
#define RP_NO_OP 0xFFFFFFFFu      /* a fault of the message as a whole */
#define RP_MAX_RECORD ((uint32_t)1 << 30)

typedef struct {
    uint8_t code, align, width, flags;
    uint32_t at, n, count_at, stride, room, bound;
    uint32_t body;  /* LOOP, ARRAY: number of ops in the body; BOOLS: `back` */
    uint32_t least; /* LOOP, ARRAY: fewest wire bytes of one element; computed at load */
} rp_op;

_Static_assert(sizeof(rp_op) == 36, "rosplc/codec/compile.py packs 36 bytes");

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
 *
 *   1  bytes needed at least, bytes there          6  value, 1
 *   2  bytes there, bytes at most                  7  length on the wire, offset of the NUL
 *   3  encapsulation id, 0                            or of the missing terminator
 *   4  string's length, capacity or bound          8  count, bound
 *   5  count, capacity                             9  bytes given, bytes wanted
 */
typedef struct {
    uint32_t code;
    uint32_t op;
    uint64_t size;
    uint64_t limit;
} rp_fault;

/* Sums and products that stop at the largest number. */
static inline uint64_t rp_add(uint64_t a, uint64_t b)
{
    return a > UINT64_MAX - b ? UINT64_MAX : a + b;
}

static inline uint64_t rp_times(uint64_t a, uint64_t b)
{
    return b && a > UINT64_MAX / b ? UINT64_MAX : a * b;
}

static inline uint32_t rp_load32(const uint8_t *from)
{
    uint32_t value;
    memcpy(&value, from, 4);
    /* What is read may change meanwhile: make the compiler keep this one value. */
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

__attribute__((noinline, cold, unused)) static int rp_fail(rp_fault *fault, uint32_t code, uint32_t op,
                                                           uint64_t size, uint64_t limit)
{
    fault->code = code;
    fault->op = op;
    fault->size = size;
    fault->limit = limit;
    return -1;
}

#endif
