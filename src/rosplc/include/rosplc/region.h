/* A mapped object with the private copy of its geometry (M3). */
#ifndef ROSPLC_REGION_H
#define ROSPLC_REGION_H

#include "format.h"
#include "identity.h"
#include "sequence.h"

typedef struct {
    rosplc_header *header;
    rosplc_geometry geometry; /* checked against the mapping; the header's copy is never read again */
} rosplc_region;

static inline rosplc_slot_header *rosplc_slot(const rosplc_region *r, uint32_t sequence)
{
    size_t index = sequence & (r->geometry.slot_count - 1u);
    return (rosplc_slot_header *)(void *)((uint8_t *)r->header + r->geometry.slots_offset
                                      + index * r->geometry.slot_stride);
}

static inline uint8_t *rosplc_record(rosplc_slot_header *slot)
{
    return (uint8_t *)slot + ROSPLC_SLOT_HEADER_SIZE;
}

/* The largest distance from head at which a slot is accepted: M12, and M23 for a writer under the delayed rule. */
static inline uint32_t rosplc_window(const rosplc_region *r)
{
    return r->geometry.slot_count
           - (rosplc_load(&r->header->writer.writer_rule) == ROSPLC_RULE_DELAYED ? ROSPLC_WINDOW_DELAYED
                                                                                 : ROSPLC_WINDOW_FENCES);
}

/* How long, in ms, a claim must have been silent before it may be replaced (M6, M9). */
static inline uint32_t rosplc_silence_ms(uint32_t beat_ms)
{
    uint32_t silence = (beat_ms < ROSPLC_MAX_BEAT_MS ? beat_ms : ROSPLC_MAX_BEAT_MS) * ROSPLC_SILENT_BEATS;
    if (beat_ms == 0)
        return ROSPLC_SILENT_MS;
    return silence < ROSPLC_MIN_SILENT_MS ? ROSPLC_MIN_SILENT_MS : silence;
}

/* Section 9, last rule: compare state and layout id at every call. After RETIRED or LAYOUT, open the name again. */
static inline rosplc_error rosplc_region_check(const rosplc_region *r)
{
    const rosplc_identity *id = &r->header->identity;
    if (rosplc_load(&id->state) != ROSPLC_STATE_LIVE)
        return ROSPLC_ERROR_RETIRED;
    if (rosplc_load(&id->layout_id_lo) != r->geometry.layout_lo
        || rosplc_load(&id->layout_id_hi) != r->geometry.layout_hi)
        return ROSPLC_ERROR_LAYOUT;
    return ROSPLC_OK;
}

#endif
