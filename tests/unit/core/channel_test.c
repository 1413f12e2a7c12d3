/* Tests of channel.h without Python: compiled natively, with sanitizers, and for ARM under qemu.
 *
 *   channel_test logic                     sequences, identity, windows, losses, claims
 *   channel_test scribble ROUNDS SEED      random bytes over every control word; no access leaves the object
 *   channel_test torn SECONDS BYTES SLOTS MODE MESSAGES
 *       one process writes flat out, another reads; prints "reads accepted torn rejected".
 *       MODE checked | next | unchecked: the last leaves M12 out and must see torn messages.
 */
#define _GNU_SOURCE
#include "channel.h"

#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

static int failures;
#define CHECK(condition) \
    do { \
        if (!(condition)) { \
            printf("%s:%d: %s\n", __FILE__, __LINE__, #condition); \
            failures++; \
        } \
    } while (0)

/* ---------------------------------------------------------------- an object in private or shared memory */

static ch_region make_region(uint32_t slots, uint32_t record)
{
    uint32_t stride = (CH_SLOT_HEADER_SIZE + record + 63u) / 64u * 64u;
    uint32_t size = 1024u + slots * stride;
    ch_region r;
    ch_identity *id;
    /* One page more, without access: whoever leaves the object is caught even without sanitizers. */
    size_t page = (size_t)sysconf(_SC_PAGESIZE), room = (size + page - 1) / page * page;
    uint8_t *base = mmap(NULL, room + page, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (base == MAP_FAILED || mprotect(base + room, page, PROT_NONE)) {
        perror("mmap");
        exit(2);
    }
    base += (room - size) / 64u * 64u; /* the object's end as near to the guard as its lines allow */
    id = (ch_identity *)(void *)base;
    *id = (ch_identity){.magic = CH_MAGIC,
                        .version = CH_VERSION,
                        .header_size = CH_HEADER_SIZE,
                        .state = CH_STATE_LIVE,
                        .kind = CH_KIND_TOPIC,
                        .direction = CH_TO_ROS,
                        .slot_count = slots,
                        .slot_stride = stride,
                        .slot_header_size = CH_SLOT_HEADER_SIZE,
                        .record_size = record,
                        .slots_offset = 1024,
                        .object_size = size,
                        .description_offset = 512,
                        .description_size = 2,
                        .layout_lo = 11,
                        .layout_hi = 22,
                        .generation = 33,
                        .reader_lines = CH_READER_LINES};
    id->identity_crc = ch_identity_crc(base);
    CHECK(ch_identity_check(base, size, CH_TO_ROS, &r.geometry) == 0);
    r.header = (ch_header *)(void *)base;
    return r;
}

static int try_publish(ch_writer *w, uint8_t value)
{
    static const ch_meta meta;
    int error;
    ch_slot_header *slot = ch_writer_begin(w, &error);
    if (!slot)
        return -error;
    memset(ch_record(slot), value, w->region->geometry.record_size);
    ch_writer_commit(w, slot, &meta);
    return 1;
}

static void publish(ch_writer *w, uint8_t value)
{
    CHECK(try_publish(w, value) == 1);
}

/* The first byte of the message taken, -1 if none; a mixture of bytes counts as a failure. */
static int take(ch_reader *reader, int mode)
{
    ch_take t = ch_take_start(mode);
    int result = -1;
    while (ch_take_begin(reader, &t)) {
        uint8_t copy[256];
        uint32_t size = reader->region->geometry.record_size;
        memcpy(copy, ch_record(t.slot), size);
        if (ch_take_check(reader, &t)) {
            ch_take_accept(reader, &t);
            for (uint32_t i = 1; i < size; i++)
                CHECK(copy[i] == copy[0]);
            result = copy[0];
        }
    }
    return result;
}

/* ---------------------------------------------------------------- logic */

static void test_sequences(void)
{
    CHECK(ch_next(0, 4) == 1);
    CHECK(ch_next(1, 4) == 2);
    CHECK(ch_next(0xFFFFFFFEu, 4) == 0xFFFFFFFFu);
    CHECK(ch_next(0xFFFFFFFFu, 4) == 4);
    CHECK(ch_next(0xFFFFFFFFu, 65536) == 65536);
    CHECK((0xFFFFFFFFu & 3u) == 3 && (ch_next(0xFFFFFFFFu, 4) & 3u) == 0);
    CHECK(ch_distance(5, 5, 4) == 0);
    CHECK(ch_distance(5, 9, 4) == 4);
    CHECK(ch_distance(0xFFFFFFFFu, 4, 4) == 1);
    CHECK(ch_distance(0xFFFFFFFEu, 5, 4) == 3);
    CHECK(ch_distance(9, 8, 4) >= CH_DISCONTINUITY);
    CHECK(ch_distance(0xFFFFFFFFu, 0, 4) >= CH_DISCONTINUITY);
    for (uint32_t n = 4; n <= 64; n *= 2) {
        uint32_t s = 0xFFFFFFFFu - 100, steps = 0;
        for (uint32_t t = s; steps < 300; steps++, t = ch_next(t, n)) {
            CHECK(ch_distance(s, t, n) == steps);
            CHECK(ch_advance(s, steps, n) == t);
            CHECK(t >= n || t > s);
        }
    }
}

/* Two slots' worth of messages on each side of `start`, read in all three ways. */
static void test_stream(uint32_t slots, uint32_t start)
{
    ch_region r = make_region(slots, 40);
    ch_writer w;
    ch_reader in_order, newest, slow;
    uint32_t missed = 3 * slots;
    r.header->writer.head = start;
    CHECK(ch_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    ch_reader_observe(&in_order, &r, start);
    ch_reader_observe(&newest, &r, start);
    ch_reader_observe(&slow, &r, start);
    for (int i = 0; i < (int)(4 * slots); i++) {
        CHECK(take(&in_order, CH_TAKE_NEXT) == -1);
        publish(&w, (uint8_t)i);
        CHECK(take(&in_order, CH_TAKE_NEXT) == (uint8_t)i);
        CHECK(take(&in_order, CH_TAKE_PEEK) == (uint8_t)i);
        CHECK(take(&newest, CH_TAKE_NEWEST) == (uint8_t)i);
    }
    CHECK(in_order.lost == 0 && newest.lost == 0 && in_order.discontinuities == 0);
    /* `slow` has slept through 4N messages; N-1 are left. */
    for (uint32_t i = 0; i < slots - 1; i++)
        CHECK(take(&slow, CH_TAKE_NEXT) == (uint8_t)(missed + i + 1));
    CHECK(take(&slow, CH_TAKE_NEXT) == -1);
    CHECK(slow.lost == (start ? 4 * slots - (slots - 1) : 0)); /* before a first message lies no loss */
    CHECK(slow.last == w.head && slow.discontinuities == 0);
}

static void test_first_flag_and_counters(void)
{
    ch_region r = make_region(4, 8);
    ch_writer w;
    ch_reader reader;
    ch_take t;
    ch_meta meta = {CH_FLAG_TRUNCATED, 0, 1, 2, 3, 4, 5};
    int error;
    CHECK(ch_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    ch_reader_observe(&reader, &r, 0);
    for (int i = 0; i < 2; i++) {
        ch_slot_header *slot = ch_writer_begin(&w, &error);
        CHECK(slot != NULL);
        ch_writer_commit(&w, slot, &meta);
        t = ch_take_start(CH_TAKE_NEXT);
        CHECK(ch_take_begin(&reader, &t) && ch_take_check(&reader, &t));
        ch_take_accept(&reader, &t);
        CHECK(t.flags == (i ? CH_FLAG_TRUNCATED : CH_FLAG_TRUNCATED | CH_FLAG_FIRST));
        CHECK(t.stamp_lo == 1 && t.stamp_hi == 2 && t.stamp_clock == 3);
        CHECK(t.correlation_lo == 4 && t.correlation_hi == 5);
    }
    CHECK(r.header->writer.truncated == 2);
    CHECK(ch_writer_begin(&w, &error) != NULL);
    ch_writer_refuse(&w, 0);
    CHECK(r.header->writer.refused == 1 && r.header->writer.head == 2);
    CHECK(take(&reader, CH_TAKE_NEXT) == -1);
}

static void test_claims(void)
{
    ch_region r = make_region(4, 8);
    ch_writer one, two;
    ch_reader reader, other;
    int error;
    CHECK(ch_writer_claim(&one, &r, 0, 7, 100, 1) == 0);
    CHECK(ch_writer_claim(&two, &r, 0, 8, 100, 1) == 114);
    publish(&one, 1);
    CHECK(ch_writer_claim(&two, &r, 7, 8, 100, 1) == 0);
    CHECK(two.head == 1); /* M7 */
    CHECK(ch_writer_begin(&one, &error) == NULL && error == 115);
    publish(&two, 2);
    ch_writer_release(&one); /* not its claim any more */
    CHECK(r.header->writer.epoch == 8);
    ch_writer_release(&two);
    CHECK(r.header->writer.epoch == 0);

    ch_reader_observe(&reader, &r, 2);
    ch_reader_observe(&other, &r, 2);
    CHECK(ch_reader_claim(&reader, 1, 0, 5, 50, 1) == 0);
    CHECK(r.header->reader[1].taken == 2 && r.header->reader[1].generation == 33);
    CHECK(ch_reader_claim(&other, 1, 0, 6, 50, 1) == 114);
    CHECK(ch_reader_claim(&other, 1, 5, 6, 50, 1) == 0);
    ch_reader_beat(&reader);
    CHECK(reader.line == NULL); /* goes on as an observer */
    ch_reader_release(&other);
    CHECK(r.header->reader[1].claim == 0);
}

static void test_state_and_layout(void)
{
    ch_region r = make_region(4, 8);
    ch_writer w;
    int error;
    CHECK(ch_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    r.header->identity.state = CH_STATE_RETIRED;
    CHECK(ch_writer_begin(&w, &error) == NULL && error == 111);
    r.header->identity.state = CH_STATE_LIVE;
    r.header->identity.layout_hi++;
    CHECK(ch_writer_begin(&w, &error) == NULL && error == 112);
}

/* A scribble over head costs messages and invents none (M7, M12, M13). */
static void test_scribbled_head(void)
{
    static const uint32_t heads[] = {0,  1,          2,          5,          7,          8,           9, 10, 11,
                                     12, 0x7FFFFFFF, 0x80000005, 0x80000006, 0xFFFFFFFE, 0xFFFFFFFF};
    for (size_t i = 0; i < sizeof heads / sizeof *heads; i++) {
        ch_region r = make_region(4, 8);
        ch_writer w;
        ch_reader newest, in_order;
        uint32_t truth = 6;
        int got;
        CHECK(ch_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
        for (uint32_t s = 1; s <= truth; s++)
            publish(&w, (uint8_t)s);
        ch_reader_observe(&newest, &r, truth);
        ch_reader_observe(&in_order, &r, truth);
        ch_store(&r.header->writer.head, heads[i]);
        /* No message that was taken comes again, and none comes that was not sent. */
        got = take(&newest, CH_TAKE_NEWEST);
        CHECK(got == -1);
        got = take(&in_order, CH_TAKE_NEXT);
        CHECK(got == -1 && in_order.last == truth && in_order.discontinuities == 0 && in_order.lost == 0);
        publish(&w, 7);
        CHECK(w.head == 7 && r.header->writer.head == 7);
        CHECK(take(&newest, CH_TAKE_NEWEST) == 7);
    }
}

/* Half a message is in its slot; no value of head may present it. */
static void test_half_written(void)
{
    for (uint32_t head = 0; head < 40; head++) {
        ch_region r = make_region(4, 8);
        ch_writer w;
        ch_reader reader;
        ch_slot_header *slot;
        int error, got;
        CHECK(ch_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
        for (uint8_t s = 1; s <= 9; s++)
            publish(&w, s);
        slot = ch_writer_begin(&w, &error);
        memset(ch_record(slot), 99, 4); /* and now the writer dies */
        ch_reader_observe(&reader, &r, 0);
        got = take(&reader, CH_TAKE_PEEK);
        CHECK(got == 9);
        ch_store(&r.header->writer.head, head);
        got = take(&reader, CH_TAKE_PEEK);
        CHECK(got == -1 || (got == (int)head && head >= 7 && head <= 9));
        ch_store(&r.header->writer.head, 9);
        CHECK(ch_writer_claim(&w, &r, 7, 8, 100, 1) == 0);
        publish(&w, 10);
        CHECK(take(&reader, CH_TAKE_PEEK) == 10);
    }
}

/* A writer that claims a scribbled head starts another stream; readers find their way into it. */
static void test_jumped_stream(void)
{
    static const uint32_t jumps[] = {7, 8, 9, 100, 0x7FFFFFF0, 0x80000020, 0xFFFFFFF0};
    for (size_t i = 0; i < sizeof jumps / sizeof *jumps; i++) {
        ch_region r = make_region(4, 8);
        ch_writer w;
        ch_reader in_order;
        CHECK(ch_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
        for (uint8_t s = 1; s <= 6; s++)
            publish(&w, s);
        ch_reader_observe(&in_order, &r, 6);
        ch_store(&r.header->writer.head, jumps[i]);
        CHECK(ch_writer_claim(&w, &r, 7, 8, 100, 1) == 0);
        for (uint8_t s = 50; s < 60; s++) {
            publish(&w, s);
            CHECK(take(&in_order, CH_TAKE_NEXT) == s);
        }
        CHECK(take(&in_order, CH_TAKE_NEXT) == -1);
    }
}

/* A writer without fences may be one slot ahead of its head: readers keep away from one slot more (M23). */
static void test_delayed_rule(void)
{
    ch_region r = make_region(4, 8);
    ch_writer w;
    ch_reader reader;
    CHECK(ch_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    publish(&w, 1);
    r.header->writer.rule = CH_DELAYED_RULE;
    ch_reader_observe(&reader, &r, 1);
    for (uint8_t s = 2; s <= 10; s++)
        publish(&w, s);
    CHECK(take(&reader, CH_TAKE_NEXT) == 9);
    CHECK(reader.lost == 7);
    CHECK(take(&reader, CH_TAKE_NEXT) == 10);
    CHECK(take(&reader, CH_TAKE_NEXT) == -1);
}

static void test_latched(void)
{
    ch_region r = make_region(4, 8);
    ch_writer w;
    ch_reader reader;
    CHECK(ch_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    for (uint8_t s = 1; s <= 20; s++)
        publish(&w, s);
    ch_reader_observe(&reader, &r, 0);
    CHECK(take(&reader, CH_TAKE_NEXT) == 18);
    CHECK(reader.lost == 0); /* what was before is none of its business */
    CHECK(take(&reader, CH_TAKE_NEXT) == 19);
    CHECK(take(&reader, CH_TAKE_NEXT) == 20);
    CHECK(take(&reader, CH_TAKE_NEXT) == -1);
}

static void test_identity(void)
{
    ch_region r = make_region(4, 8);
    uint8_t image[512], copy[512];
    ch_identity *id = (ch_identity *)(void *)copy;
    ch_geometry g;
    memcpy(image, r.header, 512);
#define EXPECT(number, size, direction, change) \
    do { \
        memcpy(copy, image, 512); \
        change; \
        CHECK(ch_identity_check(copy, size, direction, &g) == (number)); \
    } while (0)
#define SIGNED(change) \
    do { \
        change; \
        id->identity_crc = ch_identity_crc(copy); \
    } while (0)
    EXPECT(0, 4096, CH_TO_ROS, (void)0);
    EXPECT(103, 511, 0, (void)0);
    EXPECT(104, 4096, 0, id->magic++);
    EXPECT(105, 4096, 0, id->version = 0x20000);
    EXPECT(0, 4096, 0, SIGNED(id->version = 0x10007));
    EXPECT(106, 4096, 0, SIGNED(id->features_required = 1));
    EXPECT(0, 4096, 0, SIGNED(id->features_optional = 0xFFFFFFFF));
    EXPECT(107, 4096, 0, id->generation++);
    EXPECT(108, 4096, 0, id->state = 3);
    EXPECT(108, 4096, 0, id->state = 0);
    EXPECT(108, 4096, 0, SIGNED(id->header_size = 1024));
    EXPECT(108, 4096, 0, SIGNED(id->slot_header_size = 32));
    EXPECT(108, 4096, 0, SIGNED(id->reader_lines = 5));
    EXPECT(108, 4096, 0, SIGNED(id->generation = 0));
    EXPECT(108, 4096, 0, SIGNED(id->slot_count = 0));
    EXPECT(108, 4096, 0, SIGNED(id->slot_count = 2));
    EXPECT(108, 4096, 0, SIGNED(id->slot_count = 5));
    EXPECT(108, 4096, 0, SIGNED(id->slot_count = 0x80000000));
    EXPECT(108, 4096, 0, SIGNED(id->slot_stride = 72));
    EXPECT(108, 4096, 0, SIGNED(id->slot_stride = 64));
    EXPECT(108, 4096, 0, SIGNED(id->slot_stride = 0));
    EXPECT(108, 4096, 0, SIGNED(id->slot_stride = 0xFFFFFFC0));
    EXPECT(108, 4096, 0, SIGNED(id->record_size = 0));
    EXPECT(108, 4096, 0, SIGNED(id->record_size = 65));
    EXPECT(108, 4096, 0, SIGNED(id->record_size = 0xFFFFFFFF));
    EXPECT(108, 4096, 0, SIGNED(id->slots_offset = 1030));
    EXPECT(108, 4096, 0, SIGNED(id->slots_offset = 448));
    EXPECT(108, 4096, 0, SIGNED(id->slots_offset = 0xFFFFFFC0));
    EXPECT(108, 4096, 0, SIGNED(id->object_size--));
    EXPECT(108, 0xFFFFFFFFFF, 0, SIGNED(id->object_size = 0xFFFFFFFF));
    EXPECT(108, 4096, 0, SIGNED(id->description_offset = 511));
    EXPECT(108, 4096, 0, SIGNED(id->description_offset = 0xFFFFFFFF));
    EXPECT(108, 4096, 0, SIGNED(id->description_size = 1));
    EXPECT(108, 4096, 0, SIGNED(id->description_size = 513));
    EXPECT(108, 4096, 0, SIGNED(id->description_size = 0xFFFFFFFF));
    EXPECT(109, r.geometry.object_size - 1, 0, (void)0);
    EXPECT(0, r.geometry.object_size, 0, (void)0);
    EXPECT(110, 4096, CH_TO_PLC, (void)0);
    EXPECT(110, 4096, 0, SIGNED(id->kind = 2));
    EXPECT(110, 4096, 0, SIGNED(id->direction = 3));
    EXPECT(111, 4096, 0, id->state = CH_STATE_RETIRED);
    CHECK(ch_crc32(0, (const uint8_t *)"123456789", 9) == 0xCBF43926u);
}

/* ---------------------------------------------------------------- scribble */

static uint64_t random_state;
static uint32_t random_word(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 16);
}

/* Any word of header and slot headers takes any value, mostly near the true ones; every access stays
 * inside the object (sanitizer, guard page), and what is accepted is never a mixture. */
static void run_scribble(unsigned long rounds, uint64_t seed)
{
    ch_region r = make_region(8, 100), fresh = r;
    ch_writer w;
    ch_reader reader;
    uint8_t first[512];
    unsigned long taken = 0, wrong = 0;
    random_state = seed * 2654435761u + 1;
    memcpy(first, r.header, 512);
    for (unsigned long round = 0; round < rounds; round++) {
        uint32_t *word;
        uint32_t target = random_word() % 136u, near = random_word();
        if (round % 500 == 0) { /* recovery: a new object and new claims */
            r = fresh;
            memset((uint8_t *)r.header + 512, 0, r.geometry.object_size - 512);
            memcpy(r.header, first, 512);
            CHECK(ch_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
            ch_reader_observe(&reader, &r, 0);
            CHECK(ch_reader_claim(&reader, 0, 0, 9, 100, 1) == 0);
            publish(&w, 1);
            CHECK(take(&reader, CH_TAKE_NEXT) == 1);
        }
        word = target < 128u ? (uint32_t *)(void *)r.header + target
                             : (uint32_t *)(void *)ch_slot(&r, target) + near % 16u;
        /* Identity and claim are spared most of the time, or nothing would be left to test. */
        if ((target >= 32u && target != 33u && target != 48u) || near % 64u == 0)
            ch_store(word, near & 1u ? w.head + near % 20u - 10u : random_word());
        for (int mode = CH_TAKE_NEWEST; mode <= CH_TAKE_PEEK; mode++) {
            uint32_t before = reader.lost;
            int got = take(&reader, mode);
            taken += got >= 0;
            wrong += before > reader.lost && reader.lost > 1000000u;
        }
        if (random_word() % 2)
            (void)try_publish(&w, (uint8_t)round); /* 111, 112 and 115 are answers too */
        if (ch_region_check(&r) == 0 && ch_load(&r.header->writer.epoch) == w.epoch && random_word() % 8 == 0) {
            publish(&w, (uint8_t)round);
            CHECK(take(&reader, CH_TAKE_PEEK) == (uint8_t)round); /* one publication heals head */
        }
    }
    CHECK(taken > rounds / 100);
    printf("rounds %lu taken %lu\n", rounds, taken);
}

/* ---------------------------------------------------------------- torn */

static double seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}

static void pin(size_t core)
{
    cpu_set_t set;
    CPU_ZERO(&set);
    CPU_SET(core, &set);
    (void)sched_setaffinity(0, sizeof set, &set);
}

/* Every 64-bit part of message s holds a value of s; a torn one holds two. */
static void fill(uint8_t *record, uint32_t size, uint32_t s)
{
    uint64_t value = s * 0x9E3779B97F4A7C15ull;
    for (uint32_t i = 0; i + 8 <= size; i += 8)
        memcpy(record + i, &value, 8);
}

static int is_torn(const uint8_t *record, uint32_t size, uint32_t s)
{
    uint64_t value = s * 0x9E3779B97F4A7C15ull, found;
    for (uint32_t i = 0; i + 8 <= size; i += 8) {
        memcpy(&found, record + i, 8);
        if (found != value)
            return 1;
    }
    return 0;
}

static int run_torn(double limit, uint32_t size, uint32_t slots, const char *mode, unsigned long wanted)
{
    ch_region r = make_region(slots, size);
    unsigned long reads = 0, accepted = 0, torn = 0, backwards = 0;
    int unchecked = !strcmp(mode, "unchecked");
    int take_mode = !strcmp(mode, "next") ? CH_TAKE_NEXT : CH_TAKE_NEWEST;
    uint8_t *copy = malloc(size), *source = malloc(size);
    double end = seconds() + limit;
    uint32_t last = 0;
    ch_reader reader;
    pid_t writer;
    r.header->writer.head = 0xFFFFFFFFu - 1000u; /* through the wrap */
    writer = fork();
    if (writer == 0) {
        ch_writer w;
        pin(1);
        if (ch_writer_claim(&w, &r, 0, 7, 100, 1))
            _exit(3);
        for (;;) {
            static const ch_meta meta;
            int error;
            ch_slot_header *slot;
            fill(source, size, ch_next(w.head, slots));
            if (!(slot = ch_writer_begin(&w, &error)))
                _exit(4);
            memcpy(ch_record(slot), source, size);
            ch_writer_commit(&w, slot, &meta);
        }
    }
    pin(0);
    ch_reader_observe(&reader, &r, r.header->writer.head);
    while (accepted < wanted && seconds() < end && (!unchecked || torn < 10)) {
        for (int i = 0; i < 200; i++) {
            reads++;
            if (unchecked) {
                uint32_t s = ch_load(&r.header->writer.head);
                ch_fence_acquire();
                memcpy(copy, ch_record(ch_slot(&r, s)), size);
                accepted++;
                torn += (unsigned long)(s != 0xFFFFFFFFu - 1000u && is_torn(copy, size, s));
            } else {
                ch_take t = ch_take_start(take_mode);
                while (ch_take_begin(&reader, &t)) {
                    memcpy(copy, ch_record(t.slot), size);
                    if (ch_take_check(&reader, &t)) {
                        ch_take_accept(&reader, &t);
                        accepted++;
                        torn += (unsigned long)is_torn(copy, size, t.sequence);
                        backwards += last && ch_distance(last, t.sequence, slots) >= CH_DISCONTINUITY;
                        last = t.sequence;
                    }
                }
            }
        }
    }
    kill(writer, SIGKILL);
    waitpid(writer, NULL, 0);
    free(copy);
    free(source);
    CHECK(backwards == 0 && reader.discontinuities == 0);
    printf("reads %lu accepted %lu torn %lu rejected %u lost %u head %u\n", reads, accepted, torn, reader.retries,
           reader.lost, r.header->writer.head);
    return failures || (!unchecked && torn) || accepted == 0;
}

int main(int argc, char **argv)
{
    if (argc == 4 && !strcmp(argv[1], "scribble")) {
        run_scribble(strtoul(argv[2], NULL, 0), strtoull(argv[3], NULL, 0));
        return failures != 0;
    }
    if (argc == 7 && !strcmp(argv[1], "torn"))
        return run_torn(atof(argv[2]), (uint32_t)strtoul(argv[3], NULL, 0), (uint32_t)strtoul(argv[4], NULL, 0),
                        argv[5], strtoul(argv[6], NULL, 0));
    if (argc != 2 || strcmp(argv[1], "logic")) {
        fprintf(stderr, "see the head of channel_test.c\n");
        return 2;
    }
    test_sequences();
    for (uint32_t slots = 4; slots <= 16; slots *= 2) {
        test_stream(slots, 0);
        test_stream(slots, 77);
        for (uint32_t before = 0; before < 3 * slots; before++)
            test_stream(slots, 0xFFFFFFFFu - before);
    }
    test_first_flag_and_counters();
    test_claims();
    test_state_and_layout();
    test_scribbled_head();
    test_half_written();
    test_jumped_stream();
    test_delayed_rule();
    test_latched();
    test_identity();
    printf("%d failures\n", failures);
    return failures != 0;
}
