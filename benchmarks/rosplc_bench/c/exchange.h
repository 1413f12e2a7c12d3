/* The experiment's two sides, over whatever carries the bytes.
 *
 * A writes 100 numbers, B reads them, adds one to each and writes them back, A reads and adds one. A program
 * defines the four functions below and calls exchange_main(). Orders come as lines on standard input:
 *
 *   to B   answer WAIT PERIOD_NS TOTAL                        prints `answering`, then answers TOTAL times
 *   to A   run WAIT PERIOD_NS WARMUP REPEATS CYCLES...        prints two lines of JSON: what came of it, and
 *                                                             the nanoseconds of every cycle
 *
 * WAIT: spin (look again at once), yield (give the core away between two looks), block (sleep until the other
 * has rung), cycle (look once per PERIOD_NS, on an absolute grid; B's lies half a period behind A's).
 */
#ifndef ROSPLC_BENCH_EXCHANGE_H
#define ROSPLC_BENCH_EXCHANGE_H

#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <errno.h>
#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#define COUNT 100
#define BYTES (COUNT * 2)
#define MAX_RUNS 16
#define WATCHDOG 300 /* seconds for one order; who waits longer has lost its peer */

enum { SPIN, YIELD, BLOCK, CYCLE };

static void transport_send(const uint16_t *values);
static int transport_try(uint16_t *values);  /* 1: took something new */
static void transport_ring(void);            /* wake the other; called after sending, with BLOCK only */
static void transport_sleep(void);           /* until the other has rung; with BLOCK only */

static struct {
    int wait;
    uint64_t period, phase; /* ns */
} order;

static __attribute__((unused)) void stop(const char *what)
{
    perror(what);
    exit(1);
}

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static void relax(void)
{
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__arm__) || defined(__aarch64__)
    __asm__ volatile("yield" ::: "memory");
#endif
}

static uint64_t next_tick(void)
{
    uint64_t now = now_ns();
    return (now - order.phase) / order.period * order.period + order.period + order.phase;
}

static void sleep_to_tick(void)
{
    uint64_t tick = next_tick();
    struct timespec t = {(time_t)(tick / 1000000000u), (long)(tick % 1000000000u)};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR)
        ;
}

static void increment(uint16_t *values)
{
    for (int i = 0; i < COUNT; i++)
        values[i]++;
}

static void send_values(const uint16_t *values)
{
    transport_send(values);
    if (order.wait == BLOCK)
        transport_ring();
}

static void receive_values(uint16_t *values)
{
    switch (order.wait) {
    case SPIN:
        while (!transport_try(values))
            relax();
        break;
    case YIELD:
        while (!transport_try(values))
            sched_yield();
        break;
    case BLOCK: /* one ring for each message, so nothing is left over for the next */
        do
            transport_sleep();
        while (!transport_try(values));
        break;
    default:
        do
            sleep_to_tick();
        while (!transport_try(values));
    }
}

/* ---------------------------------------------------------------- the two sides */

static void answer(long total)
{
    uint16_t values[COUNT];
    printf("answering\n");
    fflush(stdout);
    for (long i = 0; i < total; i++) {
        receive_values(values);
        increment(values);
        send_values(values);
    }
}

static uint64_t run(long cycles, uint64_t *spent, int *wrong)
{
    uint16_t values[COUNT] = {0};
    uint64_t start, before;
    if (order.wait == CYCLE)
        sleep_to_tick();
    start = before = now_ns();
    for (long i = 0; i < cycles; i++) {
        uint64_t now;
        send_values(values);
        receive_values(values);
        increment(values);
        now = now_ns();
        spent[i] = now - before;
        before = now;
    }
    for (int i = 0; i < COUNT; i++)
        if (values[i] != (uint16_t)(2 * cycles)) {
            ++*wrong;
            break;
        }
    return before - start;
}

static void measure(long warmup, long repeats, const long *cycles, int count)
{
    long per_repeat = 0, done = 0, longest = warmup;
    int wrong = 0, ignored = 0;
    for (int i = 0; i < count; i++) {
        per_repeat += cycles[i];
        if (cycles[i] > longest)
            longest = cycles[i];
    }
    uint64_t *spent = calloc((size_t)(per_repeat * repeats + longest + 1), sizeof *spent);
    uint64_t *durations = calloc((size_t)(repeats * count), sizeof *durations);
    if (!spent || !durations)
        stop("calloc");
    run(warmup, spent, &ignored);
    for (long r = 0; r < repeats; r++)
        for (int i = 0; i < count; i++) {
            durations[r * count + i] = run(cycles[i], spent + done, &wrong);
            done += cycles[i];
        }
    printf("{\"runs\": %ld, \"wrong\": %d, \"durations_ns\": [", repeats * count, wrong);
    for (long r = 0; r < repeats; r++) {
        printf("%s[", r ? ", " : "");
        for (int i = 0; i < count; i++)
            printf("%s%llu", i ? ", " : "", (unsigned long long)durations[r * count + i]);
        printf("]");
    }
    printf("]}\n[");
    for (long i = 0; i < done; i++)
        printf("%s%llu", i ? "," : "", (unsigned long long)spent[i]);
    printf("]\n");
    fflush(stdout);
    free(spent);
    free(durations);
}

/* ---------------------------------------------------------------- orders */

static long number(const char *text)
{
    long value = text ? atol(text) : 0;
    if (value < 0 || (value == 0 && (!text || strcmp(text, "0")))) {
        fprintf(stderr, "an order lacks a number\n");
        exit(2);
    }
    return value;
}

static __attribute__((unused)) void set_order(char side)
{
    const char *word = strtok(NULL, " \n");
    static const char *const words[] = {"spin", "yield", "block", "cycle"};
    order.wait = -1;
    for (int i = 0; word && i < 4; i++)
        if (!strcmp(word, words[i]))
            order.wait = i;
    order.period = (uint64_t)number(strtok(NULL, " \n"));
    order.phase = side == 'B' ? order.period / 2 : 0;
    if (order.wait < 0 || (order.wait == CYCLE && !order.period)) {
        fprintf(stderr, "an order lacks a way to wait\n");
        exit(2);
    }
}

static __attribute__((unused)) void prepare(void)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    signal(SIGPIPE, SIG_DFL);
}

static __attribute__((unused)) void exchange_main(char side)
{
    static char line[4096];
    prepare();
    printf("ready\n");
    fflush(stdout);
    while (fgets(line, sizeof line, stdin)) {
        const char *word = strtok(line, " \n");
        long cycles[MAX_RUNS], warmup, repeats;
        int count = 0;
        if (!word)
            continue;
        set_order(side);
        alarm(WATCHDOG);
        if (!strcmp(word, "answer")) {
            answer(number(strtok(NULL, " \n")));
        } else {
            warmup = number(strtok(NULL, " \n"));
            repeats = number(strtok(NULL, " \n"));
            for (const char *text; count < MAX_RUNS && (text = strtok(NULL, " \n"));)
                cycles[count++] = number(text);
            measure(warmup, repeats, cycles, count);
        }
        alarm(0);
    }
}

#endif
