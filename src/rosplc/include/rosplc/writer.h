/* The writer: spec/shm-format.md, sections 3 and 7.2 (M6, M7, M10, M11).
 *
 *   rosplc_writer_claim    take the channel, load head once
 *   rosplc_writer_begin      check object and claim, return the next slot
 *   ... the caller fills the record ...
 *   rosplc_writer_commit     make it the newest message   or   rosplc_writer_refuse: leave it unpublished
 */
#ifndef ROSPLC_WRITER_H
#define ROSPLC_WRITER_H

#include "region.h"

/* Number of bytes of a slot to prefetch; beyond that, the processor's own prefetching keeps up with the copy. */
#define ROSPLC_PREFETCHED 512u

typedef struct {
    const rosplc_region *region;
    uint32_t epoch;    /* own claim, never 0 */
    uint32_t head;     /* private (M7): the newest sequence known to this writer */
    uint32_t flags;    /* for the next message: ROSPLC_FLAG_FIRST until one is published */
} rosplc_writer;

typedef struct {
    uint32_t flags, status, stamp_lo, stamp_hi, stamp_clock, correlation_lo, correlation_hi;
    uint32_t client[4], reason; /* 0 for topics */
} rosplc_meta;

/* Replaces the claim `expected` (0: free) with `epoch`, a random nonzero number. Returns OK or CLAIMED. The caller,
 * which has a clock, decides whether another writer's claim has been silent for long enough (M6). */
static inline rosplc_error rosplc_writer_claim(rosplc_writer *w, const rosplc_region *region, uint32_t expected,
                                               uint32_t epoch, uint32_t beat_ms, uint32_t pid)
{
    rosplc_writer_line *line = &region->header->writer;
    if (!rosplc_compare_and_swap(&line->writer_epoch, expected, epoch))
        return ROSPLC_ERROR_CLAIMED;
    w->region = region;
    w->epoch = epoch;
    w->head = rosplc_load(&line->head);
    w->flags = ROSPLC_FLAG_FIRST;
    rosplc_store(&line->writer_beat_ms, beat_ms);
    rosplc_store(&line->writer_rule, ROSPLC_RULE_FENCES);
    rosplc_store(&line->sources, ROSPLC_UNKNOWN); /* not those of the previous writer */
    rosplc_store(&line->writer_pid, pid);
    rosplc_store(&line->writer_error, 0);
    rosplc_store(&line->writer_beat, rosplc_load(&line->writer_beat) + 1);
    return ROSPLC_OK;
}

/* ROSPLC_OK while this writer may write, else RETIRED, LAYOUT or CLAIM_LOST. */
static inline rosplc_error rosplc_writer_check(const rosplc_writer *w)
{
    rosplc_error error = rosplc_region_check(w->region);
    if (error != ROSPLC_OK)
        return error;
    return rosplc_load(&w->region->header->writer.writer_epoch) == w->epoch ? ROSPLC_OK : ROSPLC_ERROR_CLAIM_LOST;
}

static inline void rosplc_writer_beat(const rosplc_writer *w)
{
    uint32_t *beat = &w->region->header->writer.writer_beat;
    if (rosplc_load(&w->region->header->writer.writer_epoch) == w->epoch)
        rosplc_store(beat, rosplc_load(beat) + 1);
}

/* Prefetches all lines that publishing will write. A waiting reader has the line of `head` in its cache: to load
 * the epoch from this line, and later request it again to store `head`, would cost two successive transfers between
 * cores, and delay all stores into the slot: a third of a round trip. */
static inline void rosplc_writer_prefetch(const rosplc_writer *w, const rosplc_slot_header *slot)
{
    uint32_t size = w->region->geometry.slot_stride;
    rosplc_prefetch_for_writing(&w->region->header->writer);
    for (uint32_t at = 0; at < size && at < ROSPLC_PREFETCHED; at += 64u)
        rosplc_prefetch_for_writing((const uint8_t *)slot + at);
}

/* Returns the next message's slot, sealed; NULL and *error if this writer may not write. */
static inline rosplc_slot_header *rosplc_writer_begin(const rosplc_writer *w, rosplc_error *error)
{
    const rosplc_region *r = w->region;
    rosplc_slot_header *slot = rosplc_slot(r, rosplc_next(w->head, r->geometry.slot_count));
    rosplc_writer_prefetch(w, slot);
    *error = rosplc_writer_check(w);
    if (*error != ROSPLC_OK)
        return NULL;
    ROSPLC_F1();
    /* M22, the seal: then not even a corrupted head can present half a message. */
    rosplc_store(&slot->sequence, 0);
    ROSPLC_F5(r->geometry.record_size);
    return slot;
}

/* Publishes the message written into the slot; returns its sequence. */
static inline uint32_t rosplc_writer_commit(rosplc_writer *w, rosplc_slot_header *slot, const rosplc_meta *meta)
{
    const rosplc_region *r = w->region;
    rosplc_writer_line *line = &r->header->writer;
    uint32_t s = rosplc_next(w->head, r->geometry.slot_count);
    uint32_t flags = meta->flags | w->flags;
    rosplc_store(&slot->length, r->geometry.record_size);
    rosplc_store(&slot->flags, flags);
    rosplc_store(&slot->status, meta->status);
    rosplc_store(&slot->stamp_lo, meta->stamp_lo);
    rosplc_store(&slot->stamp_hi, meta->stamp_hi);
    rosplc_store(&slot->stamp_clock, meta->stamp_clock);
    rosplc_store(&slot->correlation_lo, meta->correlation_lo);
    rosplc_store(&slot->correlation_hi, meta->correlation_hi);
    for (int i = 0; i < 4; i++)
        rosplc_store(&slot->client[i], meta->client[i]);
    rosplc_store(&slot->reason, meta->reason);
    ROSPLC_F6(r->geometry.record_size);
    rosplc_store(&slot->sequence, s);
    /* Readers fetch the line of `head` as soon as it changes: a later store to it would take the line away from
     * them again, in the middle of their copy. */
    if (flags & ROSPLC_FLAG_TRUNCATED)
        rosplc_store(&line->truncated, rosplc_load(&line->truncated) + 1);
    rosplc_store(&line->writer_beat, rosplc_load(&line->writer_beat) + 1);
    ROSPLC_F2();
    rosplc_store(&line->head, s);
    w->head = s;
    w->flags = 0;
    return s;
}

/* Publishes a record of exactly record_size bytes. Returns what rosplc_writer_check returns. */
static inline rosplc_error rosplc_publish(rosplc_writer *w, const void *record, const rosplc_meta *meta)
{
    rosplc_error error;
    rosplc_slot_header *slot = rosplc_writer_begin(w, &error);
    if (slot) {
        ROSPLC_COPY_RECORD(rosplc_record(slot), record, w->region->geometry.record_size);
        rosplc_writer_commit(w, slot, meta);
    }
    return error;
}

/* Leaves the slot unpublished and counts the message as refused; `error` is the number to show, or 0. */
static inline void rosplc_writer_refuse(const rosplc_writer *w, uint32_t error)
{
    rosplc_writer_line *line = &w->region->header->writer;
    rosplc_store(&line->refused, rosplc_load(&line->refused) + 1);
    if (error)
        rosplc_store(&line->writer_error, error);
}

/* Releases the claim if this writer still holds it. */
static inline void rosplc_writer_release(const rosplc_writer *w)
{
    rosplc_writer_line *line = &w->region->header->writer;
    if (rosplc_load(&line->writer_epoch) == w->epoch)
        rosplc_store(&line->writer_beat_ms, 0);
    (void)rosplc_compare_and_swap(&line->writer_epoch, w->epoch, 0);
}

#endif
