/* Validation of an object's identity: spec/shm-format.md, sections 2 and 9, in the order given there.
 *
 * The caller passes a private copy of the first 512 bytes and the object's size. The validated values become a
 * rosplc_geometry, the only geometry that is used afterwards (M3). */
#ifndef ROSPLC_IDENTITY_H
#define ROSPLC_IDENTITY_H

#include "format.h"

typedef struct {
    uint32_t slot_count, slot_stride, slots_offset, record_size, object_size;
    uint32_t layout_lo, layout_hi, generation, direction, kind;
} rosplc_geometry;

/* CRC-32 (ISO-HDLC, as in zlib), bit by bit: it runs over 104 bytes, once per attach. */
static inline uint32_t rosplc_crc32(uint32_t crc, const uint8_t *data, size_t size)
{
    crc = ~crc;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (ROSPLC_CRC_POLYNOMIAL & (0u - (crc & 1u)));
    }
    return ~crc;
}

static inline uint32_t rosplc_identity_crc(const uint8_t *first_line)
{
    return rosplc_crc32(rosplc_crc32(0, first_line, 12), first_line + 16, 92);
}

/* The inequalities that keep every access inside `object_size` bytes; 0, 108 or 109. */
static inline rosplc_error rosplc_geometry_check(const rosplc_geometry *g, uint64_t available)
{
    uint64_t end;
    if (g->slot_count < ROSPLC_MIN_SLOTS || g->slot_count > ROSPLC_MAX_SLOTS
        || (g->slot_count & (g->slot_count - 1)))
        return ROSPLC_ERROR_GEOMETRY;
    if (g->record_size < 1 || g->record_size > ROSPLC_MAX_RECORD_SIZE)
        return ROSPLC_ERROR_GEOMETRY;
    if (g->slot_stride % 64u || g->slot_stride < (uint64_t)ROSPLC_SLOT_HEADER_SIZE + g->record_size)
        return ROSPLC_ERROR_GEOMETRY;
    if (g->slots_offset % 64u || g->slots_offset < ROSPLC_HEADER_SIZE || g->object_size > ROSPLC_MAX_OBJECT_SIZE)
        return ROSPLC_ERROR_GEOMETRY;
    end = g->slots_offset + (uint64_t)g->slot_count * g->slot_stride;
    if (g->object_size < end)
        return ROSPLC_ERROR_GEOMETRY;
    return available < g->object_size ? ROSPLC_ERROR_TRUNCATED : ROSPLC_OK;
}

/* Whether `kind` is that of a topic's, service's or action's object (section 11.1). */
static inline int rosplc_kind_known(uint32_t kind)
{
    return kind == ROSPLC_KIND_TOPIC || kind == ROSPLC_KIND_REQUEST || kind == ROSPLC_KIND_RESPONSE
           || kind == ROSPLC_KIND_GOAL || kind == ROSPLC_KIND_RESULT || kind == ROSPLC_KIND_FEEDBACK;
}

/* Checks 103 to 111 on the first 512 bytes; 0 means that `out` is filled. `kind` is ROSPLC_KIND_TOPIC or another kind;
 * 0 accepts all kinds. `direction` 0 accepts both. */
static inline rosplc_error rosplc_identity_check_kind(const uint8_t *first, uint64_t size, uint32_t kind,
                                                      uint32_t direction, rosplc_geometry *out)
{
    rosplc_identity id;
    rosplc_error error;
    if (size < ROSPLC_HEADER_SIZE)
        return ROSPLC_ERROR_TOO_SMALL;
    memcpy(&id, first, sizeof id);
    if (id.magic != ROSPLC_MAGIC)
        return ROSPLC_ERROR_NOT_ROSPLC;
    if (id.version >> 16 != ROSPLC_VERSION >> 16)
        return ROSPLC_ERROR_VERSION;
    if (id.features_required & ~ROSPLC_FEATURES_KNOWN)
        return ROSPLC_ERROR_FEATURES;
    if (id.identity_crc != rosplc_identity_crc(first))
        return ROSPLC_ERROR_IDENTITY;
    if (id.header_size != ROSPLC_HEADER_SIZE || id.slot_header_size != ROSPLC_SLOT_HEADER_SIZE
        || id.reader_lines != ROSPLC_READER_LINES || (id.state != ROSPLC_STATE_LIVE && id.state != ROSPLC_STATE_RETIRED)
        || id.generation == 0)
        return ROSPLC_ERROR_GEOMETRY;
    if (id.description_offset < ROSPLC_HEADER_SIZE || id.description_size < 2
        || id.description_size > ROSPLC_MAX_DESCRIPTION_SIZE
        || (uint64_t)id.description_offset + id.description_size > id.slots_offset)
        return ROSPLC_ERROR_GEOMETRY;
    out->slot_count = id.slot_count;
    out->slot_stride = id.slot_stride;
    out->slots_offset = id.slots_offset;
    out->record_size = id.record_size;
    out->object_size = id.object_size;
    out->layout_lo = id.layout_id_lo;
    out->layout_hi = id.layout_id_hi;
    out->generation = id.generation;
    out->direction = id.direction;
    out->kind = id.kind;
    error = rosplc_geometry_check(out, size);
    if (error != ROSPLC_OK)
        return error;
    if (!rosplc_kind_known(id.kind) || (kind && id.kind != kind) || (id.direction != ROSPLC_TO_PLC && id.direction != ROSPLC_TO_ROS)
        || (direction && id.direction != direction))
        return ROSPLC_ERROR_DIRECTION;
    return id.state == ROSPLC_STATE_LIVE ? ROSPLC_OK : ROSPLC_ERROR_RETIRED;
}

/* The same for a topic's object. */
static inline rosplc_error rosplc_identity_check(const uint8_t *first, uint64_t size, uint32_t direction,
                                                 rosplc_geometry *out)
{
    return rosplc_identity_check_kind(first, size, ROSPLC_KIND_TOPIC, direction, out);
}

#endif
