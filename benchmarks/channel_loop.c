/* The channel's operations in C, on the protocol's own headers, against bare copies of the same bytes.
 *
 *   channel_loop operations PATH BATCH      PATH: an object that nobody writes yet
 *   channel_loop exchange PATH_A PATH_B BATCH CORE_A CORE_B
 *
 * Both print one JSON line per line read from standard input: the mean nanoseconds of one operation over a
 * batch, by contender (`exchange`: of many batches). All contenders run in every round, in turn. `exchange` forks: both processes spin,
 * each pinned to its core, and hand 200 bytes (whatever the record has) to each other and back.
 */
#define _GNU_SOURCE
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include "channel_loop.h"

/* ---------------------------------------------------------------- operations of one process */

static void operations(const char *path, long batch)
{
    rosplc_region region = open_object(path);
    uint32_t size = region.geometry.record_size, slots = region.geometry.slot_count;
    size_t stride = region.geometry.slot_stride;
    uint8_t *record = zeroed(size), *out = zeroed(size), *buffers = zeroed(slots * stride);
    rosplc_writer writer;
    rosplc_reader reader;
    char line[16];
    claim(&writer, &region);
    rosplc_reader_observe(&reader, &region, writer.head);
    for (uint32_t i = 0; i < size; i++)
        record[i] = (uint8_t)i;
    while (fgets(line, sizeof line, stdin)) {
        double a, b, c, d, e;
        a = now_ns();
        for (long i = 0; i < batch; i++) {
            memcpy(buffers + (size_t)(i & (slots - 1)) * stride + ROSPLC_SLOT_HEADER_SIZE, record, size);
            used(buffers);
        }
        b = now_ns();
        for (long i = 0; i < batch; i++)
            publish(&writer, record, size);
        c = now_ns();
        for (long i = 0; i < batch; i++) {
            memcpy(buffers + (size_t)(i & (slots - 1)) * stride + ROSPLC_SLOT_HEADER_SIZE, record, size);
            used(buffers);
            memcpy(out, buffers + (size_t)(i & (slots - 1)) * stride + ROSPLC_SLOT_HEADER_SIZE, size);
            used(out);
        }
        d = now_ns();
        for (long i = 0; i < batch; i++) {
            publish(&writer, record, size);
            if (!take(&reader, out, size))
                exit(1);
            used(out);
        }
        e = now_ns();
        printf("{\"copy in\": %.3f, \"publish\": %.3f, \"copy in and out\": %.3f, \"publish and take\": %.3f}\n",
               (b - a) / (double)batch, (c - b) / (double)batch, (d - c) / (double)batch, (e - d) / (double)batch);
        fflush(stdout);
    }
    rosplc_writer_release(&writer);
}

/* ---------------------------------------------------------------- there and back between two processes */

/* The bare exchange: a flag in a line of its own, then the bytes. */
typedef struct {
    _Alignas(64) uint32_t flag;
    _Alignas(64) uint8_t bytes[];
} mailbox;

static void send_bare(mailbox *box, uint32_t number, const uint8_t *record, uint32_t size)
{
    memcpy(box->bytes, record, size);
    __atomic_store_n(&box->flag, number, __ATOMIC_RELEASE);
}

static void receive_bare(mailbox *box, uint32_t number, uint8_t *out, uint32_t size)
{
    while (__atomic_load_n(&box->flag, __ATOMIC_ACQUIRE) != number)
        relax();
    memcpy(out, box->bytes, size);
}

static void receive(rosplc_reader *reader, uint8_t *out, uint32_t size)
{
    while (!rosplc_reader_news(reader) || !take(reader, out, size))
        relax();
}

/* How often both contenders take turns within a round: a batch must be short enough that most of them
 * meet no other process, and the two of a turn the same machine. */
#define TURNS 40

static void print_list(const double *values, int count)
{
    for (int i = 0; i < count; i++)
        printf("%s%.3f", i ? ", " : "[", values[i]);
    printf("]");
}

static void pin(int core)
{
    cpu_set_t set;
    CPU_ZERO(&set);
    CPU_SET(core, &set);
    if (sched_setaffinity(0, sizeof set, &set))
        stop("sched_setaffinity");
}

static int wrong(const uint8_t *record, uint32_t size, uint8_t expected)
{
    return record[0] != expected || record[size / 2] != expected || record[size - 1] != expected;
}

static void exchange(const char *path_a, const char *path_b, long batch, int core_a, int core_b)
{
    rosplc_region forth = open_object(path_a), back = open_object(path_b);
    uint32_t size = forth.geometry.record_size, number = 0;
    size_t room = sizeof(mailbox) + (size + 127u) / 64u * 64u;
    mailbox *boxes[2];
    uint8_t *record = zeroed(size), *out = zeroed(size);
    volatile uint32_t *order = zeroed(64); /* how often the child is to answer; odd: over the channel */
    rosplc_writer writer;
    rosplc_reader reader;
    char line[16];
    pid_t child;
    boxes[0] = zeroed(room);
    boxes[1] = zeroed(room);
    child = fork();
    if (child < 0)
        stop("fork");
    if (child == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        record = zeroed(size);
        pin(core_b);
        claim(&writer, &back);
        rosplc_reader_observe(&reader, &forth, 0);
        if (rosplc_reader_claim(&reader, 0, 0, 2, 1000, (uint32_t)getpid()))
            exit(1);
        for (uint32_t round = 1;; round++) {
            while (*order != round)
                usleep(100);
            for (int turn = 0; turn < TURNS; turn++) {
                for (long i = 0; i < batch; i++) {
                    receive_bare(boxes[0], ++number, record, size);
                    send_bare(boxes[1], number, record, size);
                }
                for (long i = 0; i < batch; i++) {
                    receive(&reader, record, size);
                    publish(&writer, record, size);
                }
            }
        }
    }
    pin(core_a);
    claim(&writer, &forth);
    rosplc_reader_observe(&reader, &back, 0);
    if (rosplc_reader_claim(&reader, 0, 0, 1, 1000, (uint32_t)getpid()))
        exit(1);
    for (uint32_t round = 1; fgets(line, sizeof line, stdin); round++) {
        double bare[TURNS], channel[TURNS];
        long torn = 0;
        *order = round;
        usleep(2000); /* both are up and spinning */
        for (int turn = 0; turn < TURNS; turn++) {
            double a = now_ns(), b;
            for (long i = 0; i < batch; i++) {
                memset(record, (int)(i & 255), size);
                send_bare(boxes[0], ++number, record, size);
                receive_bare(boxes[1], number, out, size);
                torn += wrong(out, size, (uint8_t)i);
            }
            b = now_ns();
            for (long i = 0; i < batch; i++) {
                memset(record, (int)(i & 255), size);
                publish(&writer, record, size);
                receive(&reader, out, size);
                torn += wrong(out, size, (uint8_t)i);
            }
            bare[turn] = (b - a) / (double)batch;
            channel[turn] = (now_ns() - b) / (double)batch;
        }
        if (torn) {
            fprintf(stderr, "%ld answers were not what was sent\n", torn);
            exit(1);
        }
        printf("{\"flag and copy\": ");
        print_list(bare, TURNS);
        printf(", \"channel\": ");
        print_list(channel, TURNS);
        printf("}\n");
        fflush(stdout);
    }
    kill(child, SIGKILL);
    rosplc_writer_release(&writer);
}

int main(int argc, char **argv)
{
    if (argc == 4 && !strcmp(argv[1], "operations"))
        operations(argv[2], atol(argv[3]));
    else if (argc == 7 && !strcmp(argv[1], "exchange"))
        exchange(argv[2], argv[3], atol(argv[4]), atoi(argv[5]), atoi(argv[6]));
    else
        return 2;
    return 0;
}
