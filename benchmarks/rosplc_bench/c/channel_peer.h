/* rosplc's channel, by the C core's own headers: an object for each direction, and beside them a named
 * semaphore each as the bell of who sleeps. The channel itself has no bell. */
#ifndef ROSPLC_BENCH_CHANNEL_PEER_H
#define ROSPLC_BENCH_CHANNEL_PEER_H

#include <rosplc/channel.h>
#include "shared.h"

static rosplc_region out_region, in_region;
static rosplc_writer writer;
static rosplc_reader reader;
static sem_t *out_bell, *in_bell;

static __attribute__((unused)) rosplc_region open_object(const char *path)
{
    rosplc_region region;
    struct stat status;
    uint8_t first[ROSPLC_HEADER_SIZE];
    int fd = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0 || fstat(fd, &status) || read(fd, first, sizeof first) != (ssize_t)sizeof first)
        stop(path);
    rosplc_error error = rosplc_identity_check(first, (uint64_t)status.st_size, 0, &region.geometry);
    if (error || region.geometry.record_size != BYTES) {
        fprintf(stderr, "%s is not an object of 200 bytes (SHM%d)\n", path, error);
        exit(1);
    }
    region.header = mmap(NULL, region.geometry.object_size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE,
                         fd, 0);
    if (region.header == MAP_FAILED)
        stop(path);
    close(fd);
    return region;
}

/* Claims the writer's line of `out` and a reader's line of `in`, as bridge and PLC do. */
static __attribute__((unused)) void attach(const char *out, const char *in, uint32_t line)
{
    uint32_t me = (uint32_t)getpid();
    out_region = open_object(out);
    in_region = open_object(in);
    rosplc_reader_observe(&reader, &in_region, 0);
    if (rosplc_writer_claim(&writer, &out_region, 0, me, 1000, me)
        || rosplc_reader_claim(&reader, line, 0, me, 1000, me)) {
        fprintf(stderr, "the objects are in use\n");
        exit(1);
    }
}

static void transport_send(const uint16_t *values)
{
    static const rosplc_meta meta;
    rosplc_error error;
    rosplc_slot_header *slot = rosplc_writer_begin(&writer, &error);
    if (!slot) {
        fprintf(stderr, "SHM%d\n", error);
        exit(1);
    }
    memcpy(rosplc_record(slot), values, BYTES);
    rosplc_writer_commit(&writer, slot, &meta);
}

static int transport_try(uint16_t *values)
{
    if (!rosplc_reader_news(&reader))
        return 0;
    rosplc_take t = rosplc_take_start(ROSPLC_TAKE_NEXT);
    while (rosplc_take_begin(&reader, &t)) {
        memcpy(values, rosplc_record(t.slot), BYTES);
        if (rosplc_take_check(&reader, &t)) {
            rosplc_take_accept(&reader, &t);
            return 1;
        }
    }
    return 0;
}

static void transport_ring(void)
{
    sem_post(out_bell);
}

static void transport_sleep(void)
{
    down(in_bell);
}

#endif
