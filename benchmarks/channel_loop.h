/* What the loops in C share: a clock, an object, and the channel's two operations. */
#ifndef CHANNEL_LOOP_H
#define CHANNEL_LOOP_H

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <rosplc/channel.h>

static void stop(const char *what)
{
    perror(what);
    exit(1);
}

static double now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e9 + (double)t.tv_nsec;
}

static void relax(void)
{
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#endif
}

/* Keeps a copy that nobody reads. */
static void used(void *memory)
{
    __asm__ volatile("" : : "r"(memory) : "memory");
}

static rosplc_region open_object(const char *path)
{
    rosplc_region region;
    struct stat status;
    int fd = open(path, O_RDWR | O_CLOEXEC);
    uint8_t first[ROSPLC_HEADER_SIZE];
    if (fd < 0 || fstat(fd, &status) || read(fd, first, sizeof first) != (ssize_t)sizeof first)
        stop(path);
    if (rosplc_identity_check(first, (uint64_t)status.st_size, 0, &region.geometry)) {
        fprintf(stderr, "%s is not an object\n", path);
        exit(1);
    }
    region.header = mmap(NULL, region.geometry.object_size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
    if (region.header == MAP_FAILED)
        stop("mmap");
    close(fd);
    return region;
}

static void claim(rosplc_writer *writer, const rosplc_region *region)
{
    if (rosplc_writer_claim(writer, region, 0, (uint32_t)getpid(), 1000, (uint32_t)getpid())) {
        fprintf(stderr, "the object has a writer\n");
        exit(1);
    }
}

static void publish(rosplc_writer *writer, const uint8_t *record, uint32_t size)
{
    static const rosplc_meta meta;
    rosplc_error error;
    rosplc_slot_header *slot = rosplc_writer_begin(writer, &error);
    if (!slot)
        exit(1);
    memcpy(rosplc_record(slot), record, size);
    rosplc_writer_commit(writer, slot, &meta);
}

static int take(rosplc_reader *reader, uint8_t *out, uint32_t size)
{
    rosplc_take t = rosplc_take_start(ROSPLC_TAKE_NEWEST);
    while (rosplc_take_begin(reader, &t)) {
        memcpy(out, rosplc_record(t.slot), size);
        if (rosplc_take_check(reader, &t)) {
            rosplc_take_accept(reader, &t);
            return 1;
        }
    }
    return 0;
}

static void *zeroed(size_t size)
{
    void *memory = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS | MAP_POPULATE, -1, 0);
    if (memory == MAP_FAILED)
        stop("mmap");
    return memory;
}

#endif
