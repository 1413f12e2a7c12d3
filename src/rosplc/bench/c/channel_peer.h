/* rosplc's channel, by the C core's own headers: an object for each direction, and beside them a named
 * semaphore each as the bell of who sleeps. The channel itself has no bell. */
#ifndef ROSPLC_BENCH_CHANNEL_PEER_H
#define ROSPLC_BENCH_CHANNEL_PEER_H

#include "channel.h"
#include "shared.h"

static ch_region out_region, in_region;
static ch_writer writer;
static ch_reader reader;
static sem_t *out_bell, *in_bell;

static __attribute__((unused)) ch_region open_object(const char *path)
{
    ch_region region;
    struct stat status;
    uint8_t first[CH_HEADER_SIZE];
    int fd = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0 || fstat(fd, &status) || read(fd, first, sizeof first) != (ssize_t)sizeof first)
        stop(path);
    int error = ch_identity_check(first, (uint64_t)status.st_size, 0, &region.geometry);
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
    ch_reader_observe(&reader, &in_region, 0);
    if (ch_writer_claim(&writer, &out_region, 0, me, 1000, me)
        || ch_reader_claim(&reader, line, 0, me, 1000, me)) {
        fprintf(stderr, "the objects are in use\n");
        exit(1);
    }
}

static void transport_send(const uint16_t *values)
{
    static const ch_meta meta;
    int error;
    ch_slot_header *slot = ch_writer_begin(&writer, &error);
    if (!slot) {
        fprintf(stderr, "SHM%d\n", error);
        exit(1);
    }
    memcpy(ch_record(slot), values, BYTES);
    ch_writer_commit(&writer, slot, &meta);
}

static int transport_try(uint16_t *values)
{
    if (!ch_reader_news(&reader))
        return 0;
    ch_take t = ch_take_start(CH_TAKE_NEXT);
    while (ch_take_begin(&reader, &t)) {
        memcpy(values, ch_record(t.slot), BYTES);
        if (ch_take_check(&reader, &t)) {
            ch_take_accept(&reader, &t);
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
