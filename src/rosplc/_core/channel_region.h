/* A mapped object with the private copy of its geometry (M3). */
#ifndef ROSPLC_CHANNEL_REGION_H
#define ROSPLC_CHANNEL_REGION_H

#include "channel_identity.h"
#include "channel_sequence.h"

typedef struct {
    ch_header *header;
    ch_geometry geometry; /* checked against the mapping; the header's own is never read again */
} ch_region;

static inline ch_slot_header *ch_slot(const ch_region *r, uint32_t sequence)
{
    size_t index = sequence & (r->geometry.slot_count - 1u);
    return (ch_slot_header *)(void *)((uint8_t *)r->header + r->geometry.slots_offset
                                      + index * r->geometry.slot_stride);
}

static inline uint8_t *ch_record(ch_slot_header *slot)
{
    return (uint8_t *)slot + CH_SLOT_HEADER_SIZE;
}

/* Section 9, last rule: both words are compared at every call. 0, 111 or 112. */
static inline int ch_region_check(const ch_region *r)
{
    const ch_identity *id = &r->header->identity;
    if (ch_load(&id->state) != CH_STATE_LIVE)
        return 111;
    if (ch_load(&id->layout_lo) != r->geometry.layout_lo || ch_load(&id->layout_hi) != r->geometry.layout_hi)
        return 112;
    return 0;
}

#endif
