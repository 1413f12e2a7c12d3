/* Wire bytes <-> record, by a plan: a validated array of ops, compiled once per layout and wire.
 *
 * Plain C without Python and without allocation. The builder of the ops (rosplc/codec/compile.py) is
 * not trusted: rp_plan_load() proves that no op leaves the record or its loop's element, so that a
 * damaged plan is refused and never writes out of bounds. Wire bytes and records are never trusted.
 *
 *   const char *rp_plan_load(plan, ops, blob, size)              NULL, or what is wrong with the blob
 *   int rp_decode(plan, wire, wire_size, record, truncate, &flags, &fault)              0, or -1: fault
 *   int rp_encode(plan, record, out, out_size, &used, &fault)                           0, or -1: fault
 *   size_t rp_encoded_bound(plan)                                what rp_encode() needs at most
 */
#ifndef ROSPLC_PLAN_H
#define ROSPLC_PLAN_H

#include "plan_decode.h"
#include "plan_encode.h"
#include "plan_load.h"

#endif
