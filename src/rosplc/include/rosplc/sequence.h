/* Sequence arithmetic of spec/shm-format.md, section 7.1.
 *
 * Sequences count 1 ... 2^32-1, N, N+1 ...: the wrap skips 0 ... N-1, so that 0 means "nothing yet" and
 * slot indices stay continuous. N is a power of two. */
#ifndef ROSPLC_SEQUENCE_H
#define ROSPLC_SEQUENCE_H

#include "numbers.h"

/* The sequence `steps` messages after `s` (steps < 2^31). */
static inline uint32_t rosplc_advance(uint32_t s, uint32_t steps, uint32_t slot_count)
{
    uint32_t t = s + steps;
    return t < s ? t + slot_count : t;
}

static inline uint32_t rosplc_next(uint32_t s, uint32_t slot_count)
{
    return rosplc_advance(s, 1, slot_count);
}

/* Messages from a to b. */
static inline uint32_t rosplc_distance(uint32_t a, uint32_t b, uint32_t slot_count)
{
    return b >= a ? b - a : b - a - slot_count;
}

#endif
