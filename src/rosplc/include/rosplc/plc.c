/* The blocks of plc.h. Compile it with the program, as C11 or C++17. */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE /* O_CLOEXEC, getrandom: a strict -std hides them */
#endif
#include <rosplc/plc.h>

#include <sys/random.h>

#include <rosplc/posix.h>

#define FIRST_BACK_OFF_MS 10u
#define LONGEST_BACK_OFF_MS 2000u
#define REOPEN_AFTER_MS 1000u /* if a peer is silent this long, another object may have its name */
#define LEFT_BEHIND_MS 1000u  /* a caller inside this long was ended by a fault, and never leaves */
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

static int name_is_valid(const char *prefix, const char *topic, const char *client)
{
    const char *const words[2] = {prefix, client};
    char before = '/';
    for (int i = 0; i < 2; i++) {
        size_t length = 0;
        for (const char *word = words[i]; word[length]; length++) {
            char c = word[length];
            if (!is_letter(c) && (length == 0 || !(is_digit(c) || c == '_' || (c == '-' && word == prefix))))
                return 0;
        }
        if (length > 32)
            return 0;
    }
    if (!*prefix || *topic != '/')
        return 0;
    for (topic++; *topic; before = *topic++) {
        if (before == '/' ? !is_letter(*topic) && *topic != '_'
                          : !is_letter(*topic) && !is_digit(*topic) && *topic != '_' && *topic != '/')
            return 0;
    }
    return before != '/';
}

static const char *letters(uint32_t kind)
{
    switch (kind) {
    case ROSPLC_KIND_REQUEST:
        return ".sq.";
    case ROSPLC_KIND_RESPONSE:
        return ".sr.";
    case ROSPLC_KIND_GOAL:
        return ".ag.";
    case ROSPLC_KIND_RESULT:
        return ".ar.";
    case ROSPLC_KIND_FEEDBACK:
        return ".af.";
    default:
        return ".t.";
    }
}

static rosplc_error object_name(char *name, const char *prefix, uint32_t kind, const char *topic, const char *client)
{
    const char *parts[5];
    uint32_t hash = ROSPLC_FNV_OFFSET;
    size_t length = 0;
    if (!prefix || !topic || !client || !name_is_valid(prefix, topic, client))
        return ROSPLC_ERROR_NAME;
    parts[0] = prefix;
    parts[1] = letters(kind);
    parts[2] = topic + 1;
    parts[3] = *client ? "-" : "";
    parts[4] = client;
    for (int part = 0; part < 5; part++) {
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

rosplc_error rosplc_plc_name(char name[ROSPLC_MAX_NAME + 1], const char *prefix, const char *topic)
{
    return object_name(name, prefix, ROSPLC_KIND_TOPIC, topic, "");
}

/* ---- all blocks */

static void init(rosplc_plc_channel *c, const char *prefix, const char *topic, uint32_t layout_lo, uint32_t layout_hi,
                 uint32_t record_size)
{
    c->prefix = prefix;
    c->topic = topic;
    c->client = "";
    c->kind = ROSPLC_KIND_TOPIC;
    c->layout_lo = layout_lo;
    c->layout_hi = layout_hi;
    c->record_size = record_size;
    c->beat_ms = UNKNOWN_BEAT_MS;
    c->back_off = FIRST_BACK_OFF_MS;
}

/* Stores the time and detects a second caller. 0: another task is inside. A caller that a fault has taken out of the
 * block (siglongjmp) is ignored after LEFT_BEHIND_MS. */
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

/* A number for a claim: nonzero, and different from those of other blocks. */
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
    error = object_name(path + sizeof DIRECTORY - 1, c->prefix, c->kind, c->topic, c->client);
    if (error == ROSPLC_OK)
        error = rosplc_open_kind(&c->region, path, 1, c->kind, direction, c->layout_lo, c->layout_hi, c->record_size);
    if (error == ROSPLC_ERROR_LAYOUT) {
        c->found_layout_lo = c->region.geometry.layout_lo;
        c->found_layout_hi = c->region.geometry.layout_hi;
    }
    return error;
}

/* 1: the object is open, live and of the expected layout. Called before any access, in every call. `release` releases
 * claims before the object is unmapped. */
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
        c->back_off = FIRST_BACK_OFF_MS; /* try to open its successor soon */
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
    /* A silent bridge's object is opened repeatedly; the bridge counts as silent until it beats. */
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
        c->peer_alive = c->peer_beat != 0; /* the first value seen is not yet a sign of life */
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

/* Watches another program's claim (M6, M9). Returns how many ms it may still be silent; 0: it may be replaced. */
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

/* After reopening the same object, messages published meanwhile are new. Of another, only the state is shown (M14). */
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

/* Whether an object's messages are acted on: those of requests and goals are. */
static int acts(const rosplc_plc_channel *c)
{
    return c->kind == ROSPLC_KIND_REQUEST || c->kind == ROSPLC_KIND_GOAL;
}

static int claim_this(rosplc_plc_reader *r, uint32_t index, uint32_t expected)
{
    rosplc_plc_channel *c = &r->channel;
    r->begun = 0;
    if (acts(c))
        return rosplc_answerer_claim(&r->reader, expected, draw(c), c->beat_ms, 0) == ROSPLC_OK;
    return rosplc_reader_claim(&r->reader, index, expected, draw(c), c->beat_ms, 0) == ROSPLC_OK;
}

/* Claims a line, to show who reads; reading a topic does not depend on it (M9). Other kinds use only line 0. */
static void claim_line(rosplc_plc_reader *r)
{
    rosplc_plc_channel *c = &r->channel;
    uint32_t lines = c->kind == ROSPLC_KIND_TOPIC ? ROSPLC_READER_LINES : 1, claim;
    rosplc_reader_line *line;
    if (rosplc_reader_owned(&r->reader))
        return;
    for (uint32_t i = 0; c->opened && i < lines; i++) {
        if (rosplc_load(&c->region.header->reader[i].claim) == 0 && claim_this(r, i, 0))
            return;
    }
    /* None was free. Watch one at a time; if its holder is alive, watch the next. */
    line = &c->region.header->reader[r->watched];
    claim = rosplc_load(&line->claim);
    if (claim != c->other_claim || rosplc_load(&line->beat) != c->other_beat) {
        r->watched = (r->watched + 1) % lines;
        line = &c->region.header->reader[r->watched];
        (void)others_time(c, rosplc_load(&line->claim), rosplc_load(&line->beat), 0, 0);
    } else if (others_time(c, claim, c->other_beat, 0, rosplc_load(&line->beat_ms)) == 0 || claim == 0) {
        (void)claim_this(r, r->watched, claim);
    }
}

static int same(const rosplc_plc_call *one, const rosplc_plc_call *other)
{
    return one->number == other->number && one->caller == other->caller;
}

static int take(rosplc_plc_reader *r)
{
    rosplc_plc_channel *c = &r->channel;
    rosplc_reader_line *line = rosplc_reader_owned(&r->reader);
    rosplc_take t;
    uint32_t epoch;
    int show, got;
    if (c->kind != ROSPLC_KIND_TOPIC && !line)
        return 0;
    if (r->show && rosplc_load(&c->region.header->writer.head) != r->reader.last)
        r->show = 0; /* a new message replaces the earlier state */
    show = r->show;
    t = rosplc_take_start(show ? ROSPLC_TAKE_PEEK : r->in_order ? ROSPLC_TAKE_NEXT : ROSPLC_TAKE_NEWEST);
    if (acts(c))
        r->reader.line = NULL; /* begin() stores `taken` */
    got = rosplc_take_record(&r->reader, &t, r->record);
    r->reader.line = line;
    if (!got)
        return 0;
    r->call.status = t.status;
    r->call.number = t.correlation_lo;
    r->call.caller = t.correlation_hi;
    memcpy(r->call.client, t.client, sizeof t.client);
    r->call.reason = t.reason;
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
    /* The mark may be on a skipped message; a changed claim and silence are detected nevertheless. */
    epoch = rosplc_load(&c->region.header->writer.writer_epoch);
    r->recovered = r->first || r->stale || !r->ever_new || (epoch && epoch != r->writer);
    if (epoch)
        r->writer = epoch;
    r->is_new = r->ever_new = 1;
    r->age_ms = 0;
    r->taken++;
    return 1;
}

/* Ends a call: age, staleness, beat; `got` is the result of take(). */
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
        if (!acts(c) || (r->begun && same(&r->call, &r->begun_call)))
            rosplc_store(&line->taken, r->reader.last);
        rosplc_store(&line->lost, r->lost);
    }
    /* In every scan, so that a state found at the start is not shown. */
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
            if (c->kind != ROSPLC_KIND_TOPIC && !rosplc_reader_owned(&r->reader) && c->error == ROSPLC_OK)
                c->error = ROSPLC_ERROR_CLAIMED;
            else if (c->error == ROSPLC_ERROR_CLAIMED && rosplc_reader_owned(&r->reader))
                c->error = ROSPLC_OK;
            if (c->peer_alive) /* a dead bridge's last count is out of date */
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
    c->silent += c->elapsed; /* this call does not watch the beat, but its time counts */
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

/* Whether the bridge has taken a message of the newest call (M26). Once set, `begun` stays set. */
static void look(rosplc_plc_writer *w)
{
    if (w->channel.attached && w->first && !w->begun)
        w->begun = rosplc_call_begun(&w->writer, w->first);
}

static void release_writer(rosplc_plc_channel *c)
{
    rosplc_plc_writer *w = (rosplc_plc_writer *)(void *)c; /* its first member */
    look(w);
    if (c->attached && w->ready)
        rosplc_writer_release(&w->writer);
    w->ready = 0;
}

/* Claims the channel: one writer at a time (M6). */
static int claim(rosplc_plc_writer *w)
{
    rosplc_plc_channel *c = &w->channel;
    rosplc_writer_line *line = &c->region.header->writer;
    uint32_t holder = rosplc_load(&line->writer_epoch), left;
    if (w->ready) {
        if (holder == w->writer.epoch)
            return 1;
        w->ready = 0;
        w->epoch = 0;
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
    if (c->kind == ROSPLC_KIND_TOPIC || holder || !w->epoch) /* else keep it: open calls refer to it */
        w->epoch = draw(c);
    w->ready = rosplc_writer_claim(&w->writer, &c->region, holder, w->epoch, c->beat_ms, 0) == ROSPLC_OK;
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
            /* A call's message may have been prepared for another object than the one just opened. */
            if (claim(w) && enable && !(c->opened && c->kind != ROSPLC_KIND_TOPIC)) {
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
    meta.status = w->call.status; /* all 0 for topics */
    meta.correlation_lo = w->call.number;
    meta.correlation_hi = w->call.caller;
    memcpy(meta.client, w->call.client, sizeof meta.client);
    meta.reason = w->call.reason;
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

/* ---- clients and servers: the rules of RosPlc_Caller, RosPlc_Answerer and the other generated blocks */

static int ready(rosplc_plc_reader *r)
{
    return r->channel.attached && rosplc_reader_owned(&r->reader) != NULL;
}

/* Stores `taken`. Returns whether the last call read may be acted on: it is still the newest (M26). */
static int begin(rosplc_plc_reader *r)
{
    if (!ready(r))
        return 0;
    if (r->begun != r->sequence) {
        r->begun = r->sequence;
        r->begun_call = r->call;
        rosplc_store(&r->channel.region.header->reader[0].taken, r->sequence);
    }
    return rosplc_call_begin(&r->reader);
}

/* Calls the writer once per scan; if `say` is NULL, nothing is sent. */
static void transmit(rosplc_plc_writer *w, uint32_t now_ms, const rosplc_plc_call *say, const void *record)
{
    rosplc_plc_channel *c = &w->channel;
    if (say)
        w->call = *say;
    (void)rosplc_plc_write(w, now_ms, say != NULL, record);
    if (c->opened && c->opened_another)
        w->first = 0;
    if (w->published && (!same(&w->first_call, say) || !w->first)) {
        w->first_call = *say;
        w->first = w->sequence;
        w->begun = 0;
    }
    look(w);
    w->held = c->attached && rosplc_load(&c->region.header->reader[0].claim) != 0;
}

static void prepare(int *send, rosplc_plc_call *say, const rosplc_plc_call *call, uint32_t status, uint32_t reason)
{
    *say = *call;
    say->status = status;
    say->reason = reason;
    *send = 1;
}

static void share(rosplc_plc_channel *part, const rosplc_plc_channel *block)
{
    part->beat_ms = block->beat_ms;
    part->may_open = block->may_open;
}

static uint32_t first_of(uint32_t one, uint32_t other)
{
    return one ? one : other;
}

static void reader_part(rosplc_plc_reader *r, const char *prefix, const char *name, const char *client, uint32_t kind,
                        const rosplc_plc_part *part)
{
    rosplc_plc_reader_init(r, prefix, name, part->layout_lo, part->layout_hi, part->record_size, part->record);
    r->channel.kind = kind;
    r->channel.client = client;
}

static void writer_part(rosplc_plc_writer *w, const char *prefix, const char *name, const char *client, uint32_t kind,
                        const rosplc_plc_part *part)
{
    rosplc_plc_writer_init(w, prefix, name, part->layout_lo, part->layout_hi, part->record_size);
    w->channel.kind = kind;
    w->channel.client = client;
}

/* ---- the client */

void rosplc_plc_client_init(rosplc_plc_client *c, const char *prefix, const char *name, const char *client,
                            const rosplc_plc_part *parts, int action)
{
    memset((void *)c, 0, sizeof *c);
    c->block.beat_ms = UNKNOWN_BEAT_MS;
    c->action = action;
    c->request = parts[0].record;
    writer_part(&c->out, prefix, name, client, action ? ROSPLC_KIND_GOAL : ROSPLC_KIND_REQUEST, &parts[0]);
    reader_part(&c->in, prefix, name, client, action ? ROSPLC_KIND_RESULT : ROSPLC_KIND_RESPONSE, &parts[1]);
    if (action)
        reader_part(&c->feedback, prefix, name, client, ROSPLC_KIND_FEEDBACK, &parts[2]);
}

/* Ends the current call; `outcome` 0: it is done. */
static void conclude(rosplc_plc_client *c, uint32_t outcome, uint32_t reason, int asked)
{
    c->busy = c->giving_up = c->sent = 0;
    c->done = !outcome;
    c->aborted = outcome && asked;
    c->failed = outcome && !asked;
    c->outcome = outcome;
    c->reason = reason;
}

int rosplc_plc_client_begin(rosplc_plc_client *c, uint32_t now_ms)
{
    int rose;
    c->running = enter(&c->block, now_ms);
    if (!c->running)
        return 0;
    rose = c->execute && !c->before;
    c->before = c->execute;
    if (c->busy) {
        c->waited = c->waited + c->block.elapsed < c->waited ? 0xFFFFFFFFu : c->waited + c->block.elapsed;
        c->silent = c->silent + c->block.elapsed < c->silent ? 0xFFFFFFFFu : c->silent + c->block.elapsed;
        if (c->block.peer_alive)
            c->silent = 0;
        return 0;
    }
    if (rose || !c->execute)
        c->done = c->aborted = c->failed = (int)(c->outcome = c->reason = 0);
    if (!rose)
        return 0;
    c->busy = 1;
    c->sent = c->giving_up = c->stopped = c->accepted = c->asked = c->cancel_rejected = 0;
    c->status = c->waited = c->silent = 0;
    c->limit = c->timeout_ms;
    c->grace = c->grace_ms;
    return ROSPLC_PLC_REQUEST;
}

static int known(uint32_t peers)
{
    return peers != 0 && peers != ROSPLC_UNKNOWN;
}

/* Whether this scan's answer ends a call of any kind. */
static int ends(const rosplc_plc_client *c)
{
    return c->answer && c->answer <= ROSPLC_ANSWER_ABORTED && c->answer != ROSPLC_ANSWER_ACCEPTED;
}

/* Ends the call with an answer that has no record. An answer for another kind of call means FATE_UNKNOWN. */
static void fail(rosplc_plc_client *c, int asked)
{
    if (ends(c))
        conclude(c,
                 c->answer == ROSPLC_ANSWER_NOT_EXECUTED ? ROSPLC_ERROR_NOT_EXECUTED
                 : c->answer == ROSPLC_ANSWER_UNREADABLE ? ROSPLC_ERROR_UNREADABLE
                                                         : ROSPLC_ERROR_FATE_UNKNOWN,
                 c->in.call.reason, asked);
}

/* Applies the answer to a goal; 1: it has a result. */
static int goal_answered(rosplc_plc_client *c)
{
    uint32_t status = c->in.call.status;
    int record = ends(c) && c->answer >= ROSPLC_ANSWER_SUCCEEDED && !(status & ROSPLC_ANSWER_NO_RESULT);
    switch (c->answer) {
    case ROSPLC_ANSWER_ACCEPTED:
        c->accepted = 1;
        c->status = status & ROSPLC_ANSWER_CANCEL_ACCEPTED ? 3 : 2; /* action_msgs/msg/GoalStatus */
        if (!(status & ROSPLC_ANSWER_CANCEL_ACCEPTED))
            c->cancel_rejected = c->asked && (status & ROSPLC_ANSWER_CANCEL_REJECTED);
        break;
    case ROSPLC_ANSWER_SUCCEEDED:
        c->status = 4;
        conclude(c, record ? 0 : (uint32_t)ROSPLC_ERROR_UNREADABLE,
                 record ? c->in.call.reason : (uint32_t)ROSPLC_REASON_TOO_LARGE, 0);
        break;
    case ROSPLC_ANSWER_CANCELED:
        c->status = 5;
        conclude(c, ROSPLC_ERROR_GOAL_CANCELED, c->in.call.reason, 1);
        break;
    case ROSPLC_ANSWER_ABORTED:
        c->status = 6;
        conclude(c, ROSPLC_ERROR_GOAL_ABORTED, c->in.call.reason, 0);
        break;
    default:
        fail(c, c->stopped && c->answer == ROSPLC_ANSWER_NOT_EXECUTED);
    }
    return record;
}

/* Checks the newest answer; 1: its record is the response or result. */
static int answered(rosplc_plc_client *c)
{
    c->block.attached = c->out.ready && ready(&c->in);
    c->block.peer_alive = c->out.channel.peer_alive && c->in.channel.peer_alive;
    c->server = c->block.peer_alive && (known(c->out.sinks) || known(c->in.sources));
    c->answer = 0;
    if (!c->in.is_new)
        return 0;
    if ((c->sent || c->owed) && same(&c->in.call, &c->mine)) {
        c->answer = c->in.call.status & ROSPLC_ANSWER_MASK;
        if (c->busy && c->sent) {
            if (c->action)
                return goal_answered(c);
            if (c->answer == ROSPLC_ANSWER_DONE)
                conclude(c, 0, ROSPLC_REASON_NONE, 0);
            else
                fail(c, c->stopped);
            return c->done;
        }
    }
    if (c->action && ends(c))
        c->owed = 0; /* the abandoned goal has ended */
    c->late++;
    return 0;
}

/* Ends the call if its object or claim is gone, so that no answer can come. */
static void lose(rosplc_plc_client *c)
{
    const rosplc_plc_writer *w = &c->out;
    int retired = w->channel.error == ROSPLC_ERROR_RETIRED;
    if (w->epoch == c->mine.caller && w->channel.generation == c->of_object && !retired)
        return;
    c->send = c->owed = 0;
    if (c->busy && c->sent) /* only a retired object is never acted on again (M27); a removed one may be */
        conclude(c,
                 retired && w->epoch == c->mine.caller && !w->begun ? ROSPLC_ERROR_NOT_EXECUTED
                                                                    : ROSPLC_ERROR_FATE_UNKNOWN,
                 ROSPLC_REASON_BRIDGE_RESTARTED, c->stopped);
}

/* Whether the call has taken too long, or the bridge has been silent for too long. */
static int is_over(const rosplc_plc_client *c)
{
    return (c->limit && c->waited > c->limit) || (c->grace && c->silent > c->grace && !c->block.peer_alive);
}

/* Sends a call that has not been sent yet, or ends it. */
static void open_call(rosplc_plc_client *c)
{
    const rosplc_plc_writer *w = &c->out;
    int unknown = w->sinks == ROSPLC_UNKNOWN || c->in.sources == ROSPLC_UNKNOWN;
    c->opening = 0;
    if (c->stop) {
        conclude(c, ROSPLC_ERROR_NOT_EXECUTED, ROSPLC_REASON_NONE, 1);
    } else if (is_over(c)) {
        conclude(c, ROSPLC_ERROR_NOT_EXECUTED, ROSPLC_REASON_TIME_OUT, 0);
    } else if (c->block.attached && w->held && c->block.peer_alive && !c->send && !c->owed && (c->server || unknown)) {
        c->number += c->number == 0xFFFFFFFFu ? 2 : 1;
        c->mine.number = c->number;
        c->mine.caller = w->epoch;
        c->of_object = w->channel.generation;
        if (c->action) { /* computed from the slot's words: any reader of the message can identify the goal */
            c->mine.client[0] = c->of_object;
            c->mine.client[1] = c->mine.caller;
            c->mine.client[2] = c->number;
            c->mine.client[3] = ROSPLC_GOAL_ID_END;
        }
        prepare(&c->send, &c->say, &c->mine, ROSPLC_ASK_CALL, 0);
        c->opening = 1;
    }
}

/* Decides what to send in this scan. */
static void decide(rosplc_plc_client *c)
{
    int over;
    if (c->sent || c->owed)
        lose(c);
    if (!c->busy || c->giving_up)
        return;
    over = is_over(c);
    if (!c->sent) {
        open_call(c);
    } else if (over || (c->stop && !c->action)) {
        uint32_t withdrawn = c->accepted ? 0 : ROSPLC_ASK_WITHDRAWN; /* a call not yet begun never will be (M26) */
        c->giving_up = 1;
        c->stopped = c->stop && !c->action;
        prepare(&c->send, &c->say, &c->mine, ROSPLC_ASK_CALL | withdrawn | (c->action ? ROSPLC_ASK_CANCEL : 0), 0);
    } else if (c->action && c->stop && !c->asked) {
        c->asked = c->stopped = 1;
        prepare(&c->send, &c->say, &c->mine, ROSPLC_ASK_CALL | ROSPLC_ASK_CANCEL, 0);
    } else if (c->action && !c->stop && c->cancel_rejected) {
        c->asked = c->stopped = c->cancel_rejected = 0;
        prepare(&c->send, &c->say, &c->mine, ROSPLC_ASK_CALL, 0);
    }
}

/* Evaluates the outcome of this scan's message. */
static void settle(rosplc_plc_client *c)
{
    int gone = !c->out.ready, fate;
    if (c->out.published)
        c->send = 0;
    if (c->giving_up && (gone || !c->send)) {
        fate = c->accepted || gone || c->out.begun;
        c->owed = c->action ? fate : c->send; /* withdrawn as soon as the object is reopened */
        conclude(c, fate ? ROSPLC_ERROR_FATE_UNKNOWN : ROSPLC_ERROR_NOT_EXECUTED,
                 c->stopped ? ROSPLC_REASON_NONE : ROSPLC_REASON_TIME_OUT, c->stopped);
    } else if (c->owed && !c->action) {
        c->owed = c->send;
    } else if (c->busy && !c->sent && !c->owed) {
        c->sent = c->opening && c->out.published;
        c->calls += (uint32_t)c->sent;
        c->opening = c->send = 0;
    }
    c->active = c->busy && c->accepted;
}

int rosplc_plc_client_end(rosplc_plc_client *c)
{
    uint32_t now_ms = c->block.now;
    int got = 0;
    if (!c->running)
        return 0;
    share(&c->out.channel, &c->block);
    share(&c->in.channel, &c->block);
    c->new_feedback = 0;
    if (c->action) {
        share(&c->feedback.channel, &c->block);
        (void)rosplc_plc_read(&c->feedback, now_ms);
        c->new_feedback = c->feedback.is_new && c->busy && c->sent && same(&c->feedback.call, &c->mine);
        got |= c->new_feedback ? ROSPLC_PLC_FEEDBACK : 0;
    }
    (void)rosplc_plc_read(&c->in, now_ms);
    got |= answered(c) ? ROSPLC_PLC_RESPONSE : 0;
    decide(c);
    transmit(&c->out, now_ms, c->send ? &c->say : NULL, c->request);
    settle(c);
    c->block.error = first_of(first_of(c->outcome, c->out.channel.error),
                              first_of(c->in.channel.error, c->feedback.channel.error));
    leave(&c->block);
    return got;
}

void rosplc_plc_client_close(rosplc_plc_client *c)
{
    rosplc_plc_writer_close(&c->out);
    rosplc_plc_reader_close(&c->in);
    rosplc_plc_reader_close(&c->feedback);
    c->block.clock_runs = 0;
}

/* ---- the server */

void rosplc_plc_server_init(rosplc_plc_server *s, const char *prefix, const char *name, const rosplc_plc_part *parts,
                            int action)
{
    memset((void *)s, 0, sizeof *s);
    s->block.beat_ms = UNKNOWN_BEAT_MS;
    s->callers = ROSPLC_UNKNOWN;
    s->action = action;
    s->response = parts[1].record;
    reader_part(&s->in, prefix, name, "", action ? ROSPLC_KIND_GOAL : ROSPLC_KIND_REQUEST, &parts[0]);
    writer_part(&s->out, prefix, name, "", action ? ROSPLC_KIND_RESULT : ROSPLC_KIND_RESPONSE, &parts[1]);
    if (action) {
        s->report = parts[2].record;
        writer_part(&s->feedback, prefix, name, "", ROSPLC_KIND_FEEDBACK, &parts[2]);
    }
}

/* Ends the last call read, which was not shown. */
static void refuse(rosplc_plc_server *s, uint32_t status, uint32_t reason)
{
    s->found = 0;
    s->refused++;
    prepare(&s->send, &s->say, &s->news, status, reason);
}

/* Applies a further message of the current call: each repeats the call's whole state. */
static void updated(rosplc_plc_server *s, uint32_t status)
{
    if (status & ROSPLC_ASK_WITHDRAWN)
        s->caller_gone = 1;
    if (!(status & ROSPLC_ASK_CANCEL))
        s->asked = 0;
    else if (!s->canceling && (!(s->mine.status & ROSPLC_ASK_CANCEL) || status == s->mine.status))
        s->asked = 1; /* a first or repeated request */
    s->preempt = (status & ROSPLC_ASK_PREEMPT) != 0;
    s->mine.status = status;
}

/* Evaluates the newest message; 1: it is a call that may begin if begin() returns 1. */
static int offered(rosplc_plc_server *s)
{
    rosplc_plc_reader *in = &s->in;
    int again, fresh, open = ready(in);
    s->block.attached = open && s->out.ready;
    s->block.peer_alive = in->channel.peer_alive && s->out.channel.peer_alive;
    s->callers = in->sources;
    if (!open) {
        s->first_read = 0;
        if (s->shown && in->channel.error == ROSPLC_ERROR_RETIRED)
            s->caller_gone = 1; /* even if no new object follows */
    } else if (in->channel.generation != s->of_object) { /* the bridge has ended the previous object's call */
        s->of_object = in->channel.generation;
        s->found = s->send = 0;
        s->orphan = s->caller_gone = s->shown;
    }
    if (s->shown)
        s->age_ms = s->age_ms + s->block.elapsed < 0xF0000000u ? s->age_ms + s->block.elapsed : 0xF0000000u;
    if (in->is_new) {
        fresh = !s->first_read;
        s->first_read = 1;
        again = same(&in->call, &s->news);
        if (s->found && !again && !s->send)
            refuse(s, ROSPLC_ANSWER_NOT_EXECUTED, ROSPLC_REASON_CALLER_GONE);
        if (s->shown && !s->orphan && same(&in->call, &s->mine)) {
            updated(s, in->call.status);
            s->found = 0;
        } else {
            s->found = s->found || !again; /* a call that has ended is not begun again */
            s->caller_gone = s->caller_gone || (s->shown && s->found);
        }
        s->news = in->call;
        s->verdict = 0;
        if (s->news.status != ROSPLC_ASK_CALL) { /* an earlier run may have begun the first call found */
            s->verdict = fresh ? ROSPLC_ANSWER_FATE_UNKNOWN : ROSPLC_ANSWER_NOT_EXECUTED;
            s->verdict_reason = fresh ? ROSPLC_REASON_PLC_DOWN : ROSPLC_REASON_CALLER_GONE;
        }
    } else if (!s->found && !s->shown) {
        s->news = in->call; /* the state found when opening belongs to an earlier run */
    }
    if (s->found && s->verdict && !s->send)
        refuse(s, s->verdict, s->verdict_reason);
    return s->found && !s->shown && !s->send && s->out.ready;
}

/* Ends the current call; 1: with an answer. */
static int ended(rosplc_plc_server *s, uint32_t status, uint32_t reason)
{
    s->shown = s->caller_gone = 0;
    s->age_ms = 0;
    if (!s->orphan)
        prepare(&s->send, &s->say, &s->mine, status, reason);
    return !s->orphan;
}

/* Applies the program's answer; 1: the response must be sent. */
static int replied(rosplc_plc_server *s, uint32_t rose)
{
    int fill = 0;
    if (rose & (ROSPLC_PLC_REPLY | ROSPLC_PLC_REJECT)) { /* only if shown before this call, and only one of them */
        s->illegal = !s->request
                     || (s->steps & (ROSPLC_PLC_REPLY | ROSPLC_PLC_REJECT)) == (ROSPLC_PLC_REPLY | ROSPLC_PLC_REJECT);
        if (!s->illegal && rose & ROSPLC_PLC_REPLY)
            fill = ended(s, ROSPLC_ANSWER_DONE, 0);
        else if (!s->illegal)
            (void)ended(s, ROSPLC_ANSWER_NOT_EXECUTED, ROSPLC_REASON_REJECTED);
    }
    s->request = s->shown;
    return fill;
}

/* Applies the program's steps, each judged by the outputs before this call; 1: the result must be sent. */
static int stepped(rosplc_plc_server *s, uint32_t rose)
{
    const uint32_t decided = rose & (ROSPLC_PLC_ACCEPT | ROSPLC_PLC_REJECT);
    const uint32_t cancel = rose & (ROSPLC_PLC_ACCEPT_CANCEL | ROSPLC_PLC_REJECT_CANCEL);
    const uint32_t end = rose & (ROSPLC_PLC_SUCCEED | ROSPLC_PLC_ABORT | ROSPLC_PLC_CANCELED);
    int fill = 0;
    if (s->shown && s->caller_gone && !s->accepted)
        (void)ended(s, ROSPLC_ANSWER_NOT_EXECUTED, ROSPLC_REASON_CALLER_GONE); /* it was not begun */
    if (decided && (decided & (decided - 1) || !s->request || !s->shown)) {
        s->illegal = 1;
    } else if (decided == ROSPLC_PLC_ACCEPT) {
        s->accepted = 1;
        prepare(&s->send, &s->say, &s->mine, ROSPLC_ANSWER_ACCEPTED, 0);
    } else if (decided) {
        (void)ended(s, ROSPLC_ANSWER_NOT_EXECUTED, ROSPLC_REASON_REJECTED);
    }
    if (cancel && (cancel & (cancel - 1) || !s->cancel_requested)) {
        s->illegal = 1;
    } else if (cancel) {
        s->asked = 0;
        s->canceling = cancel == ROSPLC_PLC_ACCEPT_CANCEL;
        s->cancel = s->canceling ? ROSPLC_ANSWER_CANCEL_ACCEPTED : ROSPLC_ANSWER_CANCEL_REJECTED;
        if (!s->orphan)
            prepare(&s->send, &s->say, &s->mine, ROSPLC_ANSWER_ACCEPTED | s->cancel, 0);
    }
    if (end && (end & (end - 1) || !s->active || (end == ROSPLC_PLC_CANCELED && !s->canceling)))
        s->illegal = 1;
    else if (end)
        fill = ended(s,
                     (end == ROSPLC_PLC_SUCCEED ? ROSPLC_ANSWER_SUCCEEDED
                      : end == ROSPLC_PLC_ABORT ? ROSPLC_ANSWER_ABORTED
                                                : ROSPLC_ANSWER_CANCELED)
                         | s->cancel,
                     0);
    s->request = s->shown && !s->accepted;
    s->active = s->shown && s->accepted;
    s->cancel_requested = s->active && s->asked;
    s->canceling = s->active && s->canceling;
    s->preempt = s->shown && s->preempt;
    return fill;
}

int rosplc_plc_server_begin(rosplc_plc_server *s, uint32_t now_ms)
{
    uint32_t rose;
    int got = 0;
    s->running = enter(&s->block, now_ms);
    if (!s->running)
        return 0;
    share(&s->in.channel, &s->block);
    share(&s->out.channel, &s->block);
    share(&s->feedback.channel, &s->block);
    (void)rosplc_plc_read(&s->in, now_ms);
    if (offered(s) && begin(&s->in)) {
        s->mine = s->news;
        s->shown = 1;
        s->found = s->orphan = s->caller_gone = s->accepted = s->canceling = s->preempt = s->asked = 0;
        s->age_ms = s->cancel = 0;
        s->calls++;
        got = ROSPLC_PLC_REQUEST;
    }
    rose = s->steps & ~s->before;
    s->before = s->steps;
    s->illegal = s->illegal && s->steps;
    if (s->action ? stepped(s, rose) : replied(s, rose))
        got |= ROSPLC_PLC_RESPONSE;
    return got | (s->action && s->send_feedback ? ROSPLC_PLC_FEEDBACK : 0);
}

void rosplc_plc_server_end(rosplc_plc_server *s)
{
    rosplc_plc_call report = s->mine;
    if (!s->running)
        return;
    transmit(&s->out, s->block.now, s->send ? &s->say : NULL, s->response);
    if (s->out.published)
        s->send = 0;
    if (s->action) {
        report.status = ROSPLC_ANSWER_ACCEPTED;
        transmit(&s->feedback, s->block.now, s->send_feedback && s->active && !s->orphan ? &report : NULL, s->report);
    }
    s->block.error = first_of(first_of(s->illegal ? (uint32_t)ROSPLC_ERROR_ILLEGAL_STEP : 0, s->in.channel.error),
                              first_of(s->out.channel.error, s->feedback.channel.error));
    leave(&s->block);
}

void rosplc_plc_server_close(rosplc_plc_server *s)
{
    rosplc_plc_reader_close(&s->in);
    rosplc_plc_writer_close(&s->out);
    rosplc_plc_writer_close(&s->feedback);
    s->block.clock_runs = 0;
}
