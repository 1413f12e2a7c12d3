/* The experiment's two sides, over whatever carries the bytes.
 *
 * A writes 100 numbers, B reads them, adds one to each and writes them back, A reads and adds one. A program
 * defines transport_send and transport_try and calls exchange_main(). Orders come as lines on standard input:
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

#include "common.h"

#define MAX_RUNS 16

static void transport_send(const uint16_t *values);
static int transport_try(uint16_t *values); /* 1: took something new */

/* With BLOCK: posted after sending, and waited for; a request of Modbus needs neither. */
static sem_t *out_bell, *in_bell;

static void relax(void)
{
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__arm__) || defined(__aarch64__)
    __asm__ volatile("yield" ::: "memory");
#endif
}

static void increment(uint16_t *values)
{
    for (int i = 0; i < COUNT; i++)
        values[i]++;
}

static void send_values(const uint16_t *values)
{
    transport_send(values);
    if (order.wait == BLOCK && out_bell)
        sem_post(out_bell);
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
            if (in_bell)
                down(in_bell);
        while (!transport_try(values));
        break;
    default:
        do
            sleep_until(next_tick());
        while (!transport_try(values));
    }
}

/* ---------------------------------------------------------------- the two sides */

static void answer(long total)
{
    uint16_t values[COUNT];
    say("answering");
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
        sleep_until(next_tick());
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
    for (long r = 0; r < repeats; r++)
        print_list(r ? ", " : "", durations + r * count, count);
    print_list("]}\n", spent, done);
    puts("");
    fflush(stdout);
    free(spent);
    free(durations);
}

static void exchange_main(char side)
{
    static char line[4096];
    prepare();
    say("ready");
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
