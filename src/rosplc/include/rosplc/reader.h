/* A reader: spec/shm-format.md, sections 4 and 7.3 (M8, M9, M12 to M16, M23).
 *
 * rosplc_take_record copies a message into private memory. A caller that converts it instead writes this loop
 * of at most 1 + ROSPLC_MAX_RETRIES attempts:
 *
 *   rosplc_take t = rosplc_take_start(ROSPLC_TAKE_NEXT);
 *   while (rosplc_take_begin(&reader, &t)) {         a candidate: t.slot, t.sequence
 *       ... convert rosplc_record(t.slot), reading every count once (M16) ...
 *       if (rosplc_take_check(&reader, &t))          both conditions of M12
 *           rosplc_take_accept(&reader, &t);         stores `taken` before the message is sent (M15); ends the loop
 *   }
 */
#ifndef ROSPLC_READER_H
#define ROSPLC_READER_H

#include "region.h"

enum { ROSPLC_TAKE_NEWEST, ROSPLC_TAKE_NEXT, ROSPLC_TAKE_PEEK };

typedef struct {
    const rosplc_region *region;
    rosplc_reader_line *line; /* NULL: an observer */
    uint32_t claim;       /* own claim, never 0, except in an observer */
    uint32_t last;        /* newest sequence taken; belongs to region->geometry.generation (M14) */
    uint32_t lost, retries, discontinuities;
    int fresh; /* began with last = 0 and has taken nothing: the first message is no loss or discontinuity */
} rosplc_reader;

typedef struct {
    rosplc_slot_header *slot;
    uint32_t sequence, head, lost;
    uint32_t flags, status, stamp_lo, stamp_hi, stamp_clock, correlation_lo, correlation_hi;
    uint32_t client[4], reason; /* 0 for topics */
    uint32_t window; /* the largest distance from head that is accepted: M12, M23 */
    int mode, discontinuity, at_head;
    uint32_t attempts;
} rosplc_take;

/* Starts at `last`. Does not access shared memory. */
static inline void rosplc_reader_observe(rosplc_reader *r, const rosplc_region *region, uint32_t last)
{
    memset(r, 0, sizeof *r);
    r->region = region;
    r->last = last;
    r->fresh = last == 0;
}

/* Fills the reader line that was just claimed, except for `taken`. */
static inline void rosplc_reader_enter(rosplc_reader *r, rosplc_reader_line *line, uint32_t claim, uint32_t beat_ms,
                                       uint32_t pid)
{
    const rosplc_region *region = r->region;
    r->line = line;
    r->claim = claim;
    rosplc_store(&line->lost, 0);
    rosplc_store(&line->retries, 0);
    rosplc_store(&line->error, 0);
    rosplc_store(&line->sinks, ROSPLC_UNKNOWN);
    rosplc_store(&line->beat_ms, beat_ms);
    rosplc_store(&line->layout_lo, region->geometry.layout_lo);
    rosplc_store(&line->layout_hi, region->geometry.layout_hi);
    rosplc_store(&line->pid, pid);
    rosplc_store(&line->beat, rosplc_load(&line->beat) + 1);
    /* `taken` is invalid while the generation does not match, so the generation is written last. */
    rosplc_fence_release(0);
    rosplc_store(&line->generation, region->geometry.generation);
}

/* Claims a line whose claim is `expected` (0: free); returns OK or CLAIMED. Sets the line's `taken` to r->last. */
static inline rosplc_error rosplc_reader_claim(rosplc_reader *r, uint32_t index, uint32_t expected, uint32_t claim,
                                               uint32_t beat_ms, uint32_t pid)
{
    rosplc_reader_line *line = &r->region->header->reader[index];
    if (!rosplc_compare_and_swap(&line->claim, expected, claim))
        return ROSPLC_ERROR_CLAIMED;
    rosplc_store(&line->taken, r->last);
    rosplc_reader_enter(r, line, claim, beat_ms, pid);
    return ROSPLC_OK;
}

/* The line while this reader owns it, else NULL; a reader that lost its line continues as an observer (M9).
 * One thread may beat while another takes, and either may find that the line is lost: callers use the returned
 * pointer, and never read r->line again. */
static inline rosplc_reader_line *rosplc_reader_owned(rosplc_reader *r)
{
    rosplc_reader_line *line = __atomic_load_n(&r->line, __ATOMIC_RELAXED);
    if (line && rosplc_load(&line->claim) != r->claim) {
        line = NULL;
        __atomic_store_n(&r->line, line, __ATOMIC_RELAXED);
    }
    return line;
}

static inline void rosplc_reader_beat(rosplc_reader *r)
{
    rosplc_reader_line *line = rosplc_reader_owned(r);
    if (line)
        rosplc_store(&line->beat, rosplc_load(&line->beat) + 1);
}

static inline void rosplc_reader_release(rosplc_reader *r)
{
    rosplc_reader_line *line = rosplc_reader_owned(r);
    if (line) {
        rosplc_store(&line->beat_ms, 0);
        (void)rosplc_compare_and_swap(&line->claim, r->claim, 0);
    }
    r->line = NULL;
}

/* M13: there is no new message if head is 0, equals `last`, or is so little behind `last` that its slot may
 * still hold a message already taken. */
static inline int rosplc_is_new(const rosplc_reader *r, uint32_t head)
{
    uint32_t n = r->region->geometry.slot_count;
    return head != 0 && (r->last == 0 || rosplc_distance(head, r->last, n) >= n);
}

/* Whether there may be a message to take. */
static inline int rosplc_reader_news(const rosplc_reader *r)
{
    return rosplc_is_new(r, rosplc_load(&r->region->header->writer.head));
}

static inline rosplc_take rosplc_take_start(int mode)
{
    rosplc_take t;
    memset(&t, 0, sizeof t);
    t.mode = mode;
    return t;
}

/* Chooses the message of this attempt: sets sequence, lost, discontinuity. 0: there is none. */
static inline int rosplc_take_choose(const rosplc_reader *r, rosplc_take *t)
{
    uint32_t n = r->region->geometry.slot_count, d;
    t->lost = 0;
    t->discontinuity = 0;
    t->sequence = t->head;
    if (t->mode == ROSPLC_TAKE_PEEK)
        return t->head != 0;
    if (!rosplc_is_new(r, t->head))
        return 0;
    d = rosplc_distance(r->last, t->head, n);
    if (d == 0) /* a head among the sequences that the wrap skips */
        return 0;
    if (d >= ROSPLC_DISCONTINUITY) {
        t->discontinuity = 1;
    } else if (d == 1) {
        /* Equals head, but is computed from `last`: the processor, which predicts this branch, can thus
         * fetch the slot while head is still in transit from the writer's core. Data fetched too early is
         * discarded; F3 orders the loads as before. The empty statement keeps the compiler from seeing
         * that the numbers are equal. */
        uint32_t next = rosplc_next(r->last, n);
        ROSPLC_OPAQUE(next);
        t->sequence = next;
    } else if (t->mode == ROSPLC_TAKE_NEWEST || t->at_head) {
        t->lost = d - 1;
    } else if (d > t->window + 1) {
        t->lost = d - (t->window + 1);
        t->sequence = rosplc_advance(r->last, t->lost + 1, n);
    } else {
        t->sequence = rosplc_next(r->last, n);
    }
    if (r->fresh) {
        t->lost = 0;
        t->discontinuity = 0;
    }
    return 1;
}

/* Begins the next attempt; 0 if there is nothing (more) to try. */
static inline int rosplc_take_begin(rosplc_reader *r, rosplc_take *t)
{
    while (t->attempts <= ROSPLC_MAX_RETRIES) {
        uint32_t before = t->head, sequence;
        int again = t->attempts > 0;
        t->head = rosplc_load(&r->region->header->writer.head);
        t->window = rosplc_window(r->region);
        if (!rosplc_take_choose(r, t))
            return 0;
        if (again) {
            rosplc_reader_line *line = rosplc_reader_owned(r);
            r->retries++;
            if (line)
                rosplc_store(&line->retries, r->retries);
        }
        t->attempts++;
        t->slot = rosplc_slot(r->region, t->sequence);
        sequence = rosplc_load(&t->slot->sequence);
        ROSPLC_F3(); /* after both loads, or a slot sealed during the copy would pass */
        if (sequence == t->sequence
            && rosplc_load(&t->slot->length) == r->region->geometry.record_size) {
            t->flags = rosplc_load(&t->slot->flags);
            t->status = rosplc_load(&t->slot->status);
            t->stamp_lo = rosplc_load(&t->slot->stamp_lo);
            t->stamp_hi = rosplc_load(&t->slot->stamp_hi);
            t->stamp_clock = rosplc_load(&t->slot->stamp_clock);
            t->correlation_lo = rosplc_load(&t->slot->correlation_lo);
            t->correlation_hi = rosplc_load(&t->slot->correlation_hi);
            for (int i = 0; i < 4; i++)
                t->client[i] = rosplc_load(&t->slot->client[i]);
            t->reason = rosplc_load(&t->slot->reason);
            return 1;
        }
        /* M13: if head does not change, and a slot inside the window does not hold its message, the message
         * was never published (a writer claimed with a corrupted head). Continue at head. */
        if (again && before == t->head)
            t->at_head = 1;
    }
    return 0;
}

/* Both conditions of M12, after the copy. The rule is loaded again, since another writer may have taken over the
 * channel during the copy, and the smaller window counts (M23). */
static inline int rosplc_take_check(const rosplc_reader *r, const rosplc_take *t)
{
    uint32_t head, window;
    ROSPLC_F4();
    head = rosplc_load(&r->region->header->writer.head);
    window = rosplc_window(r->region);
    if (window > t->window)
        window = t->window;
    return rosplc_distance(t->sequence, head, r->region->geometry.slot_count) <= window
           && rosplc_load(&t->slot->sequence) == t->sequence
           && rosplc_load(&t->slot->length) == r->region->geometry.record_size;
}

/* Marks the message as taken (unless it was only peeked at), and ends the loop. */
static inline void rosplc_take_accept(rosplc_reader *r, rosplc_take *t)
{
    rosplc_reader_line *line;
    t->attempts = ROSPLC_MAX_RETRIES + 1;
    if (t->mode == ROSPLC_TAKE_PEEK)
        return;
    r->last = t->sequence;
    r->lost += t->lost;
    r->discontinuities += (uint32_t)t->discontinuity;
    r->fresh = 0;
    line = rosplc_reader_owned(r);
    if (line) {
        rosplc_store(&line->taken, r->last);
        if (t->lost)
            rosplc_store(&line->lost, r->lost);
    }
}

/* Copies a message into `record`, private memory of record_size bytes, and returns 1; 0 if there is none to take:
 * the contents of `record` are then undefined. Check the region first (rosplc_region_check). */
static inline int rosplc_take_record(rosplc_reader *r, rosplc_take *t, void *record)
{
    while (rosplc_take_begin(r, t)) {
        ROSPLC_COPY_RECORD(record, rosplc_record(t->slot), r->region->geometry.record_size);
        if (rosplc_take_check(r, t)) {
            rosplc_take_accept(r, t);
            return 1;
        }
    }
    return 0;
}

#endif
