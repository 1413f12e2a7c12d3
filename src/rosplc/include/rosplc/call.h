/* Calls: spec/shm-format.md, section 11 (M26, M27), on top of a reader and a writer.
 *
 * An answerer (a server in the PLC, say) reads the request or goal object:
 *
 *   rosplc_answerer_claim                                  claims line 0; waiting messages are not acted on
 *   rosplc_take_record(&reader, &take, record)             ROSPLC_TAKE_NEWEST; stores `taken`
 *   if (rosplc_call_begin(&reader))                        act on it, unless take.status has ROSPLC_ASK_WITHDRAWN
 *
 * and ends each call with one message in the response or result object. A caller publishes a call. To withdraw it, the
 * caller publishes it again with ROSPLC_ASK_WITHDRAWN; rosplc_call_begun returns whether it may have been executed.
 */
#ifndef ROSPLC_CALL_H
#define ROSPLC_CALL_H

#include "reader.h"
#include "writer.h"

/* Claims line 0, whose claim is `expected` (0: free), to act on later calls; returns OK or CLAIMED. Messages already
 * waiting are never acted on. `taken` is unchanged: from it the caller determines the previous call's outcome (M27). */
static inline rosplc_error rosplc_answerer_claim(rosplc_reader *r, uint32_t expected, uint32_t claim, uint32_t beat_ms,
                                                 uint32_t pid)
{
    rosplc_reader_line *line = &r->region->header->reader[0];
    if (!rosplc_compare_and_swap(&line->claim, expected, claim))
        return ROSPLC_ERROR_CLAIMED;
    ROSPLC_F7(); /* a message published without seeing this claim is included in the `head` loaded here */
    r->last = rosplc_load(&r->region->header->writer.head);
    r->fresh = r->last == 0;
    rosplc_reader_enter(r, line, claim, beat_ms, pid);
    return ROSPLC_OK;
}

/* Whether the message just taken may be acted on: it is still the newest, and this reader still owns line 0. If not,
 * take again. */
static inline int rosplc_call_begin(rosplc_reader *r)
{
    ROSPLC_F7();
    return rosplc_load(&r->region->header->writer.head) == r->last && rosplc_reader_owned(r)
           && rosplc_region_check(r->region) == ROSPLC_OK;
}

/* Whether the call whose first message has sequence `first` may have been begun. Call this after publishing the call
 * again as withdrawn. 0: the call was not executed and never will be. */
static inline int rosplc_call_begun(const rosplc_writer *w, uint32_t first)
{
    uint32_t taken, behind;
    ROSPLC_F8();
    taken = rosplc_load(&w->region->header->reader[0].taken);
    behind = rosplc_distance(taken, first, w->region->geometry.slot_count);
    return taken && !(behind && behind < ROSPLC_DISCONTINUITY);
}

#endif
