/* rosplc's objects, by the C core's own headers. */
#ifndef ROSPLC_BENCH_OBJECTS_H
#define ROSPLC_BENCH_OBJECTS_H

#include <rosplc/channel.h>

#include "common.h"

/* Opens an object with records of `size` bytes; 0: of any size. */
HELPER rosplc_region open_object(const char *path, size_t size)
{
    rosplc_region region;
    struct stat status;
    uint8_t first[ROSPLC_HEADER_SIZE];
    int fd = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0 || fstat(fd, &status) || read(fd, first, sizeof first) != (ssize_t)sizeof first)
        stop(path);
    rosplc_error error = rosplc_identity_check(first, (uint64_t)status.st_size, 0, &region.geometry);
    if (error || (size && region.geometry.record_size != size))
        fail("%s is not an object of %zu bytes (SHM%d)", path, size, error);
    region.header = map(fd, region.geometry.object_size);
    return region;
}

HELPER void claim(rosplc_writer *writer, const rosplc_region *region)
{
    uint32_t me = (uint32_t)getpid();
    if (rosplc_writer_claim(writer, region, 0, me, 1000, me))
        fail("an object has a writer");
}

HELPER rosplc_slot_header *begin(rosplc_writer *writer)
{
    rosplc_error error;
    rosplc_slot_header *slot = rosplc_writer_begin(writer, &error);
    if (!slot)
        fail("SHM%d", error);
    return slot;
}

HELPER void commit(rosplc_writer *writer, rosplc_slot_header *slot)
{
    static const rosplc_meta meta;
    rosplc_writer_commit(writer, slot, &meta);
}

HELPER void publish(rosplc_writer *writer, const void *record, size_t size)
{
    rosplc_slot_header *slot = begin(writer);
    memcpy(rosplc_record(slot), record, size);
    commit(writer, slot);
}

/* Returns whether there was a message. */
HELPER int take(rosplc_reader *reader, rosplc_take attempt, void *out, size_t size)
{
    while (rosplc_take_begin(reader, &attempt)) {
        memcpy(out, rosplc_record(attempt.slot), size);
        if (rosplc_take_check(reader, &attempt)) {
            rosplc_take_accept(reader, &attempt);
            return 1;
        }
    }
    return 0;
}

/* Both ends of a pair of objects, as bridge and PLC hold them: the writer's line of one, a reader's of the other. */
static rosplc_region out_region, in_region;
static rosplc_writer writer;
static rosplc_reader reader;

HELPER void attach(const char *out, const char *in, uint32_t line)
{
    uint32_t me = (uint32_t)getpid();
    out_region = open_object(out, BYTES);
    in_region = open_object(in, BYTES);
    rosplc_reader_observe(&reader, &in_region, 0);
    claim(&writer, &out_region);
    if (rosplc_reader_claim(&reader, line, 0, me, 1000, me))
        fail("%s has a reader", in);
}

/* Keeps a copy that nothing reads. */
HELPER void used(void *memory)
{
    __asm__ volatile("" : : "r"(memory) : "memory");
}

#endif
