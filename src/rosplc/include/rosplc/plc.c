/* The blocks of plc.h. Compile it with the program, as C11 or C++17. */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE /* O_CLOEXEC, getrandom: a strict -std hides them */
#endif
#include <rosplc/plc.h>

#include <sys/random.h>

#include <rosplc/posix.h>

#define FIRST_BACK_OFF_MS 10u
#define LONGEST_BACK_OFF_MS 2000u
#define REOPEN_AFTER_MS 1000u /* a peer silent for so long: another object may be at the name */
#define LEFT_BEHIND_MS 1000u  /* a caller inside for so long was ended by a fault, and never comes out */
#define UNKNOWN_BEAT_MS 1000u
#define DIRECTORY "/dev/shm/"

/* ---- names */

static int is_letter(char c)
{
    return (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z');
}

static int is_digit(char c)
{
    return c >= '0' && c <= '9';
}

static int name_is_valid(const char *prefix, const char *topic)
{
    size_t length = 0;
    char before = '/';
    for (; prefix[length]; length++) {
        char c = prefix[length];
        if (!is_letter(c) && (length == 0 || !(is_digit(c) || c == '_' || c == '-')))
            return 0;
    }
    if (length < 1 || length > 32 || *topic != '/')
        return 0;
    for (topic++; *topic; before = *topic++) {
        if (before == '/' ? !is_letter(*topic) && *topic != '_'
                          : !is_letter(*topic) && !is_digit(*topic) && *topic != '_' && *topic != '/')
            return 0;
    }
    return before != '/';
}

rosplc_error rosplc_plc_name(char name[ROSPLC_MAX_NAME + 1], const char *prefix, const char *topic)
{
    const char *parts[3];
    uint32_t hash = ROSPLC_FNV_OFFSET;
    size_t length = 0;
    if (!prefix || !topic || !name_is_valid(prefix, topic))
        return ROSPLC_ERROR_NAME;
    parts[0] = prefix;
    parts[1] = ".t.";
    parts[2] = topic + 1;
    for (int part = 0; part < 3; part++) {
        for (const char *from = parts[part]; *from; from++) {
            char c = *from == '/' ? '.' : *from;
            hash = (hash ^ (uint8_t)c) * ROSPLC_FNV_PRIME;
            if (length < ROSPLC_MAX_NAME)
                name[length] = c;
            length++;
        }
    }
    if (length > ROSPLC_MAX_NAME) {
        name[ROSPLC_NAME_KEPT] = '~';
        for (int digit = 0; digit < 8; digit++)
            name[ROSPLC_NAME_KEPT + 1 + (size_t)digit] = "0123456789abcdef"[hash >> (28 - 4 * digit) & 15u];
        length = ROSPLC_NAME_KEPT + 9;
    }
    name[length] = '\0';
    return ROSPLC_OK;
}

/* ---- what both blocks do */

static void init(rosplc_plc_channel *c, const char *prefix, const char *topic, uint32_t layout_lo, uint32_t layout_hi,
                 uint32_t record_size)
{
    c->prefix = prefix;
    c->topic = topic;
    c->layout_lo = layout_lo;
    c->layout_hi = layout_hi;
    c->record_size = record_size;
    c->beat_ms = UNKNOWN_BEAT_MS;
    c->back_off = FIRST_BACK_OFF_MS;
}

/* Takes the time and finds a second caller. 0: another task is inside. A caller that a fault has taken out of the block
 * (siglongjmp) is replaced after a while. */
static int enter(rosplc_plc_channel *c, uint32_t now_ms)
{
    if (__atomic_exchange_n(&c->inside, 1, __ATOMIC_ACQUIRE)
        && now_ms - __atomic_load_n(&c->entered, __ATOMIC_RELAXED) < LEFT_BEHIND_MS) {
        __atomic_fetch_add(&c->reentries, 1, __ATOMIC_RELAXED);
        __atomic_store_n(&c->error, (uint32_t)ROSPLC_ERROR_REENTERED, __ATOMIC_RELAXED);
        return 0;
    }
    __atomic_store_n(&c->entered, now_ms, __ATOMIC_RELAXED);
    c->elapsed = c->clock_runs ? now_ms - c->now : 0;
    c->now = now_ms;
    c->clock_runs = 1;
    c->opened = 0;
    if (c->error == ROSPLC_ERROR_REENTERED)
        c->error = ROSPLC_OK;
    return 1;
}

static void leave(rosplc_plc_channel *c)
{
    __atomic_store_n(&c->inside, 0, __ATOMIC_RELEASE);
}

static void postpone(rosplc_plc_channel *c)
{
    c->waiting = 1;
    c->retry_at = c->now + c->back_off;
    c->back_off = c->back_off * 2 < LONGEST_BACK_OFF_MS ? c->back_off * 2 : LONGEST_BACK_OFF_MS;
}

/* A number for a claim: not 0, and not one that another block draws. */
static uint32_t draw(rosplc_plc_channel *c)
{
    const uint32_t words[3] = {c->now, c->generation, (uint32_t)(uintptr_t)c};
    for (int i = 0; i < 3; i++)
        c->seed = (c->seed ^ words[i]) * ROSPLC_FNV_PRIME;
    return c->seed ? c->seed : 1;
}

static void unmap(rosplc_plc_channel *c)
{
    if (c->attached)
        rosplc_close(&c->region);
    c->attached = 0;
    c->peer_alive = 0;
}

static rosplc_error open_object(rosplc_plc_channel *c, uint32_t direction)
{
    char path[sizeof DIRECTORY + ROSPLC_MAX_NAME];
    rosplc_error error;
    memcpy(path, DIRECTORY, sizeof DIRECTORY);
    error = rosplc_plc_name(path + sizeof DIRECTORY - 1, c->prefix, c->topic);
    if (error == ROSPLC_OK)
        error = rosplc_open(&c->region, path, 1, direction, c->layout_lo, c->layout_hi, c->record_size);
    if (error == ROSPLC_ERROR_LAYOUT) {
        c->found_layout_lo = c->region.geometry.layout_lo;
        c->found_layout_hi = c->region.geometry.layout_hi;
    }
    return error;
}

/* 1: the object is open, live and of the expected layout. Before any access, at every call. `release` gives claims
 * back before the mapping goes. */
static int attach(rosplc_plc_channel *c, uint32_t direction, void (*release)(rosplc_plc_channel *))
{
    rosplc_error error;
    uint32_t generation;
    if (c->attached) {
        error = rosplc_region_check(&c->region);
        if (error == ROSPLC_OK
            && rosplc_load(&c->region.header->identity.generation) != c->region.geometry.generation)
            error = ROSPLC_ERROR_IDENTITY;
        if (error == ROSPLC_OK)
            return 1;
        release(c);
        unmap(c);
        c->error = error;
        c->back_off = FIRST_BACK_OFF_MS; /* its successor is opened soon */
        postpone(c);
        return 0;
    }
    if (c->waiting && c->now - c->retry_at >= ROSPLC_DISCONTINUITY)
        return 0;
    if (c->may_open && !*c->may_open)
        return 0;
    if (c->may_open)
        *c->may_open = 0;
    error = open_object(c, direction);
    if (error != ROSPLC_OK) {
        c->error = error;
        postpone(c);
        return 0;
    }
    generation = c->region.geometry.generation;
    c->attached = c->opened = 1;
    c->opened_another = generation != c->generation;
    c->generation = generation;
    /* The object of a silent bridge is opened again and again; the bridge is silent until it beats. */
    if (c->opened_another || c->error != ROSPLC_ERROR_PEER_SILENT)
        c->error = ROSPLC_OK;
    c->back_off = FIRST_BACK_OFF_MS;
    c->waiting = 0;
    c->silent = c->peer_beat = c->peer_head = 0;
    c->other_claim = c->other_beat = c->other_head = c->other_silent = 0;
    if (getrandom(&c->seed, sizeof c->seed, GRND_NONBLOCK) != (ssize_t)sizeof c->seed)
        c->seed ^= (uint32_t)(uintptr_t)c->region.header;
    return 1;
}

/* Watches the bridge's beat by the block's own clock (M21); 0: silent for so long that the channel was closed. */
static int watch(rosplc_plc_channel *c, uint32_t beat, uint32_t head, uint32_t beat_ms,
                 void (*release)(rosplc_plc_channel *))
{
    uint32_t limit = rosplc_silence_ms(beat_ms);
    if (beat != c->peer_beat || head != c->peer_head) {
        c->peer_alive = c->peer_beat != 0; /* the first value seen is no sign of life yet */
        c->silent = 0;
        c->peer_beat = beat;
        c->peer_head = head;
    } else {
        c->silent += c->elapsed;
    }
    if (c->silent > limit) {
        c->peer_alive = 0;
        if (c->error == ROSPLC_OK)
            c->error = ROSPLC_ERROR_PEER_SILENT;
        if (c->silent > limit + REOPEN_AFTER_MS) {
            release(c);
            unmap(c);
            postpone(c);
            return 0;
        }
    } else if (c->peer_alive && c->error == ROSPLC_ERROR_PEER_SILENT) {
        c->error = ROSPLC_OK;
    }
    return 1;
}

/* Watches another's claim (M6, M9): how many ms its holder may still be silent; 0: it may be replaced. */
static uint32_t others_time(rosplc_plc_channel *c, uint32_t claim, uint32_t beat, uint32_t head, uint32_t beat_ms)
{
    uint32_t limit = rosplc_silence_ms(beat_ms);
    if (claim != c->other_claim || beat != c->other_beat || head != c->other_head) {
        c->other_claim = claim;
        c->other_beat = beat;
        c->other_head = head;
        c->other_silent = 0;
        return limit + 1;
    }
    c->other_silent += c->elapsed;
    return c->other_silent > limit ? 0 : limit - c->other_silent + 1;
}

/* ---- the reader */

void rosplc_plc_reader_init(rosplc_plc_reader *r, const char *prefix, const char *topic, uint32_t layout_lo,
                            uint32_t layout_hi, uint32_t record_size, void *record)
{
    memset((void *)r, 0, sizeof *r);
    init(&r->channel, prefix, topic, layout_lo, layout_hi, record_size);
    r->record = record;
    r->max_per_scan = 8;
    r->sources = ROSPLC_UNKNOWN;
}

static void release_reader(rosplc_plc_channel *c)
{
    rosplc_plc_reader *r = (rosplc_plc_reader *)(void *)c; /* its first member */
    if (c->attached)
        rosplc_reader_release(&r->reader);
}

/* The same object opened again: what came in between is still new. Another: only its state is shown (M14). */
static void begin_object(rosplc_plc_reader *r)
{
    rosplc_plc_channel *c = &r->channel;
    if (c->opened_another) {
        uint32_t last = r->latched ? 0 : rosplc_load(&c->region.header->writer.head);
        uint32_t lost = r->reader.lost, retries = r->reader.retries, discontinuities = r->reader.discontinuities;
        rosplc_reader_observe(&r->reader, &c->region, last);
        r->reader.lost = lost;
        r->reader.retries = retries;
        r->reader.discontinuities = discontinuities;
        r->show = last != 0;
    }
}

/* Claims a line, for those that ask who reads; reading does not depend on it (M9). */
static void claim_line(rosplc_plc_reader *r)
{
    rosplc_plc_channel *c = &r->channel;
    rosplc_reader_line *line;
    uint32_t claim;
    if (rosplc_reader_owned(&r->reader))
        return;
    for (uint32_t i = 0; c->opened && i < ROSPLC_READER_LINES; i++) {
        if (rosplc_load(&c->region.header->reader[i].claim) == 0
            && rosplc_reader_claim(&r->reader, i, 0, draw(c), c->beat_ms, 0) == ROSPLC_OK)
            return;
    }
    /* None was free: one is watched at a time; if its holder lives, the next one is. */
    line = &c->region.header->reader[r->watched];
    claim = rosplc_load(&line->claim);
    if (claim != c->other_claim || rosplc_load(&line->beat) != c->other_beat) {
        r->watched = (r->watched + 1) % ROSPLC_READER_LINES;
        line = &c->region.header->reader[r->watched];
        (void)others_time(c, rosplc_load(&line->claim), rosplc_load(&line->beat), 0, 0);
    } else if (others_time(c, claim, c->other_beat, 0, rosplc_load(&line->beat_ms)) == 0 || claim == 0) {
        (void)rosplc_reader_claim(&r->reader, r->watched, claim, draw(c), c->beat_ms, 0);
    }
}

static int take(rosplc_plc_reader *r)
{
    rosplc_plc_channel *c = &r->channel;
    rosplc_take t;
    uint32_t epoch;
    int show;
    if (r->show && rosplc_load(&c->region.header->writer.head) != r->reader.last)
        r->show = 0; /* a new message has come, with more than the state before */
    show = r->show;
    t = rosplc_take_start(show ? ROSPLC_TAKE_PEEK : r->in_order ? ROSPLC_TAKE_NEXT : ROSPLC_TAKE_NEWEST);
    if (!rosplc_take_record(&r->reader, &t, r->record))
        return 0;
    r->valid = 1;
    r->show = 0;
    r->sequence = t.sequence;
    r->stamp_lo = t.stamp_lo;
    r->stamp_hi = t.stamp_hi;
    r->first = (t.flags & ROSPLC_FLAG_FIRST) != 0;
    r->truncated = (t.flags & ROSPLC_FLAG_TRUNCATED) != 0;
    r->substituted = (t.flags & ROSPLC_FLAG_SUBSTITUTED) != 0;
    if (show)
        return 1;
    /* The mark may be on a skipped message; a change of the claim and the silence are seen nevertheless. */
    epoch = rosplc_load(&c->region.header->writer.writer_epoch);
    r->recovered = r->first || r->stale || !r->ever_new || (epoch && epoch != r->writer);
    if (epoch)
        r->writer = epoch;
    r->is_new = r->ever_new = 1;
    r->age_ms = 0;
    r->taken++;
    return 1;
}

/* Ends a call: age, staleness, beat; `got` as take() returned it. */
static int end_read(rosplc_plc_reader *r, int got)
{
    rosplc_plc_channel *c = &r->channel;
    rosplc_reader_line *line = c->attached ? rosplc_reader_owned(&r->reader) : NULL;
    if (r->taken == 0)
        r->age_ms = r->age_ms + c->elapsed < r->age_ms ? 0xFFFFFFFFu : r->age_ms + c->elapsed;
    r->stale = r->stale_after_ms && (r->age_ms > r->stale_after_ms || !r->ever_new);
    r->lost = r->reader.lost;
    r->retries = r->reader.retries;
    r->discontinuities = r->reader.discontinuities;
    if (line) {
        rosplc_store(&line->beat, rosplc_load(&line->beat) + 1);
        rosplc_store(&line->taken, r->reader.last);
        rosplc_store(&line->lost, r->lost);
    }
    /* At every scan, so that a state found at the start does not show. */
    if (r->stale && (r->on_stale == ROSPLC_PLC_ZERO || (r->on_stale == ROSPLC_PLC_SAFE && r->safe))) {
        if (r->on_stale == ROSPLC_PLC_ZERO)
            memset(r->record, 0, c->record_size);
        else
            memcpy(r->record, r->safe, c->record_size);
        r->substituted = 1;
        got = 1;
    }
    leave(c);
    return got;
}

int rosplc_plc_read(rosplc_plc_reader *r, uint32_t now_ms)
{
    rosplc_plc_channel *c = &r->channel;
    rosplc_writer_line *writer;
    int got = 0;
    r->is_new = 0;
    if (!enter(c, now_ms))
        return 0;
    r->recovered = r->source_present = 0;
    r->taken = 0;
    r->sources = ROSPLC_UNKNOWN;
    if (attach(c, ROSPLC_TO_PLC, release_reader)) {
        if (c->opened)
            begin_object(r);
        writer = &c->region.header->writer;
        if (watch(c, rosplc_load(&writer->writer_beat), rosplc_load(&writer->head),
                  rosplc_load(&writer->writer_beat_ms), release_reader)) {
            claim_line(r);
            if (c->peer_alive) /* what a dead bridge knew last tells nothing about now */
                r->sources = rosplc_load(&writer->sources);
            r->source_present = r->sources != 0 && r->sources != ROSPLC_UNKNOWN;
            got = take(r);
        }
    }
    return end_read(r, got);
}

int rosplc_plc_next(rosplc_plc_reader *r, uint32_t now_ms)
{
    rosplc_plc_channel *c = &r->channel;
    int got = 0;
    if (!enter(c, now_ms))
        return 0;
    c->silent += c->elapsed; /* a call that watches no beat must not swallow its time */
    if (r->in_order && c->attached && r->taken < r->max_per_scan) {
        r->is_new = r->recovered = 0;
        got = rosplc_region_check(&c->region) == ROSPLC_OK && take(r);
    }
    return end_read(r, got) && got;
}

void rosplc_plc_reader_close(rosplc_plc_reader *r)
{
    release_reader(&r->channel);
    unmap(&r->channel);
    r->channel.clock_runs = r->channel.waiting = 0;
}

/* ---- the writer */

void rosplc_plc_writer_init(rosplc_plc_writer *w, const char *prefix, const char *topic, uint32_t layout_lo,
                            uint32_t layout_hi, uint32_t record_size)
{
    memset((void *)w, 0, sizeof *w);
    init(&w->channel, prefix, topic, layout_lo, layout_hi, record_size);
    w->sinks = ROSPLC_UNKNOWN;
}

static void release_writer(rosplc_plc_channel *c)
{
    rosplc_plc_writer *w = (rosplc_plc_writer *)(void *)c; /* its first member */
    if (c->attached && w->ready)
        rosplc_writer_release(&w->writer);
    w->ready = 0;
}

/* One writer, claimed (M6). */
static int claim(rosplc_plc_writer *w)
{
    rosplc_plc_channel *c = &w->channel;
    rosplc_writer_line *line = &c->region.header->writer;
    uint32_t holder = rosplc_load(&line->writer_epoch), left;
    if (w->ready) {
        if (holder == w->writer.epoch)
            return 1;
        w->ready = 0;
        c->error = ROSPLC_ERROR_CLAIM_LOST;
        c->other_silent = 0;
        return 0;
    }
    if (holder) {
        if (c->error == ROSPLC_OK)
            c->error = ROSPLC_ERROR_CLAIMED;
        left = others_time(c, holder, rosplc_load(&line->writer_beat), rosplc_load(&line->head),
                           rosplc_load(&line->writer_beat_ms));
        w->takeover_ms = left ? left - 1 : 0;
        if (left)
            return 0;
    }
    w->ready = rosplc_writer_claim(&w->writer, &c->region, holder, draw(c), c->beat_ms, 0) == ROSPLC_OK;
    if (w->ready && (c->error == ROSPLC_ERROR_CLAIMED || c->error == ROSPLC_ERROR_CLAIM_LOST))
        c->error = ROSPLC_OK;
    if (w->ready)
        w->takeover_ms = 0;
    return w->ready;
}

void *rosplc_plc_write_begin(rosplc_plc_writer *w, uint32_t now_ms, int enable)
{
    rosplc_plc_channel *c = &w->channel;
    rosplc_reader_line *bridge;
    rosplc_error error;
    w->published = 0;
    w->slot = NULL;
    if (!enter(c, now_ms))
        return NULL;
    w->sinks = ROSPLC_UNKNOWN;
    w->takeover_ms = 0;
    if (attach(c, ROSPLC_TO_ROS, release_writer)) {
        bridge = &c->region.header->reader[0];
        w->taken = rosplc_load(&bridge->taken);
        if (watch(c, rosplc_load(&bridge->beat), w->taken, rosplc_load(&bridge->beat_ms), release_writer)) {
            if (c->peer_alive)
                w->sinks = rosplc_load(&bridge->sinks);
            if (claim(w) && enable) {
                w->slot = rosplc_writer_begin(&w->writer, &error);
                if (!w->slot)
                    c->error = error;
            }
        }
    }
    if (enable && !w->slot)
        w->unsent++;
    if (!w->slot) {
        if (c->attached && w->ready)
            rosplc_writer_beat(&w->writer);
        leave(c);
        return NULL;
    }
    return rosplc_record(w->slot);
}

void rosplc_plc_write_end(rosplc_plc_writer *w)
{
    rosplc_meta meta;
    if (!w->slot)
        return;
    memset(&meta, 0, sizeof meta);
    meta.stamp_lo = w->stamp_lo;
    meta.stamp_hi = w->stamp_hi;
    meta.stamp_clock = w->stamp_lo || w->stamp_hi ? ROSPLC_STAMP_PLC : ROSPLC_STAMP_NONE;
    w->sequence = rosplc_writer_commit(&w->writer, w->slot, &meta);
    w->slot = NULL;
    w->count++;
    w->published = 1;
    leave(&w->channel);
}

int rosplc_plc_write(rosplc_plc_writer *w, uint32_t now_ms, int enable, const void *record)
{
    void *place = rosplc_plc_write_begin(w, now_ms, enable);
    if (place)
        ROSPLC_COPY_RECORD(place, record, w->channel.record_size);
    rosplc_plc_write_end(w);
    return w->published;
}

void rosplc_plc_writer_close(rosplc_plc_writer *w)
{
    release_writer(&w->channel);
    unmap(&w->channel);
    w->channel.clock_runs = w->channel.waiting = 0;
}
