/* The tasks of a PLC, by the C core alone: each wakes on its own schedule and serves its objects.
 *
 *   plc_tasks {task PERIOD PHASE JITTER EVERY {OBJECT|in:OBJECT}...}...
 *
 * Times are in ns. A task wakes at PHASE and every PERIOD from then on, up to JITTER earlier or later. It writes each
 * object every EVERY-th scan, a part of them in each (0: never), and beats in all; of `in:` it is a reader. A record
 * begins with the CLOCK_MONOTONIC time, in seconds and nanoseconds, just before it was published. Ends with its
 * standard input.
 */
#include "objects.h"

#include <pthread.h>

typedef struct {
    int inward;
    rosplc_region region;
    rosplc_writer writer;
    rosplc_reader reader;
} object;

typedef struct {
    uint64_t period, phase, jitter, every, begin;
    object *objects;
    size_t count;
    pthread_t thread;
} task;

static void write_one(object *to)
{
    rosplc_slot_header *slot = begin(&to->writer);
    uint8_t *record = rosplc_record(slot);
    memset(record, 0, to->region.geometry.record_size);
    uint64_t now = now_ns();
    uint32_t words[2] = {(uint32_t)(now / 1000000000), (uint32_t)(now % 1000000000)};
    memcpy(record, words, sizeof words);
    commit(&to->writer, slot);
}

static void *run(void *argument)
{
    task *self = argument;
    unsigned short seed[3] = {(unsigned short)self->phase, (unsigned short)self->begin, (unsigned short)getpid()};
    prctl(PR_SET_TIMERSLACK, 1ul);
    for (uint64_t scan = 0;; scan++) {
        uint64_t early = (uint64_t)(erand48(seed) * 2 * (double)self->jitter);
        sleep_until(self->begin + self->phase + scan * self->period + self->jitter - early);
        for (size_t i = 0; i < self->count; i++) {
            object *one = &self->objects[i];
            if (one->inward)
                rosplc_reader_beat(&one->reader);
            else if (self->every && i % self->every == scan % self->every)
                write_one(one);
            else
                rosplc_writer_beat(&one->writer);
        }
    }
    return NULL;
}

static object opened(const char *word)
{
    object made = {.inward = !strncmp(word, "in:", 3)};
    made.region = open_object(word + (made.inward ? 3 : 0), 0);
    return made;
}

int main(int argc, char **argv)
{
    static task tasks[16];
    char rest[64];
    size_t count = 0;
    prepare();
    for (int at = 1; at < argc; count++) {
        task *one = &tasks[count];
        if (count == 16 || strcmp(argv[at], "task") || at + 5 > argc)
            fail("usage: plc_tasks {task PERIOD PHASE JITTER EVERY {OBJECT|in:OBJECT}...}...");
        *one = (task){.period = (uint64_t)number(argv[at + 1]),
                      .phase = (uint64_t)number(argv[at + 2]),
                      .jitter = (uint64_t)number(argv[at + 3]),
                      .every = (uint64_t)number(argv[at + 4]),
                      .objects = calloc((size_t)argc, sizeof(object))};
        for (at += 5; at < argc && strcmp(argv[at], "task"); at++) {
            object *into = &one->objects[one->count++];
            uint32_t me = (uint32_t)getpid();
            *into = opened(argv[at]);
            rosplc_reader_observe(&into->reader, &into->region, 0);
            if (!into->inward)
                claim(&into->writer, &into->region);
            else if (rosplc_reader_claim(&into->reader, 0, 0, me, 1000, me))
                fail("%s has a reader", argv[at]);
        }
    }
    uint64_t begin = now_ns() + 10000000;
    /* A PLC's tasks go before everything else; where that is not allowed, the figures have more jitter. */
    pthread_attr_t attributes;
    struct sched_param priority = {.sched_priority = 50};
    pthread_attr_init(&attributes);
    pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
    pthread_attr_setschedpolicy(&attributes, SCHED_FIFO);
    pthread_attr_setschedparam(&attributes, &priority);
    for (size_t i = 0; i < count; i++) {
        tasks[i].begin = begin;
        if (pthread_create(&tasks[i].thread, &attributes, run, &tasks[i])
            && pthread_create(&tasks[i].thread, NULL, run, &tasks[i]))
            stop("pthread_create");
    }
    say("{\"ready\": true}");
    while (read(0, rest, sizeof rest) > 0)
        continue;
    for (size_t i = 0; i < count; i++) {
        pthread_cancel(tasks[i].thread);
        pthread_join(tasks[i].thread, NULL);
        for (object *one = tasks[i].objects; one < tasks[i].objects + tasks[i].count; one++) {
            if (one->inward)
                rosplc_reader_release(&one->reader);
            else
                rosplc_writer_release(&one->writer);
        }
    }
    return 0;
}
