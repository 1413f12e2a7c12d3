/* Calls: spec/shm-format.md, section 11 (M26, M27), on top of a reader and a writer.
 *
 * An answerer (a server in the PLC, say) reads the request or goal object:
 *
 *   rosplc_answerer_claim                                  line 0; nothing that waited is acted on
 *   rosplc_take_record(&reader, &take, record)             ROSPLC_TAKE_NEWEST; stores `taken`
 *   if (rosplc_call_begin(&reader))                        act on it, unless take.status has ROSPLC_ASK_WITHDRAWN
 *
 * and ends each call with one message in the response or result object. A caller publishes a call, and to withdraw it
 * publishes it again with ROSPLC_ASK_WITHDRAWN; rosplc_call_begun then tells whether it may have been executed.
 */
#ifndef ROSPLC_CALL_H
#define ROSPLC_CALL_H

#include "reader.h"
#include "writer.h"

/* Claims line 0, whose claim is `expected` (0: free), to act on the calls that come from now on; OK or CLAIMED. What
 * waits is never acted on, and `taken` stays: it tells the caller what became of the call before (M27). */
static inline rosplc_error rosplc_answerer_claim(rosplc_reader *r, uint32_t expected, uint32_t claim, uint32_t beat_ms,
                                                 uint32_t pid)
{
    rosplc_reader_line *line = &r->region->header->reader[0];
    if (!rosplc_compare_and_swap(&line->claim, expected, claim))
        return ROSPLC_ERROR_CLAIMED;
    ROSPLC_F7(); /* who publishes without seeing this claim has published what `head` shows now */
    r->last = rosplc_load(&r->region->header->writer.head);
    r->fresh = r->last == 0;
    rosplc_reader_enter(r, line, claim, beat_ms, pid);
    return ROSPLC_OK;
}

/* Whether the message just taken may be acted on: it is still the newest, and line 0 still this reader's. If not,
 * take again. */
static inline int rosplc_call_begin(rosplc_reader *r)
{
    ROSPLC_F7();
    return rosplc_load(&r->region->header->writer.head) == r->last && rosplc_reader_owned(r)
           && rosplc_region_check(r->region) == ROSPLC_OK;
}

/* Whether the call whose first message has sequence `first` may have been begun; to be asked after it was published
 * again as withdrawn. 0: it was not executed and never will be. */
static inline int rosplc_call_begun(const rosplc_writer *w, uint32_t first)
{
    uint32_t taken, behind;
    ROSPLC_F8();
    taken = rosplc_load(&w->region->header->reader[0].taken);
    behind = rosplc_distance(taken, first, w->region->geometry.slot_count);
    return taken && !(behind && behind < ROSPLC_DISCONTINUITY);
}

#endif
