/* One Read and one Write block in translated Structured Text, against the C core doing the same.
 *
 *   st_loop FOLDER IN OUT OTHER READ WRITE BATCH
 *
 * FOLDER holds the objects IN (towards the PLC), OUT (towards ROS) and OTHER (as OUT, for the core). READ and
 * WRITE are programs that call one block each and count its messages in udiCount. Prints one JSON line per line
 * read from standard input: the mean nanoseconds of one call in each of TURNS turns, by contender.
 *
 * Messages go through IN in bursts, published outside of the measured time, and are taken in order.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <rosplc/channel.h>

#include "st_runtime.h"

#define TURNS 20
#define BURST 16 /* less than the objects have slots */

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

static void *zeroed(size_t size)
{
    void *memory = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS | MAP_POPULATE, -1, 0);
    if (memory == MAP_FAILED)
        stop("mmap");
    return memory;
}

static const struct st_program *program(const char *name)
{
    for (const struct st_program *p = st_programs; p->name; p++)
        if (!strcmp(p->name, name))
            return p;
    fprintf(stderr, "no program %s\n", name);
    exit(1);
}

static const uint32_t *counter(const struct st_program *p)
{
    for (const struct st_member *m = st_members; m->owner; m++)
        if (!strcmp(m->owner, p->name) && !strcmp(m->name, "UDICOUNT"))
            return (const uint32_t *)((const uint8_t *)*p->instance + m->offset);
    exit(1);
}

static rosplc_region object(const char *folder, const char *name)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return open_object(path);
}

/* What a Read block does in a cycle: the object's state, one message in order, beat. */
static void core_read(rosplc_reader *reader, uint8_t *out, uint32_t size)
{
    rosplc_take t = rosplc_take_start(ROSPLC_TAKE_NEXT);
    int taken = 0;
    if (rosplc_region_check(reader->region))
        stop("retired");
    while (rosplc_take_begin(reader, &t)) {
        memcpy(out, rosplc_record(t.slot), size);
        if (rosplc_take_check(reader, &t)) {
            rosplc_take_accept(reader, &t);
            taken = 1;
        }
    }
    rosplc_reader_beat(reader);
    used(out);
    if (!taken)
        stop("nothing was there");
}

/* What a Write block does in a cycle: the object's state and the claim, one message, beat. */
static void core_write(rosplc_writer *writer, const uint8_t *record, uint32_t size)
{
    publish(writer, record, size);
    rosplc_writer_beat(writer);
}

static void fill(rosplc_writer *source, const uint8_t *record, uint32_t size)
{
    for (int i = 0; i < BURST; i++)
        publish(source, record, size);
}

static void print_list(const char *name, const double *values, const char *end)
{
    printf("\"%s\": ", name);
    for (int i = 0; i < TURNS; i++)
        printf("%s%.3f", i ? ", " : "[", values[i]);
    printf("]%s", end);
}

int main(int argc, char **argv)
{
    rosplc_region in, out, other;
    rosplc_writer source, writer;
    rosplc_reader reader, sink;
    char line[16];
    uint32_t clock = 0, size, reads, writes;
    if (argc != 8)
        return 2;
    const struct st_program *read_block = program(argv[5]), *write_block = program(argv[6]);
    long bursts = (atol(argv[7]) + BURST - 1) / BURST;
    in = object(argv[1], argv[2]);
    out = object(argv[1], argv[3]);
    other = object(argv[1], argv[4]);
    size = in.geometry.record_size;
    uint8_t *record = zeroed(size), *taken = zeroed(size);
    claim(&source, &in);
    claim(&writer, &other);
    rosplc_reader_observe(&reader, &in, 0);
    rosplc_reader_observe(&sink, &out, 0);
    if (rosplc_reader_claim(&reader, 3, 0, 1, 1000, 0) || rosplc_reader_claim(&sink, 0, 0, 1, 1000, 0))
        stop("a line is taken");
    st_set_directory(argv[1]);
    st_start();
    const uint32_t *read_count = counter(read_block), *write_count = counter(write_block);
    for (int i = 0; i < 100; i++) { /* open, attach, claim */
        st_set_time(++clock);
        rosplc_writer_beat(&source);
        rosplc_reader_beat(&sink);
        read_block->body(*read_block->instance);
        write_block->body(*write_block->instance);
    }
    while (fgets(line, sizeof line, stdin)) {
        double times[4][TURNS];
        reads = *read_count;
        writes = *write_count;
        for (int turn = 0; turn < TURNS; turn++) {
            double spent[4] = {0};
            for (long burst = 0; burst < bursts; burst++) {
                double start;
                st_set_time(++clock);
                rosplc_reader_beat(&sink);

                fill(&source, record, size);
                start = now_ns();
                for (int i = 0; i < BURST; i++)
                    read_block->body(*read_block->instance);
                spent[0] += now_ns() - start;
                reader.last = source.head; /* the turn of the other */

                fill(&source, record, size);
                start = now_ns();
                for (int i = 0; i < BURST; i++)
                    core_read(&reader, taken, size);
                spent[1] += now_ns() - start;
                for (int i = 0; i < BURST; i++)
                    read_block->body(*read_block->instance);

                start = now_ns();
                for (int i = 0; i < BURST; i++)
                    write_block->body(*write_block->instance);
                spent[2] += now_ns() - start;
                start = now_ns();
                for (int i = 0; i < BURST; i++)
                    core_write(&writer, record, size);
                spent[3] += now_ns() - start;
            }
            for (int i = 0; i < 4; i++)
                times[i][turn] = spent[i] / (double)(bursts * BURST);
        }
        uint32_t expected = (uint32_t)(TURNS * bursts * BURST);
        if (*read_count - reads != 2 * expected || *write_count - writes != expected) {
            fprintf(stderr, "%u of %u messages read, %u of %u written\n", *read_count - reads, 2 * expected,
                    *write_count - writes, expected);
            return 1;
        }
        printf("{");
        print_list("ST, read", times[0], ", ");
        print_list("C core, read", times[1], ", ");
        print_list("ST, write", times[2], ", ");
        print_list("C core, write", times[3], "}\n");
        fflush(stdout);
    }
    return 0;
}
