/* The source's design: shared memory for each direction, a named semaphore as its lock, and a reader that looks
 * again until the numbers have changed.
 *
 *   semaphore SIDE FILE NAME_A NAME_B [signal]
 *
 * With `signal` the same parts as one would use them to hand over: the semaphore begins at 0, the writer posts
 * it and the reader waits for it. That is not the source's design; it shows what its parts allow.
 */
#include "shared.h"

typedef struct {
    _Alignas(64) uint16_t values[COUNT];
} area;

static area *out, *in;
static sem_t *out_lock, *in_lock;
static uint16_t seen[COUNT];
static int signals;

static void transport_send(const uint16_t *values)
{
    if (signals) {
        memcpy(out->values, values, BYTES);
        return;
    }
    down(out_lock);
    memcpy(out->values, values, BYTES);
    sem_post(out_lock);
}

static int transport_try(uint16_t *values)
{
    if (signals) {
        memcpy(values, in->values, BYTES);
        return 1;
    }
    down(in_lock);
    memcpy(values, in->values, BYTES);
    sem_post(in_lock);
    if (!memcmp(values, seen, BYTES))
        return 0;
    memcpy(seen, values, BYTES);
    return 1;
}

static void transport_ring(void)
{
    if (signals)
        sem_post(out_lock);
}

static void transport_sleep(void)
{
    if (signals)
        down(in_lock);
    else
        sched_yield();
}

int main(int argc, char **argv)
{
    if (argc < 5)
        return 2;
    int b = argv[1][0] == 'B';
    area *areas = map_file(argv[2], 2 * sizeof *areas);
    signals = argc > 5;
    memset(areas, 0xff, 2 * sizeof *areas); /* nothing that a first message could be equal to */
    memset(seen, 0xff, sizeof seen);
    out = &areas[b];
    in = &areas[!b];
    out_lock = named_semaphore(argv[3 + b], signals ? 0 : 1);
    in_lock = named_semaphore(argv[3 + !b], signals ? 0 : 1);
    exchange_main(argv[1][0]);
    return 0;
}
