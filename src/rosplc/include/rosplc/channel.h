/* The channel of spec/shm-format.md: header-only, C11 and C++17, without an operating system or an allocator.
 *
 * Parts, each on top of the one before: numbers and format (the drawing), sequence, identity, region, writer,
 * reader, call. posix.h opens and maps an object; a runtime with other means fills a rosplc_region itself. */
#ifndef ROSPLC_CHANNEL_H
#define ROSPLC_CHANNEL_H

#include "call.h"
#include "reader.h"
#include "writer.h"

#endif
