/* The channel of spec/shm-format.md: header-only C11 without an operating system, an allocator or Python.
 * Parts, each on top of the one before: format (the drawing), sequence, identity, region, writer, reader. */
#ifndef ROSPLC_CHANNEL_H
#define ROSPLC_CHANNEL_H

#include "channel_reader.h"
#include "channel_writer.h"

#endif
