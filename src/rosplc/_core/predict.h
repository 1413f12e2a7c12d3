/* When to look for news next: learns the periods of what a PLC's tasks publish, from when looks found news. Pure: it is
 * given all times, in ns of one clock. py_group.c sleeps, looks, and tells.
 *
 *   rp_look(p, planned, now, tick);  a look begins
 *   rp_news(p, i, head);             for each stream whose head has changed since the look before
 *   due = rp_next(p, longest);       the look is over; the next one is due
 *
 * A look never comes later than one tick after the one before (or tick / SLACK more, if news is expected then). With
 * `longest` it may, as long as tasks explain all that changes, and nothing of theirs is late: it waits for them. Streams
 * that publish steadily and together form a task. Its next publication is expected one period after the last, at an aim
 * that moves a little earlier whenever everything was there, and further up when something was late: so about one aim in
 * seventeen is missed, and jitter decides how late it lies. Looks beyond one per tick are bounded by a credit.
 */
#ifndef ROSPLC_PREDICT_H
#define ROSPLC_PREDICT_H

#include <stdint.h>
#include <string.h>

enum {
    RP_TASKS = 8,
    RP_FINDS = 32,   /* publications that show a period */
    RP_SILENT = 8,   /* of its publications missed in a row end a stream's part in a task */
    RP_BLOCK = 256,  /* the most publications from which a period is corrected */
    RP_RUN = 32,     /* aims reached in a row that show that the aim is far too late */
    RP_SLACK = 8,    /* parts of a tick: how long a look may wait for news that is expected */
    RP_STEP = 8,     /* parts of a tick: an aim's first step, and how soon after a miss is the next look */
    RP_SETTLED = 32, /* parts of a tick: the step from which on aims show the period */
    RP_FINEST = 256, /* parts of a tick: its last step */
    RP_UP = 15,      /* last steps that an aim moves up in addition */
    RP_JITTER = 10,  /* parts of a tick: what a steady stream may be early or late by */
    RP_CREDIT = 4,   /* ticks for one that looks may come early in all */
    RP_SAVED = 16,   /* ticks that they may come early at once */
    RP_PAUSE = 1000, /* looks without any prediction, once they came early too often */
    RP_CALM = 1000   /* ticks in which tasks have explained all that changed, after which looks may wait for them */
};

typedef struct {
    uint32_t head;     /* the last one that was told */
    uint32_t count;    /* publications since the first of those that are to show a period; 0: none yet */
    uint32_t round;    /* of its task, in which it last published */
    uint8_t task;      /* 1 ...; 0: none */
    uint8_t silent;    /* rounds of its task without it */
    int64_t low, high; /* the first publication came between these */
    int64_t shortest, longest; /* what its period may be */
} rp_stream;

typedef struct {
    int64_t period, aim, step, sum;
    uint32_t members, round, arrived; /* arrived: members in this round */
    int64_t last;                     /* the look that found the last of them */
    uint32_t run, count, block;       /* aims reached or missed in a row; corrections in `sum`; of how many */
    int missed, late, settled;        /* late: something of the round before has not arrived */
} rp_task;

typedef struct {
    rp_task tasks[RP_TASKS];
    rp_stream *streams; /* the caller's */
    uint32_t count;
    int64_t tick, planned, now, before; /* of this look; when the look before was */
    int64_t again;                      /* a look after a miss; 0 none */
    int64_t due, early;                 /* the look that was asked for; how much before its tick */
    int64_t credit;
    uint32_t pause;
    int64_t strange; /* when something changed that no task explains */
} rp_predictor;

static inline void rp_leave(rp_predictor *p, rp_stream *s)
{
    if (s->task)
        p->tasks[s->task - 1].members--;
    s->task = 0;
    s->count = 0;
}

/* Forgets all periods: other counters are told from now on. */
static inline void rp_forget(rp_predictor *p)
{
    for (uint32_t i = 0; i < p->count; i++)
        rp_leave(p, &p->streams[i]);
}

static inline void rp_look(rp_predictor *p, int64_t planned, int64_t now, int64_t tick)
{
    int64_t since = now - p->now, most = RP_SAVED * tick;
    p->credit += since / RP_CREDIT - (planned == p->due ? p->early : 0);
    if (p->credit > most || since > most)
        p->credit = most;
    if (p->credit < 0) {
        p->credit = 0;
        p->pause = RP_PAUSE;
        rp_forget(p);
    } else if (p->pause) {
        p->pause--;
    }
    p->tick = tick;
    p->before = p->now;
    p->now = now;
    p->planned = planned;
    if (p->again <= planned)
        p->again = 0;
}

/* Moves an aim, and learns from it: what all corrections of some rounds have in common is the period's error. */
static inline void rp_move(rp_predictor *p, rp_task *t, int missed, int64_t by)
{
    int64_t finest = p->tick / RP_FINEST + 1;
    t->aim += by;
    t->run = t->missed == missed ? t->run + 1 : 1;
    if (t->missed != missed)
        t->step /= 2;
    else if (t->run % (missed ? 3 : RP_RUN) == 0)
        t->step *= 2;
    if (t->step < finest)
        t->step = finest;
    if (t->step > p->tick / RP_STEP)
        t->step = p->tick / RP_STEP;
    t->missed = missed;
    if (!t->settled && t->step <= p->tick / RP_SETTLED) { /* until then aims seek the phase, and show nothing of the period */
        t->settled = 1;
        t->count = 0;
        t->block = 8;
        t->sum = 0;
    } else if (t->settled) {
        t->sum += by;
        if (++t->count >= t->block) {
            t->period += t->sum / t->count;
            t->aim += t->sum / t->count;
            if (t->period <= p->tick / 2)
                t->period = p->tick / 2 + 1;
            t->block = t->block < RP_BLOCK ? 2 * t->block : RP_BLOCK;
            t->count = 0;
            t->sum = 0;
        }
    }
}

static inline void rp_join(rp_predictor *p, rp_stream *s, int64_t period)
{
    rp_task *t, *unused = NULL;
    for (t = p->tasks; t < p->tasks + RP_TASKS; t++) {
        int64_t off = t->period - period, expected = t->aim - p->planned > t->period / 2 ? t->aim - t->period : t->aim;
        if (!t->members)
            unused = unused ? unused : t;
        else if ((off < 0 ? -off : off) <= p->tick / RP_STEP && expected >= p->before - p->tick / RP_STEP
                 && expected <= p->now + p->tick / RP_STEP)
            break;
    }
    if (t == p->tasks + RP_TASKS) {
        if (!unused)
            return;
        t = unused;
        memset(t, 0, sizeof *t);
        t->period = period;
        t->aim = p->planned + period;
        t->step = p->tick / RP_STEP;
        t->round = 1;
    }
    t->members++;
    s->task = (uint8_t)(t - p->tasks + 1);
    s->round = t->aim > p->now ? t->round - 1 : t->round;
    s->silent = 0;
    if (s->round == t->round) {
        t->arrived++;
        t->last = p->planned;
    }
}

/* A publication of a stream without a task: does its period show? */
static inline void rp_learn(rp_predictor *p, rp_stream *s, uint32_t more)
{
    int64_t jitter = p->tick / RP_JITTER, low, high;
    if (s->count && more && more <= 8 && s->count < 4 * RP_FINDS) {
        s->count += more;
        low = (p->before - s->high - jitter) / (s->count - 1);
        high = (p->now - s->low + jitter) / (s->count - 1);
        s->shortest = low > s->shortest ? low : s->shortest;
        s->longest = high < s->longest ? high : s->longest;
        if (s->shortest <= s->longest) {
            low = (s->shortest + s->longest) / 2;
            if (s->count > RP_FINDS && low >= p->tick * 3 / 4 && low <= INT64_C(1000000000))
                rp_join(p, s, low);
            return;
        }
    }
    s->count = 1;
    s->low = p->before;
    s->high = p->now;
    s->shortest = 0;
    s->longest = INT64_MAX;
}

static inline void rp_news(rp_predictor *p, uint32_t index, uint32_t head)
{
    rp_stream *s = &p->streams[index];
    uint32_t more = head - s->head;
    rp_task *t = s->task ? &p->tasks[s->task - 1] : NULL;
    if (!more)
        return;
    s->head = head;
    if (!t) {
        p->strange = p->now;
        if (!p->pause)
            rp_learn(p, s, more);
        return;
    }
    if (p->planned < t->aim - t->period / 2) { /* of the round before */
        if (t->late)
            rp_move(p, t, 1, t->step + RP_UP * (p->tick / RP_FINEST));
        t->late = 0;
    } else if (s->round != t->round) {
        s->round = t->round;
        t->arrived++;
        t->last = p->planned;
    } else {
        p->strange = p->now;
        s->silent += 2; /* twice in a period */
        if (s->silent >= RP_SILENT)
            rp_leave(p, s);
        return;
    }
    s->silent = 0;
}

/* The look at which a task's publication was expected is over. */
static inline void rp_judge(rp_predictor *p, rp_task *t)
{
    int64_t early = t->aim - t->last;
    int in_time = p->planned - t->aim <= p->tick / RP_SLACK;
    t->late = t->arrived < t->members;
    if (t->late) {
        p->again = p->planned + p->tick / RP_STEP;
        for (uint32_t i = 0; i < p->count; i++) {
            rp_stream *s = &p->streams[i];
            if (s->task == t - p->tasks + 1 && s->round != t->round && ++s->silent >= RP_SILENT)
                rp_leave(p, s);
        }
    }
    t->arrived = 0;
    t->round++;
    t->aim += t->period;
    if (t->late)
        return;
    if (early > p->tick / RP_STEP) { /* another look has found everything long before */
        if (!t->settled) {
            t->aim -= early;
            return;
        }
        t->run = RP_RUN - 1;
    } else if (!in_time) {
        return; /* a look that came later than wanted shows nothing */
    }
    rp_move(p, t, 0, -t->step);
}

static inline int64_t rp_next(rp_predictor *p, int64_t longest)
{
    int64_t grid = p->planned + p->tick, slack = p->tick / RP_SLACK, due = INT64_MAX;
    int calm = longest > p->tick && p->now - p->strange > RP_CALM * p->tick;
    for (rp_task *t = p->tasks; t < p->tasks + RP_TASKS; t++) {
        if (!t->members)
            continue;
        if (t->aim <= p->planned)
            rp_judge(p, t);
        if (t->aim + t->period / 2 < p->now) { /* nobody has looked for long */
            t->aim += (p->now - t->aim) / t->period * t->period + t->period;
            t->round++;
            t->arrived = 0;
            t->late = 0;
        }
    }
    for (rp_task *t = p->tasks; t < p->tasks + RP_TASKS; t++) {
        if (t->members && t->aim < due)
            due = t->aim;
        calm = calm && !(t->members && t->late);
    }
    for (rp_task *t = p->tasks; t < p->tasks + RP_TASKS; t++) /* those that nearly coincide share a look */
        if (t->members && t->aim > due && t->aim <= due + slack)
            due = t->aim;
    if (p->again && p->again < due - slack)
        due = p->again;
    p->early = due < grid ? grid - due : 0;
    if (calm && grid < p->planned + longest - slack)
        grid = p->planned + longest - slack;
    p->due = due > grid + slack ? grid : due;
    return p->due;
}

#endif
