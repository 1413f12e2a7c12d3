/* The shared memory of ros1_node.cpp: rosplc's headers are C. */
#include "objects.h"

typedef struct {
    rosplc_region region;
    rosplc_writer writer;
    rosplc_reader reader;
    rosplc_slot_header *slot;
} object;

object *object_open(const char *path, int inward)
{
    object *one = calloc(1, sizeof *one);
    uint32_t me = (uint32_t)getpid();
    if (!one)
        stop("calloc");
    one->region = open_object(path, 0);
    if (inward)
        claim(&one->writer, &one->region);
    rosplc_reader_observe(&one->reader, &one->region, 0);
    if (!inward && rosplc_reader_claim(&one->reader, 0, 0, me, 1000, me))
        fail("%s has a reader", path);
    return one;
}

size_t object_size(const object *one)
{
    return one->region.geometry.record_size;
}

uint8_t *object_begin(object *one)
{
    return rosplc_record(one->slot = begin(&one->writer));
}

void object_commit(object *one)
{
    commit(&one->writer, one->slot);
}

int object_next(object *one, uint8_t *record)
{
    return rosplc_reader_news(&one->reader)
           && take(&one->reader, rosplc_take_start(ROSPLC_TAKE_NEXT), record, object_size(one));
}
