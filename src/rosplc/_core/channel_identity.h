/* Validation of an object's identity: spec/shm-format.md, sections 2 and 9, in the order given there.
 *
 * The caller passes a private copy of the first 512 bytes and the object's size; what agrees becomes an
 * ch_geometry, the only geometry that is ever used afterwards (M3). */
#ifndef ROSPLC_CHANNEL_IDENTITY_H
#define ROSPLC_CHANNEL_IDENTITY_H

#include <string.h>

#include "channel_format.h"

typedef struct {
    uint32_t slot_count, slot_stride, slots_offset, record_size, object_size;
    uint32_t layout_lo, layout_hi, generation, direction;
} ch_geometry;

/* CRC-32 (ISO-HDLC, as zlib's), bit by bit: it runs over 104 bytes, once per attach. */
static inline uint32_t ch_crc32(uint32_t crc, const uint8_t *data, size_t size)
{
    crc = ~crc;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

static inline uint32_t ch_identity_crc(const uint8_t *first_line)
{
    return ch_crc32(ch_crc32(0, first_line, 12), first_line + 16, 92);
}

/* The inequalities that keep every access inside `object_size` bytes; 0, 108 or 109. */
static inline int ch_geometry_check(const ch_geometry *g, uint64_t available)
{
    uint64_t end;
    if (g->slot_count < CH_MIN_SLOTS || g->slot_count > CH_MAX_SLOTS || (g->slot_count & (g->slot_count - 1)))
        return 108;
    if (g->record_size < 1 || g->record_size > CH_MAX_RECORD)
        return 108;
    if (g->slot_stride % 64u || g->slot_stride < (uint64_t)CH_SLOT_HEADER_SIZE + g->record_size)
        return 108;
    if (g->slots_offset % 64u || g->slots_offset < CH_HEADER_SIZE || g->object_size > CH_MAX_OBJECT)
        return 108;
    end = g->slots_offset + (uint64_t)g->slot_count * g->slot_stride;
    if (g->object_size < end)
        return 108;
    return available < g->object_size ? 109 : 0;
}

/* Checks 103 to 111 on the first 512 bytes; 0 means that `out` is filled. `direction` 0 accepts both. */
static inline int ch_identity_check(const uint8_t *first, uint64_t size, uint32_t direction, ch_geometry *out)
{
    ch_identity id;
    int error;
    if (size < CH_HEADER_SIZE)
        return 103;
    memcpy(&id, first, sizeof id);
    if (id.magic != CH_MAGIC)
        return 104;
    if (id.version >> 16 != CH_VERSION >> 16)
        return 105;
    if (id.features_required & ~CH_FEATURES_KNOWN)
        return 106;
    if (id.identity_crc != ch_identity_crc(first))
        return 107;
    if (id.header_size != CH_HEADER_SIZE || id.slot_header_size != CH_SLOT_HEADER_SIZE
        || id.reader_lines != CH_READER_LINES || (id.state != CH_STATE_LIVE && id.state != CH_STATE_RETIRED)
        || id.generation == 0)
        return 108;
    if (id.description_offset < CH_HEADER_SIZE || id.description_size < 2
        || id.description_size > CH_MAX_DESCRIPTION
        || (uint64_t)id.description_offset + id.description_size > id.slots_offset)
        return 108;
    *out = (ch_geometry){id.slot_count, id.slot_stride, id.slots_offset, id.record_size, id.object_size,
                         id.layout_lo,  id.layout_hi,   id.generation,   id.direction};
    if ((error = ch_geometry_check(out, size)) != 0)
        return error;
    if (id.kind != CH_KIND_TOPIC || (id.direction != CH_TO_PLC && id.direction != CH_TO_ROS)
        || (direction && id.direction != direction))
        return 110;
    return id.state == CH_STATE_LIVE ? 0 : 111;
}

#endif
