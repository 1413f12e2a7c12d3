/* Steps predict.h through histories without real time.
 *
 *   predict_test history SEED JITTER LONGEST {steady|irregular PERIOD TOPICS}...
 *                                times in µs; ten seconds, ticks of 1 ms; LONGEST: as rp_next() takes it
 *   predict_test scribble SEED   looks, heads and ticks at random
 *
 * Prints how many looks there were, and how late news was found in the last seven seconds, in µs.
 */
#include <stdio.h>
#include <stdlib.h>

#include "predict.h"

enum { TASKS = 4, STREAMS = 64, MOST = 200000 };
static const int64_t TICK = 1000000, BEGIN = 3000000000, END = 10000000000, WAKE = 60000;

typedef struct {
    int irregular, first, topics;
    int64_t period, phase, due, scan;
} plc_task;

static plc_task tasks[TASKS];
static rp_stream streams[STREAMS];
static uint32_t heads[STREAMS];
static int64_t late[MOST];

static int64_t drawn(int64_t most)
{
    return (int64_t)(drand48() * (double)most);
}

static int compared(const void *a, const void *b)
{
    int64_t one = *(const int64_t *)a, other = *(const int64_t *)b;
    return (one > other) - (one < other);
}

/* When a task publishes next. */
static void scan_next(plc_task *one, int64_t jitter)
{
    one->scan += one->irregular ? 1 + drawn(9) : 1;
    one->due = one->phase + one->scan * one->period + (jitter ? drawn(2 * jitter) - jitter : 0);
}

static int history(int count, char **words, int64_t jitter, int64_t longest)
{
    rp_predictor p = {.streams = streams};
    long looks = 0, found = 0;
    for (int i = 0; i < count; i++) {
        plc_task *one = &tasks[i];
        *one = (plc_task){.irregular = words[3 * i][0] == 'i', .first = (int)p.count};
        one->period = atol(words[3 * i + 1]) * 1000;
        one->topics = atoi(words[3 * i + 2]);
        one->phase = TICK + drawn(one->period);
        one->due = one->phase;
        p.count += (uint32_t)one->topics;
    }
    for (int64_t planned = TICK, due; planned < END; planned = due, looks++) {
        int64_t now = planned + WAKE;
        rp_look(&p, planned, now, TICK);
        for (int i = 0; i < count; i++) {
            for (plc_task *one = &tasks[i]; one->due <= now; scan_next(one, jitter)) {
                if (one->due >= BEGIN && found < MOST)
                    late[found++] = now - one->due;
                for (int s = one->first; s < one->first + one->topics; s++)
                    heads[s]++;
            }
        }
        for (uint32_t s = 0; s < p.count; s++)
            rp_news(&p, s, heads[s]);
        due = rp_next(&p, longest);
        if (due <= planned || due > planned + (longest > TICK ? longest : TICK) + TICK / RP_SLACK)
            return fprintf(stderr, "after the look at %lld comes %lld\n", (long long)planned, (long long)due), 1;
    }
    qsort(late, (size_t)found, sizeof *late, compared);
    printf("looks %ld found %ld median %ld p99 %ld\n", looks, found, (long)(late[found / 2] / 1000),
           (long)(late[found * 99 / 100] / 1000)); /* without any: 0 */
    return 0;
}

static int scribble(void)
{
    rp_predictor p = {.streams = streams, .count = STREAMS};
    int64_t now = 1, due = 1;
    for (long i = 0; i < 300000; i++) {
        int64_t tick = drawn(8) ? TICK : 1 + drawn(60 * END), planned = drawn(4) ? due : now + drawn(TICK);
        now += drawn(50) ? drawn(2 * TICK) : drawn(100 * END);
        rp_look(&p, planned, now > planned ? now : planned, tick);
        for (uint32_t s = 0; s < STREAMS; s++)
            if (drawn(3))
                rp_news(&p, s, streams[s].head + (drawn(16) ? 1 : (uint32_t)mrand48()));
        if (!drawn(100))
            rp_leave(&p, &streams[drawn(STREAMS)]);
        due = rp_next(&p, drawn(2) ? drawn(20 * TICK) : 0);
        if (!drawn(1000))
            rp_forget(&p);
        for (rp_task *t = p.tasks; t < p.tasks + RP_TASKS; t++)
            if (t->members > STREAMS || (t->members && t->period <= 0))
                return fprintf(stderr, "a task has %u members, period %lld\n", t->members, (long long)t->period), 1;
        now = now > planned ? now : planned;
    }
    return 0;
}

int main(int argc, char **argv)
{
    if (argc < 3)
        return 2;
    srand48(atol(argv[2]));
    return argv[1][0] == 's' ? scribble() : history((argc - 5) / 3, argv + 5, atol(argv[3]) * 1000, atol(argv[4]) * 1000);
}
