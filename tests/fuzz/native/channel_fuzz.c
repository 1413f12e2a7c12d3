/* libFuzzer target: a region that its other users change as they like, under the C core's readers and writers.
 *
 * An input is a header (what an attaching side finds), and then steps: calls of readers and writers, each of
 * them cut at the places where the format lets others act, and words written by those others in between. The
 * region is heap memory of exactly the size that its identity promises, so that the sanitizer sees any access
 * beside it. Some inputs are run once more with a thread that writes the same words while the calls go on:
 * what the compiler makes of the copies is then exercised too.
 *
 * What must hold: no access outside, no endless loop, a take copies a whole record or nothing, the encoder
 * stays within its bound, and a fault-free message decodes to a record again.
 */
#define _GNU_SOURCE
#include <rosplc/channel.h>
#include "plan_file.h"

#include <pthread.h>

#include "counts.h"

enum { LARGEST = 1 << 20, MOST_STEPS = 300, READERS = 3, WRITERS = 2 };

static plan_case *cases;
static uint32_t count;

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    const char *path = getenv("ROSPLC_FUZZ_PLANS");
    (void)argc;
    (void)argv;
    if (!path)
        stop("ROSPLC_FUZZ_PLANS is not set");
    cases = read_plans(path, &count);
    counts_open();
    return 0;
}

typedef struct {
    const uint8_t *data;
    size_t size, at;
} input;

static uint32_t draw_byte(input *in)
{
    return in->at < in->size ? in->data[in->at++] : 0;
}

static uint32_t draw_word(input *in)
{
    uint32_t word = 0;
    for (int i = 0; i < 4; i++)
        word |= draw_byte(in) << (8 * i);
    return word;
}

typedef struct {
    rosplc_region region;
    uint8_t *memory;
    const plan_case *plan; /* one whose records have the region's size, or NULL */
    rosplc_reader reader[READERS];
    rosplc_writer writer[WRITERS];
    int has_writer[WRITERS];
    volatile int racing;
} scene;

/* ---------------------------------------------------------------- the others */

/* Writes one word or byte anywhere; three quarters of the time among the control words and slot headers. */
static void scribble(scene *s, input *in)
{
    static const uint32_t words[] = {0, 1, 2, 3, 4, 5, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF};
    const rosplc_geometry *g = &s->region.geometry;
    uint32_t how = draw_byte(in), value = draw_byte(in), at = draw_byte(in) | draw_byte(in) << 8;
    if (how & 1)
        at %= ROSPLC_HEADER_SIZE;
    else if (how & 2)
        at = g->slots_offset + (at >> 4) % g->slot_count * g->slot_stride + (at & 15) * 4;
    else
        at = (uint32_t)((uint64_t)at * g->object_size >> 16);
    at &= ~3u;
    if (at + 4 > g->object_size)
        return;
    if (value < sizeof words / sizeof *words)
        value = words[value];
    else if (how & 4) /* near what stands in head, the word that everything else is compared with */
        value = rosplc_load(&s->region.header->writer.head) + value - 128;
    rosplc_store((uint32_t *)(void *)(s->memory + at), value);
}

typedef struct {
    scene *scene;
    input in;
} other;

static void *race(void *argument)
{
    other *o = argument;
    while (o->scene->racing) {
        if (o->in.at >= o->in.size)
            o->in.at = 0;
        scribble(o->scene, &o->in);
    }
    return NULL;
}

/* ---------------------------------------------------------------- this side */

static void take(scene *s, rosplc_reader *reader, int mode, int wire, input *in)
{
    uint32_t size = s->region.geometry.record_size, last = reader->last;
    rosplc_take t = rosplc_take_start(mode);
    uint32_t attempts = 0, taken = 0;
    while (rosplc_take_begin(reader, &t)) {
        if (++attempts > 1 + ROSPLC_MAX_RETRIES)
            stop("a take has no end");
        if (!s->racing && (draw_byte(in) & 3) == 0)
            scribble(s, in);
        if (wire && s->plan) {
            size_t bound = rp_encoded_bound(&s->plan->plan), used = 0;
            uint8_t *out = exact(bound), *record = exact(size);
            uint32_t flags;
            rp_fault fault;
            if (rp_encode(&s->plan->plan, rosplc_record(t.slot), out, bound, &used, &fault) || used > bound)
                stop("a record under change exceeds its bound");
            if (rp_decode(&s->plan->plan, out, used, record, 0, &flags, &fault) || flags)
                stop("a record under change gives no message");
            release(record, size);
            release(out, bound);
        } else {
            uint8_t *copy = exact(size);
            memcpy(copy, rosplc_record(t.slot), size);
            release(copy, size);
        }
        if (!s->racing && (draw_byte(in) & 3) == 0)
            scribble(s, in);
        if (rosplc_take_check(reader, &t)) {
            rosplc_take_accept(reader, &t);
            taken++;
        }
    }
    if (taken > 1)
        stop("one take takes two messages");
    if (mode != ROSPLC_TAKE_PEEK && taken && reader->last == last)
        stop("a message is taken twice");
    if (!taken && reader->last != last)
        stop("nothing taken, and the reader has moved");
}

static void publish(scene *s, rosplc_writer *writer, input *in)
{
    static const rosplc_meta meta = {.stamp_lo = 1};
    uint32_t size = s->region.geometry.record_size;
    rosplc_error error;
    rosplc_slot_header *slot = rosplc_writer_begin(writer, &error);
    if (!slot) {
        if (error != 111 && error != 112 && error != 115)
            stop("a writer refuses with a number that is none");
        return;
    }
    if (!s->racing && (draw_byte(in) & 3) == 0)
        scribble(s, in);
    if (s->plan && draw_byte(in) & 1) {
        uint32_t flags, length = draw_byte(in);
        rp_fault fault;
        size_t left = in->size - in->at;
        if (length > left)
            length = (uint32_t)left;
        if (rp_decode(&s->plan->plan, in->data + in->at, length, rosplc_record(slot), (int)(length & 1), &flags, &fault)) {
            in->at += length;
            rosplc_writer_refuse(writer, fault.code);
            return;
        }
        in->at += length;
    } else {
        memset(rosplc_record(slot), (int)draw_byte(in), size);
    }
    if (!s->racing && (draw_byte(in) & 3) == 0)
        scribble(s, in);
    rosplc_writer_commit(writer, slot, &meta);
}

static void step(scene *s, input *in)
{
    uint32_t what = draw_byte(in);
    rosplc_reader *reader = &s->reader[(what >> 4) % READERS];
    uint32_t number = (what >> 4) % WRITERS;
    rosplc_writer *writer = &s->writer[number];
    switch (what & 15) {
    case 0: take(s, reader, ROSPLC_TAKE_NEXT, 0, in); break;
    case 1: take(s, reader, ROSPLC_TAKE_NEWEST, 0, in); break;
    case 2: take(s, reader, ROSPLC_TAKE_PEEK, 0, in); break;
    case 3: take(s, reader, ROSPLC_TAKE_NEXT, 1, in); break;
    case 4: take(s, reader, ROSPLC_TAKE_NEWEST, 1, in); break;
    case 5: rosplc_reader_beat(reader); (void)rosplc_reader_news(reader); break;
    case 6:
        if (!reader->line) {
            uint32_t index = draw_byte(in) % ROSPLC_READER_LINES;
            (void)rosplc_reader_claim(reader, index, rosplc_load(&s->region.header->reader[index].claim), 7 + number, 10, 1);
        }
        break;
    case 7: rosplc_reader_release(reader); break;
    case 8: rosplc_reader_observe(reader, &s->region, draw_word(in)); break;
    case 9:
        s->has_writer[number] |=
            !rosplc_writer_claim(writer, &s->region, rosplc_load(&s->region.header->writer.writer_epoch), 3 + number, 10, 1);
        break;
    case 10:
    case 11:
        if (s->has_writer[number])
            publish(s, writer, in);
        break;
    case 12:
        if (s->has_writer[number]) {
            rosplc_writer_beat(writer);
            if (what & 16)
                rosplc_writer_release(writer);
        }
        break;
    default: scribble(s, in); break;
    }
}

/* ---------------------------------------------------------------- the scene */

/* A header from the input; most of the time made consistent, or it would hardly ever pass the checks. */
static int set_scene(scene *s, input *in)
{
    uint8_t first[ROSPLC_HEADER_SIZE] = {0};
    rosplc_identity id = {.magic = ROSPLC_MAGIC, .version = ROSPLC_VERSION, .header_size = ROSPLC_HEADER_SIZE, .state = ROSPLC_STATE_LIVE,
                      .kind = ROSPLC_KIND_TOPIC, .slot_header_size = ROSPLC_SLOT_HEADER_SIZE, .slots_offset = 576,
                      .description_offset = 512, .description_size = 2, .layout_id_lo = 11, .layout_id_hi = 22,
                      .generation = 33, .reader_lines = ROSPLC_READER_LINES};
    uint32_t how = draw_byte(in), which = draw_byte(in) | draw_byte(in) << 8, available;
    s->plan = how & 8 ? NULL : &cases[which % count];
    id.direction = how & 16 ? ROSPLC_TO_PLC : ROSPLC_TO_ROS;
    id.slot_count = 4u << (how >> 5);
    id.record_size = s->plan ? s->plan->plan.record_size : 1 + which % 3000;
    id.slot_stride = (ROSPLC_SLOT_HEADER_SIZE + id.record_size + 63u) / 64u * 64u;
    id.object_size = id.slots_offset + id.slot_count * id.slot_stride;
    for (uint32_t changes = how & 3; changes; changes--) {
        uint32_t at = draw_byte(in) % 28, value = draw_word(in);
        ((uint32_t *)(void *)&id)[at] = value;
    }
    memcpy(first, &id, sizeof id);
    if (!(how & 4)) {
        id.identity_crc = rosplc_identity_crc(first);
        memcpy(first, &id, sizeof id);
    }
    available = id.object_size < LARGEST ? id.object_size : LARGEST;
    if (rosplc_identity_check(first, available, 0, &s->region.geometry))
        return 0;
    if (s->plan && s->plan->plan.record_size != s->region.geometry.record_size)
        s->plan = NULL;
    available = s->region.geometry.object_size;
    if (posix_memalign((void **)&s->memory, 64, available))
        stop("out of memory");
    memset(s->memory, 0, available);
    memcpy(s->memory, first, sizeof first);
    s->region.header = (rosplc_header *)(void *)s->memory;
    for (int i = 0; i < READERS; i++)
        rosplc_reader_observe(&s->reader[i], &s->region, 0);
    return 1;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input in = {data, size, 0}, steps;
    scene s = {0};
    counts_add(size);
    if (!set_scene(&s, &in))
        return 0;
    steps = in;
    for (int i = 0; i < MOST_STEPS && in.at < in.size; i++)
        step(&s, &in);
    if (steps.size - steps.at > 16 && steps.data[steps.at] % 16 == 5) {
        other o = {&s, steps};
        pthread_t thread;
        s.racing = 1;
        if (pthread_create(&thread, NULL, race, &o))
            stop("no thread");
        for (int round = 0; round < 8; round++) {
            in = steps;
            for (int i = 0; i < MOST_STEPS && in.at < in.size; i++)
                step(&s, &in);
        }
        s.racing = 0;
        pthread_join(thread, NULL);
    }
    free(s.memory);
    return 0;
}
