/* A reader: spec/shm-format.md, sections 4 and 7.3 (M8, M9, M12 to M16).
 *
 * Taking a message is a loop of at most 1 + CH_MAX_RETRIES attempts, which the caller writes out because
 * only it knows what "copy" means (into a buffer, or converted on the way):
 *
 *   ch_take t = ch_take_start(reader, CH_TAKE_NEXT);
 *   while (ch_take_begin(reader, &t)) {              a candidate slot: t.slot, t.sequence
 *       copy ch_record(t.slot), reading every count once (M16)
 *       if (ch_take_check(reader, &t)) {             both conditions of M12
 *           ch_take_accept(reader, &t);              `taken` is stored here: before anyone sends (M15)
 *           ...
 *       }
 *   }
 */
#ifndef ROSPLC_CHANNEL_READER_H
#define ROSPLC_CHANNEL_READER_H

#include "channel_region.h"

enum { CH_TAKE_NEWEST, CH_TAKE_NEXT, CH_TAKE_PEEK };

typedef struct {
    const ch_region *region;
    ch_reader_line *line; /* NULL: an observer */
    uint32_t claim;       /* own claim, never 0, unless an observer */
    uint32_t last;        /* newest sequence taken; belongs to region->geometry.generation (M14) */
    uint32_t lost, retries, discontinuities;
    int fresh; /* began with last = 0 and has taken nothing: what lies before its first message is no loss */
} ch_reader;

typedef struct {
    ch_slot_header *slot;
    uint32_t sequence, head, lost;
    uint32_t flags, status, stamp_lo, stamp_hi, stamp_clock, correlation_lo, correlation_hi;
    uint32_t window; /* the largest distance from head that is accepted: M12, M23 */
    int mode, attempts, discontinuity, at_head;
} ch_take;

/* Starts at `last`. Touches no shared word. */
static inline void ch_reader_observe(ch_reader *r, const ch_region *region, uint32_t last)
{
    *r = (ch_reader){.region = region, .last = last, .fresh = last == 0};
}

/* Claims a line whose claim is `expected` (0: free); 0 or 114. The line's `taken` becomes reader->last. */
static inline int ch_reader_claim(ch_reader *r, uint32_t index, uint32_t expected, uint32_t claim, uint32_t beat_ms,
                                  uint32_t pid)
{
    const ch_region *region = r->region;
    ch_reader_line *line = &region->header->reader[index];
    if (!ch_compare_and_swap(&line->claim, expected, claim))
        return 114;
    r->line = line;
    r->claim = claim;
    /* A generation that does not match voids `taken`: so it is written last. */
    ch_store(&line->taken, r->last);
    ch_store(&line->lost, 0);
    ch_store(&line->retries, 0);
    ch_store(&line->error, 0);
    ch_store(&line->sinks, CH_UNKNOWN);
    ch_store(&line->beat_ms, beat_ms);
    ch_store(&line->layout_lo, region->geometry.layout_lo);
    ch_store(&line->layout_hi, region->geometry.layout_hi);
    ch_store(&line->pid, pid);
    ch_store(&line->beat, ch_load(&line->beat) + 1);
    ch_fence_release(0);
    ch_store(&line->generation, region->geometry.generation);
    return 0;
}

/* The line while it is this reader's, else NULL; a reader that lost its line goes on as an observer (M9).
 * One thread may beat while another takes, and either may find that the line is lost: so whoever uses the
 * line uses what this returned, and never r->line a second time. */
static inline ch_reader_line *ch_reader_owned(ch_reader *r)
{
    ch_reader_line *line = __atomic_load_n(&r->line, __ATOMIC_RELAXED);
    if (line && ch_load(&line->claim) != r->claim) {
        line = NULL;
        __atomic_store_n(&r->line, line, __ATOMIC_RELAXED);
    }
    return line;
}

static inline void ch_reader_beat(ch_reader *r)
{
    ch_reader_line *line = ch_reader_owned(r);
    if (line)
        ch_store(&line->beat, ch_load(&line->beat) + 1);
}

static inline void ch_reader_release(ch_reader *r)
{
    ch_reader_line *line = ch_reader_owned(r);
    if (line) {
        ch_store(&line->beat_ms, 0);
        (void)ch_compare_and_swap(&line->claim, r->claim, 0);
    }
    r->line = NULL;
}

/* M13: nothing is new under a head that is 0, or at `last`, or so little behind it that its slot may
 * still hold a message already taken. */
static inline int ch_is_new(const ch_reader *r, uint32_t head)
{
    uint32_t n = r->region->geometry.slot_count;
    return head != 0 && (r->last == 0 || ch_distance(head, r->last, n) >= n);
}

/* Whether there may be something to take. */
static inline int ch_reader_news(const ch_reader *r)
{
    return ch_is_new(r, ch_load(&r->region->header->writer.head));
}

static inline ch_take ch_take_start(int mode)
{
    return (ch_take){.mode = mode};
}

/* Which message this attempt is about: sets sequence, lost, discontinuity. 0: there is none. */
static inline int ch_take_choose(const ch_reader *r, ch_take *t)
{
    uint32_t n = r->region->geometry.slot_count, d;
    t->lost = 0;
    t->discontinuity = 0;
    t->sequence = t->head;
    if (t->mode == CH_TAKE_PEEK)
        return t->head != 0;
    if (!ch_is_new(r, t->head))
        return 0;
    d = ch_distance(r->last, t->head, n);
    if (d >= CH_DISCONTINUITY) {
        t->discontinuity = 1;
    } else if (d == 1) {
        /* The same number as head, computed from `last`: so that the processor, which foresees that branch,
         * fetches the slot while head is still on its way from the writer's core. Whatever it fetched too
         * early it throws away; F3 orders the loads as before. The empty statement keeps the compiler from
         * seeing that the numbers are equal. */
        uint32_t next = ch_next(r->last, n);
        __asm__("" : "+r"(next));
        t->sequence = next;
    } else if (t->mode == CH_TAKE_NEWEST || t->at_head) {
        t->lost = d - 1;
    } else if (d > t->window + 1) {
        t->lost = d - (t->window + 1);
        t->sequence = ch_advance(r->last, t->lost + 1, n);
    } else {
        t->sequence = ch_next(r->last, n);
    }
    if (r->fresh)
        t->lost = 0;
    return 1;
}

/* The next attempt; 0 when there is nothing (more) to try. */
static inline int ch_take_begin(ch_reader *r, ch_take *t)
{
    while (t->attempts <= CH_MAX_RETRIES) {
        uint32_t before = t->head, sequence;
        int again = t->attempts > 0;
        t->head = ch_load(&r->region->header->writer.head);
        t->window = r->region->geometry.slot_count
                    - (ch_load(&r->region->header->writer.rule) == CH_DELAYED_RULE ? 3 : 2);
        if (!ch_take_choose(r, t))
            return 0;
        if (again) {
            ch_reader_line *line = ch_reader_owned(r);
            r->retries++;
            if (line)
                ch_store(&line->retries, r->retries);
        }
        t->attempts++;
        t->slot = ch_slot(r->region, t->sequence);
        sequence = ch_load(&t->slot->sequence);
        ch_fence_acquire(); /* F3: after both, or a slot sealed during the copy would pass */
        if (sequence == t->sequence
            && ch_load(&t->slot->length) == r->region->geometry.record_size) {
            t->flags = ch_load(&t->slot->flags);
            t->status = ch_load(&t->slot->status);
            t->stamp_lo = ch_load(&t->slot->stamp_lo);
            t->stamp_hi = ch_load(&t->slot->stamp_hi);
            t->stamp_clock = ch_load(&t->slot->stamp_clock);
            t->correlation_lo = ch_load(&t->slot->correlation_lo);
            t->correlation_hi = ch_load(&t->slot->correlation_hi);
            return 1;
        }
        /* M13: a message inside the window that its slot does not hold, under a head that stands still,
         * was never published (a writer claimed a scribbled head). The newest one decides. */
        if (again && before == t->head)
            t->at_head = 1;
    }
    return 0;
}

/* Both conditions of M12, after the copy. */
static inline int ch_take_check(const ch_reader *r, const ch_take *t)
{
    uint32_t head;
    uint32_t n = r->region->geometry.slot_count;
    ch_fence_acquire(); /* F4 */
    head = ch_load(&r->region->header->writer.head);
    return ch_distance(t->sequence, head, n) <= t->window && ch_load(&t->slot->sequence) == t->sequence
           && ch_load(&t->slot->length) == r->region->geometry.record_size;
}

/* Makes the message the last one taken (but a peeked one), and ends the loop. */
static inline void ch_take_accept(ch_reader *r, ch_take *t)
{
    ch_reader_line *line;
    t->attempts = CH_MAX_RETRIES + 1;
    if (t->mode == CH_TAKE_PEEK)
        return;
    r->last = t->sequence;
    r->lost += t->lost;
    r->discontinuities += (uint32_t)t->discontinuity;
    r->fresh = 0;
    line = ch_reader_owned(r);
    if (line) {
        ch_store(&line->taken, r->last);
        if (t->lost)
            ch_store(&line->lost, r->lost);
    }
}

#endif
