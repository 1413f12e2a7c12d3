/* The writer: spec/shm-format.md, sections 3 and 7.2 (M6, M7, M10, M11).
 *
 *   ch_writer_claim      take the channel, load head once
 *   ch_writer_begin      check object and claim, hand out the next slot's record
 *   ... the caller fills the record ...
 *   ch_writer_commit     make it the newest message   or   ch_writer_refuse: leave it unpublished
 */
#ifndef ROSPLC_CHANNEL_WRITER_H
#define ROSPLC_CHANNEL_WRITER_H

#include "channel_region.h"

/* So many bytes of a slot are fetched ahead; the processor follows a longer copy by itself. */
#define CH_PREFETCHED 512u

typedef struct {
    const ch_region *region;
    uint32_t epoch;    /* own claim, never 0 */
    uint32_t head;     /* private (M7): the newest sequence that this writer knows of */
    uint32_t flags;    /* for the next message: CH_FLAG_FIRST until one is published */
} ch_writer;

typedef struct {
    uint32_t flags, status, stamp_lo, stamp_hi, stamp_clock, correlation_lo, correlation_hi;
} ch_meta;

/* Replaces the claim `expected` (0: free) by `epoch`. 0 or 114. Whether another's claim is silent long
 * enough to be replaced is the caller's to judge, who has a clock. */
static inline int ch_writer_claim(ch_writer *w, const ch_region *region, uint32_t expected, uint32_t epoch,
                                  uint32_t beat_ms, uint32_t pid)
{
    ch_writer_line *line = &region->header->writer;
    if (!ch_compare_and_swap(&line->epoch, expected, epoch))
        return 114;
    *w = (ch_writer){region, epoch, ch_load(&line->head), CH_FLAG_FIRST};
    ch_store(&line->beat_ms, beat_ms);
    ch_store(&line->rule, CH_FENCES_RULE);
    ch_store(&line->sources, CH_UNKNOWN); /* those of the writer before are none of ours */
    ch_store(&line->pid, pid);
    ch_store(&line->error, 0);
    ch_store(&line->beat, ch_load(&line->beat) + 1);
    return 0;
}

/* 0 while this writer may write; 111, 112 or 115. */
static inline int ch_writer_check(const ch_writer *w)
{
    int error = ch_region_check(w->region);
    if (error)
        return error;
    return ch_load(&w->region->header->writer.epoch) == w->epoch ? 0 : 115;
}

static inline void ch_writer_beat(const ch_writer *w)
{
    uint32_t *beat = &w->region->header->writer.beat;
    if (ch_load(&w->region->header->writer.epoch) == w->epoch)
        ch_store(beat, ch_load(beat) + 1);
}

/* What publishing will write, fetched all at once. A reader that waits has taken head's line: loading epoch
 * from there, and only then asking for the line again to store head, would cost a journey between two cores
 * each, one after the other, and would hold up all stores into the slot. A third of a round trip. */
static inline void ch_writer_prefetch(const ch_writer *w, const ch_slot_header *slot)
{
    uint32_t size = w->region->geometry.slot_stride;
    ch_prefetch_for_writing(&w->region->header->writer);
    for (uint32_t at = 0; at < size && at < CH_PREFETCHED; at += 64u)
        ch_prefetch_for_writing((const uint8_t *)slot + at);
}

/* Opens the slot of the next message; NULL and *error if this writer may not write. */
static inline ch_slot_header *ch_writer_begin(const ch_writer *w, int *error)
{
    const ch_region *r = w->region;
    ch_slot_header *slot = ch_slot(r, ch_next(w->head, r->geometry.slot_count));
    ch_writer_prefetch(w, slot);
    if ((*error = ch_writer_check(w)) != 0)
        return NULL;
    ch_fence_release(0); /* F1 */
    /* M22, the seal: not even a scribbled head can then present half a message. */
    ch_store(&slot->sequence, 0);
    ch_fence_release(r->geometry.record_size); /* F5 */
    return slot;
}

/* Publishes what has been written into the slot; returns its sequence. */
static inline uint32_t ch_writer_commit(ch_writer *w, ch_slot_header *slot, const ch_meta *meta)
{
    const ch_region *r = w->region;
    ch_writer_line *line = &r->header->writer;
    uint32_t s = ch_next(w->head, r->geometry.slot_count);
    uint32_t flags = meta->flags | w->flags;
    ch_store(&slot->length, r->geometry.record_size);
    ch_store(&slot->flags, flags);
    ch_store(&slot->status, meta->status);
    ch_store(&slot->stamp_lo, meta->stamp_lo);
    ch_store(&slot->stamp_hi, meta->stamp_hi);
    ch_store(&slot->stamp_clock, meta->stamp_clock);
    ch_store(&slot->correlation_lo, meta->correlation_lo);
    ch_store(&slot->correlation_hi, meta->correlation_hi);
    ch_fence_release(r->geometry.record_size); /* F6 */
    ch_store(&slot->sequence, s);
    /* Readers fetch head's line as soon as head changes: a store behind it would take the line away from
     * them again, in the middle of their copy. */
    if (flags & CH_FLAG_TRUNCATED)
        ch_store(&line->truncated, ch_load(&line->truncated) + 1);
    ch_store(&line->beat, ch_load(&line->beat) + 1);
    ch_fence_release(0); /* F2 */
    ch_store(&line->head, s);
    w->head = s;
    w->flags = 0;
    return s;
}

/* Leaves the slot unpublished and counts the message; `error` is the number to show, 0 none. */
static inline void ch_writer_refuse(const ch_writer *w, uint32_t error)
{
    ch_writer_line *line = &w->region->header->writer;
    ch_store(&line->refused, ch_load(&line->refused) + 1);
    if (error)
        ch_store(&line->error, error);
}

/* Gives the claim back, if it is still this writer's. */
static inline void ch_writer_release(const ch_writer *w)
{
    ch_writer_line *line = &w->region->header->writer;
    if (ch_load(&line->epoch) == w->epoch)
        ch_store(&line->beat_ms, 0);
    (void)ch_compare_and_swap(&line->epoch, w->epoch, 0);
}

#endif
