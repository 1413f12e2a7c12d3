/* The drawing of spec/shm-format.md as C structs, one per cache line.
 *
 *   0  ch_identity (2 lines)   constant once visible, but `state`
 * 128  ch_writer_line          stored by the writer only
 * 192  ch_reader_line x 4      each stored by its claimant only
 * 448  reserved line
 * 512  self-description, then the slots: ch_slot_header + record each
 *
 * Every word is loaded and stored with ch_load/ch_store: one relaxed 32-bit access (spec, section 1,
 * rule 2); order comes from the explicit fences of section 7, never from the accesses.
 */
#ifndef ROSPLC_CHANNEL_FORMAT_H
#define ROSPLC_CHANNEL_FORMAT_H

#include <stddef.h>
#include <stdint.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the format is little-endian (section 1, rule 1)"
#endif

#define CH_MAGIC 0x434C5052u /* "RPLC" */
#define CH_VERSION 0x00010000u
#define CH_HEADER_SIZE 512u
#define CH_SLOT_HEADER_SIZE 64u
#define CH_READER_LINES 4u
#define CH_FEATURES_KNOWN 0u
#define CH_STATE_LIVE 1u
#define CH_STATE_RETIRED 2u
#define CH_KIND_TOPIC 1u
#define CH_TO_PLC 1u
#define CH_TO_ROS 2u
#define CH_MIN_SLOTS 4u
#define CH_MAX_SLOTS 65536u
#define CH_MAX_RECORD (1u << 30)
#define CH_MAX_DESCRIPTION (1u << 20)
#define CH_MAX_OBJECT 0x7FFFFFFFu
#define CH_FENCES_RULE 1u /* writer_rule: fences F1 to F4 are in force */
#define CH_DELAYED_RULE 2u /* writer_rule: section 7.4; such a writer has neither F1 nor a seal */
#define CH_FLAG_FIRST 1u
#define CH_FLAG_TRUNCATED 2u
#define CH_FLAG_SUBSTITUTED 4u
#define CH_MAX_RETRIES 3 /* M12 */
#define CH_UNKNOWN 0xFFFFFFFFu /* sources, sinks: nobody counts them */

typedef struct {
    uint32_t magic, version, header_size, state;
    uint32_t features_required, features_optional, kind, direction;
    uint32_t slot_count, slot_stride, slot_header_size, record_size;
    uint32_t slots_offset, object_size, description_offset, description_size;
    uint32_t layout_lo, layout_hi, generation, bridge_id[4], creator_pid;
    uint32_t created_lo, created_hi, reader_lines, identity_crc, reserved[4];
} ch_identity;

typedef struct {
    uint32_t head, epoch, beat, beat_ms;
    uint32_t refused, truncated, rule, sources;
    uint32_t pid, error, reserved[6];
} ch_writer_line;

typedef struct {
    uint32_t claim, beat, beat_ms, taken;
    uint32_t layout_lo, layout_hi, lost, retries;
    uint32_t generation, error, sinks, pid;
    uint8_t task[16];
} ch_reader_line;

typedef struct {
    ch_identity identity;
    ch_writer_line writer;
    ch_reader_line reader[CH_READER_LINES];
    uint32_t reserved[16];
} ch_header;

typedef struct {
    uint32_t sequence, length, flags, status;
    uint32_t stamp_lo, stamp_hi, stamp_clock, checksum;
    uint32_t correlation_lo, correlation_hi, client[4], reserved[2];
} ch_slot_header;

#define CH_AT(type, member, offset) \
    _Static_assert(offsetof(type, member) == (offset), #type "." #member " has left its place")
CH_AT(ch_header, identity.magic, 0);
CH_AT(ch_header, identity.state, 12);
CH_AT(ch_header, identity.features_required, 16);
CH_AT(ch_header, identity.direction, 28);
CH_AT(ch_header, identity.slot_count, 32);
CH_AT(ch_header, identity.record_size, 44);
CH_AT(ch_header, identity.slots_offset, 48);
CH_AT(ch_header, identity.description_size, 60);
CH_AT(ch_header, identity.layout_lo, 64);
CH_AT(ch_header, identity.generation, 72);
CH_AT(ch_header, identity.bridge_id, 76);
CH_AT(ch_header, identity.creator_pid, 92);
CH_AT(ch_header, identity.created_lo, 96);
CH_AT(ch_header, identity.reader_lines, 104);
CH_AT(ch_header, identity.identity_crc, 108);
CH_AT(ch_header, identity.reserved, 112);
CH_AT(ch_header, writer.head, 128);
CH_AT(ch_header, writer.epoch, 132);
CH_AT(ch_header, writer.beat, 136);
CH_AT(ch_header, writer.beat_ms, 140);
CH_AT(ch_header, writer.refused, 144);
CH_AT(ch_header, writer.truncated, 148);
CH_AT(ch_header, writer.rule, 152);
CH_AT(ch_header, writer.sources, 156);
CH_AT(ch_header, writer.pid, 160);
CH_AT(ch_header, writer.error, 164);
CH_AT(ch_header, writer.reserved, 168);
CH_AT(ch_header, reader, 192);
CH_AT(ch_header, reserved, 448);
CH_AT(ch_reader_line, taken, 12);
CH_AT(ch_reader_line, layout_lo, 16);
CH_AT(ch_reader_line, lost, 24);
CH_AT(ch_reader_line, retries, 28);
CH_AT(ch_reader_line, generation, 32);
CH_AT(ch_reader_line, error, 36);
CH_AT(ch_reader_line, sinks, 40);
CH_AT(ch_reader_line, pid, 44);
CH_AT(ch_reader_line, task, 48);
CH_AT(ch_slot_header, flags, 8);
CH_AT(ch_slot_header, stamp_lo, 16);
CH_AT(ch_slot_header, stamp_clock, 24);
CH_AT(ch_slot_header, checksum, 28);
CH_AT(ch_slot_header, correlation_lo, 32);
CH_AT(ch_slot_header, client, 40);
CH_AT(ch_slot_header, reserved, 56);
_Static_assert(sizeof(ch_identity) == 128, "the identity is two lines");
_Static_assert(sizeof(ch_writer_line) == 64, "the writer's words are one line");
_Static_assert(sizeof(ch_reader_line) == 64, "a reader's words are one line");
_Static_assert(sizeof(ch_slot_header) == CH_SLOT_HEADER_SIZE, "a slot header is one line");
_Static_assert(sizeof(ch_header) == CH_HEADER_SIZE, "the header is eight lines");
#undef CH_AT

static inline uint32_t ch_load(const uint32_t *word)
{
    return __atomic_load_n(word, __ATOMIC_RELAXED);
}

static inline void ch_store(uint32_t *word, uint32_t value)
{
    __atomic_store_n(word, value, __ATOMIC_RELAXED);
}

static inline int ch_compare_and_swap(uint32_t *word, uint32_t expected, uint32_t desired)
{
    return __atomic_compare_exchange_n(word, &expected, desired, 0, __ATOMIC_SEQ_CST, __ATOMIC_RELAXED);
}

/* A hint to fetch the line at `line` for writing. GCC's own builtin fetches it only for reading unless the
 * machine is known to have PREFETCHW; every x86-64 has it, or takes it for no operation. */
static inline void ch_prefetch_for_writing(const void *line)
{
#if defined(__x86_64__)
    __asm__ volatile("prefetchw %0" : : "m"(*(const char *)line));
#else
    __builtin_prefetch(line, 1);
#endif
}

static inline void ch_fence_acquire(void)
{
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
}

/* A release fence that also orders the stores of a copy of `size` bytes. On x86 plain stores need no
 * instruction, but a C library copies large blocks with non-temporal stores, which no plain store
 * orders: they might overtake the previous store to `head`. */
static inline void ch_fence_release(uint32_t size)
{
#if defined(__x86_64__) || defined(__SSE__)
    if (size >= 16384u)
        __builtin_ia32_sfence();
#else
    (void)size;
#endif
    __atomic_thread_fence(__ATOMIC_RELEASE);
}

#endif
