/* The channel of spec/shm-format.md: header-only, C11 and C++17, without an operating system or an allocator.
 *
 * Parts, each based on the previous ones: numbers and format (the memory layout), sequence, identity, region, writer,
 * reader, call. posix.h opens and maps an object; a runtime that maps memory itself fills in a rosplc_region. */
#ifndef ROSPLC_CHANNEL_H
#define ROSPLC_CHANNEL_H

#include "call.h"
#include "reader.h"
#include "writer.h"

#endif
