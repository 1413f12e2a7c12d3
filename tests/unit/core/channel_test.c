/* Tests of channel.h without Python: compiled natively, with sanitizers, and for ARM under qemu.
 *
 *   channel_test logic                     sequences, identity, windows, losses, claims
 *   channel_test scribble ROUNDS SEED      random bytes over every control word; no access leaves the object
 *   channel_test torn SECONDS BYTES SLOTS MODE MESSAGES
 *       one process writes flat out, another reads; prints "reads accepted torn rejected".
 *       MODE checked | next | unchecked: the last leaves M12 out and must see torn messages.
 *   channel_test withdrawn CALLS           one process withdraws each of its calls at once, another carries them out;
 *       prints "calls executed both", the last those that were executed and reported as not executed
 */
#define _GNU_SOURCE
#include <rosplc/channel.h>

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

static rosplc_region make_region(uint32_t slots, uint32_t record)
{
    uint32_t stride = (ROSPLC_SLOT_HEADER_SIZE + record + 63u) / 64u * 64u;
    uint32_t size = 1024u + slots * stride;
    rosplc_region r;
    rosplc_identity *id;
    /* One page more, without access: whoever leaves the object is caught even without sanitizers. */
    size_t page = (size_t)sysconf(_SC_PAGESIZE), room = (size + page - 1) / page * page;
    uint8_t *base = mmap(NULL, room + page, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (base == MAP_FAILED || mprotect(base + room, page, PROT_NONE)) {
        perror("mmap");
        exit(2);
    }
    base += (room - size) / 64u * 64u; /* the object's end as near to the guard as its lines allow */
    id = (rosplc_identity *)(void *)base;
    *id = (rosplc_identity){.magic = ROSPLC_MAGIC,
                        .version = ROSPLC_VERSION,
                        .header_size = ROSPLC_HEADER_SIZE,
                        .state = ROSPLC_STATE_LIVE,
                        .kind = ROSPLC_KIND_TOPIC,
                        .direction = ROSPLC_TO_ROS,
                        .slot_count = slots,
                        .slot_stride = stride,
                        .slot_header_size = ROSPLC_SLOT_HEADER_SIZE,
                        .record_size = record,
                        .slots_offset = 1024,
                        .object_size = size,
                        .description_offset = 512,
                        .description_size = 2,
                        .layout_id_lo = 11,
                        .layout_id_hi = 22,
                        .generation = 33,
                        .reader_lines = ROSPLC_READER_LINES};
    id->identity_crc = rosplc_identity_crc(base);
    CHECK(rosplc_identity_check(base, size, ROSPLC_TO_ROS, &r.geometry) == 0);
    r.header = (rosplc_header *)(void *)base;
    return r;
}

static int try_publish(rosplc_writer *w, uint8_t value)
{
    static const rosplc_meta meta;
    rosplc_error error;
    rosplc_slot_header *slot = rosplc_writer_begin(w, &error);
    if (!slot)
        return -(int)error;
    memset(rosplc_record(slot), value, w->region->geometry.record_size);
    rosplc_writer_commit(w, slot, &meta);
    return 1;
}

static void publish(rosplc_writer *w, uint8_t value)
{
    CHECK(try_publish(w, value) == 1);
}

/* The first byte of the message taken, -1 if none; a mixture of bytes counts as a failure. */
static int take(rosplc_reader *reader, int mode)
{
    rosplc_take t = rosplc_take_start(mode);
    int result = -1;
    while (rosplc_take_begin(reader, &t)) {
        uint8_t copy[256];
        uint32_t size = reader->region->geometry.record_size;
        memcpy(copy, rosplc_record(t.slot), size);
        if (rosplc_take_check(reader, &t)) {
            rosplc_take_accept(reader, &t);
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
    CHECK(rosplc_next(0, 4) == 1);
    CHECK(rosplc_next(1, 4) == 2);
    CHECK(rosplc_next(0xFFFFFFFEu, 4) == 0xFFFFFFFFu);
    CHECK(rosplc_next(0xFFFFFFFFu, 4) == 4);
    CHECK(rosplc_next(0xFFFFFFFFu, 65536) == 65536);
    CHECK((0xFFFFFFFFu & 3u) == 3 && (rosplc_next(0xFFFFFFFFu, 4) & 3u) == 0);
    CHECK(rosplc_distance(5, 5, 4) == 0);
    CHECK(rosplc_distance(5, 9, 4) == 4);
    CHECK(rosplc_distance(0xFFFFFFFFu, 4, 4) == 1);
    CHECK(rosplc_distance(0xFFFFFFFEu, 5, 4) == 3);
    CHECK(rosplc_distance(9, 8, 4) >= ROSPLC_DISCONTINUITY);
    CHECK(rosplc_distance(0xFFFFFFFFu, 0, 4) >= ROSPLC_DISCONTINUITY);
    for (uint32_t n = 4; n <= 64; n *= 2) {
        uint32_t s = 0xFFFFFFFFu - 100, steps = 0;
        for (uint32_t t = s; steps < 300; steps++, t = rosplc_next(t, n)) {
            CHECK(rosplc_distance(s, t, n) == steps);
            CHECK(rosplc_advance(s, steps, n) == t);
            CHECK(t >= n || t > s);
        }
    }
}

/* Two slots' worth of messages on each side of `start`, read in all three ways. */
static void test_stream(uint32_t slots, uint32_t start)
{
    rosplc_region r = make_region(slots, 40);
    rosplc_writer w;
    rosplc_reader in_order, newest, slow;
    uint32_t missed = 3 * slots;
    r.header->writer.head = start;
    CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    rosplc_reader_observe(&in_order, &r, start);
    rosplc_reader_observe(&newest, &r, start);
    rosplc_reader_observe(&slow, &r, start);
    for (int i = 0; i < (int)(4 * slots); i++) {
        CHECK(take(&in_order, ROSPLC_TAKE_NEXT) == -1);
        publish(&w, (uint8_t)i);
        CHECK(take(&in_order, ROSPLC_TAKE_NEXT) == (uint8_t)i);
        CHECK(take(&in_order, ROSPLC_TAKE_PEEK) == (uint8_t)i);
        CHECK(take(&newest, ROSPLC_TAKE_NEWEST) == (uint8_t)i);
    }
    CHECK(in_order.lost == 0 && newest.lost == 0 && in_order.discontinuities == 0);
    /* `slow` has slept through 4N messages; N-1 are left. */
    for (uint32_t i = 0; i < slots - 1; i++)
        CHECK(take(&slow, ROSPLC_TAKE_NEXT) == (uint8_t)(missed + i + 1));
    CHECK(take(&slow, ROSPLC_TAKE_NEXT) == -1);
    CHECK(slow.lost == (start ? 4 * slots - (slots - 1) : 0)); /* before a first message lies no loss */
    CHECK(slow.last == w.head && slow.discontinuities == 0);
}

static void test_first_flag_and_counters(void)
{
    rosplc_region r = make_region(4, 8);
    rosplc_writer w;
    rosplc_reader reader;
    rosplc_take t;
    rosplc_meta meta = {ROSPLC_FLAG_TRUNCATED, 0, 1, 2, 3, 4, 5, {0}, 0};
    rosplc_error error;
    CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    rosplc_reader_observe(&reader, &r, 0);
    for (int i = 0; i < 2; i++) {
        rosplc_slot_header *slot = rosplc_writer_begin(&w, &error);
        CHECK(slot != NULL);
        rosplc_writer_commit(&w, slot, &meta);
        t = rosplc_take_start(ROSPLC_TAKE_NEXT);
        CHECK(rosplc_take_begin(&reader, &t) && rosplc_take_check(&reader, &t));
        rosplc_take_accept(&reader, &t);
        CHECK(t.flags == (i ? ROSPLC_FLAG_TRUNCATED : ROSPLC_FLAG_TRUNCATED | ROSPLC_FLAG_FIRST));
        CHECK(t.stamp_lo == 1 && t.stamp_hi == 2 && t.stamp_clock == 3);
        CHECK(t.correlation_lo == 4 && t.correlation_hi == 5);
    }
    CHECK(r.header->writer.truncated == 2);
    CHECK(rosplc_writer_begin(&w, &error) != NULL);
    rosplc_writer_refuse(&w, 0);
    CHECK(r.header->writer.refused == 1 && r.header->writer.head == 2);
    CHECK(take(&reader, ROSPLC_TAKE_NEXT) == -1);
}

static void test_claims(void)
{
    rosplc_region r = make_region(4, 8);
    rosplc_writer one, two;
    rosplc_reader reader, other;
    rosplc_error error;
    CHECK(rosplc_writer_claim(&one, &r, 0, 7, 100, 1) == 0);
    CHECK(rosplc_writer_claim(&two, &r, 0, 8, 100, 1) == 114);
    publish(&one, 1);
    CHECK(rosplc_writer_claim(&two, &r, 7, 8, 100, 1) == 0);
    CHECK(two.head == 1); /* M7 */
    CHECK(rosplc_writer_begin(&one, &error) == NULL && error == 115);
    publish(&two, 2);
    rosplc_writer_release(&one); /* not its claim any more */
    CHECK(r.header->writer.writer_epoch == 8);
    rosplc_writer_release(&two);
    CHECK(r.header->writer.writer_epoch == 0);

    rosplc_reader_observe(&reader, &r, 2);
    rosplc_reader_observe(&other, &r, 2);
    CHECK(rosplc_reader_claim(&reader, 1, 0, 5, 50, 1) == 0);
    CHECK(r.header->reader[1].taken == 2 && r.header->reader[1].generation == 33);
    CHECK(rosplc_reader_claim(&other, 1, 0, 6, 50, 1) == 114);
    CHECK(rosplc_reader_claim(&other, 1, 5, 6, 50, 1) == 0);
    rosplc_reader_beat(&reader);
    CHECK(reader.line == NULL); /* goes on as an observer */
    rosplc_reader_release(&other);
    CHECK(r.header->reader[1].claim == 0);
}

static void test_state_and_layout(void)
{
    rosplc_region r = make_region(4, 8);
    rosplc_writer w;
    rosplc_error error;
    CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    r.header->identity.state = ROSPLC_STATE_RETIRED;
    CHECK(rosplc_writer_begin(&w, &error) == NULL && error == 111);
    r.header->identity.state = ROSPLC_STATE_LIVE;
    r.header->identity.layout_id_hi++;
    CHECK(rosplc_writer_begin(&w, &error) == NULL && error == 112);
}

/* A scribble over head costs messages and invents none (M7, M12, M13). */
static void test_scribbled_head(void)
{
    static const uint32_t heads[] = {0,  1,          2,          5,          7,          8,           9, 10, 11,
                                     12, 0x7FFFFFFF, 0x80000005, 0x80000006, 0xFFFFFFFE, 0xFFFFFFFF};
    for (size_t i = 0; i < sizeof heads / sizeof *heads; i++) {
        rosplc_region r = make_region(4, 8);
        rosplc_writer w;
        rosplc_reader newest, in_order;
        uint32_t truth = 6;
        int got;
        CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
        for (uint32_t s = 1; s <= truth; s++)
            publish(&w, (uint8_t)s);
        rosplc_reader_observe(&newest, &r, truth);
        rosplc_reader_observe(&in_order, &r, truth);
        rosplc_store(&r.header->writer.head, heads[i]);
        /* No message that was taken comes again, and none comes that was not sent. */
        got = take(&newest, ROSPLC_TAKE_NEWEST);
        CHECK(got == -1);
        got = take(&in_order, ROSPLC_TAKE_NEXT);
        CHECK(got == -1 && in_order.last == truth && in_order.discontinuities == 0 && in_order.lost == 0);
        publish(&w, 7);
        CHECK(w.head == 7 && r.header->writer.head == 7);
        CHECK(take(&newest, ROSPLC_TAKE_NEWEST) == 7);
    }
}

/* Half a message is in its slot; no value of head may present it. */
static void test_half_written(void)
{
    for (uint32_t head = 0; head < 40; head++) {
        rosplc_region r = make_region(4, 8);
        rosplc_writer w;
        rosplc_reader reader;
        rosplc_slot_header *slot;
        rosplc_error error;
        int got;
        CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
        for (uint8_t s = 1; s <= 9; s++)
            publish(&w, s);
        slot = rosplc_writer_begin(&w, &error);
        memset(rosplc_record(slot), 99, 4); /* and now the writer dies */
        rosplc_reader_observe(&reader, &r, 0);
        got = take(&reader, ROSPLC_TAKE_PEEK);
        CHECK(got == 9);
        rosplc_store(&r.header->writer.head, head);
        got = take(&reader, ROSPLC_TAKE_PEEK);
        CHECK(got == -1 || (got == (int)head && head >= 7 && head <= 9));
        rosplc_store(&r.header->writer.head, 9);
        CHECK(rosplc_writer_claim(&w, &r, 7, 8, 100, 1) == 0);
        publish(&w, 10);
        CHECK(take(&reader, ROSPLC_TAKE_PEEK) == 10);
    }
}

/* A writer that claims a scribbled head starts another stream; readers find their way into it. */
static void test_jumped_stream(void)
{
    static const uint32_t jumps[] = {7, 8, 9, 100, 0x7FFFFFF0, 0x80000020, 0xFFFFFFF0};
    for (size_t i = 0; i < sizeof jumps / sizeof *jumps; i++) {
        rosplc_region r = make_region(4, 8);
        rosplc_writer w;
        rosplc_reader in_order;
        CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
        for (uint8_t s = 1; s <= 6; s++)
            publish(&w, s);
        rosplc_reader_observe(&in_order, &r, 6);
        rosplc_store(&r.header->writer.head, jumps[i]);
        CHECK(rosplc_writer_claim(&w, &r, 7, 8, 100, 1) == 0);
        for (uint8_t s = 50; s < 60; s++) {
            publish(&w, s);
            CHECK(take(&in_order, ROSPLC_TAKE_NEXT) == s);
        }
        CHECK(take(&in_order, ROSPLC_TAKE_NEXT) == -1);
    }
}

/* A writer without fences may be one slot ahead of its head: readers keep away from one slot more (M23). */
static void test_delayed_rule(void)
{
    rosplc_region r = make_region(4, 8);
    rosplc_writer w;
    rosplc_reader reader;
    CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    publish(&w, 1);
    r.header->writer.writer_rule = ROSPLC_RULE_DELAYED;
    rosplc_reader_observe(&reader, &r, 1);
    for (uint8_t s = 2; s <= 10; s++)
        publish(&w, s);
    CHECK(take(&reader, ROSPLC_TAKE_NEXT) == 9);
    CHECK(reader.lost == 7);
    CHECK(take(&reader, ROSPLC_TAKE_NEXT) == 10);
    CHECK(take(&reader, ROSPLC_TAKE_NEXT) == -1);
}

/* A writer under the delayed rule that takes over during a copy: the smaller of the two windows counts (M23). */
static void test_handover_to_the_delayed_rule(void)
{
    for (int takes_over = 0; takes_over < 2; takes_over++) {
        rosplc_region r = make_region(4, 8);
        rosplc_writer w;
        rosplc_reader reader;
        rosplc_take t = rosplc_take_start(ROSPLC_TAKE_NEXT);
        CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
        for (uint8_t s = 1; s <= 3; s++)
            publish(&w, s);
        rosplc_reader_observe(&reader, &r, 1);
        CHECK(rosplc_take_begin(&reader, &t) && t.sequence == 2);
        publish(&w, 4);
        if (takes_over)
            r.header->writer.writer_rule = ROSPLC_RULE_DELAYED;
        CHECK(rosplc_take_check(&reader, &t) == !takes_over);
    }
}

static void test_latched(void)
{
    rosplc_region r = make_region(4, 8);
    rosplc_writer w;
    rosplc_reader reader;
    CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    for (uint8_t s = 1; s <= 20; s++)
        publish(&w, s);
    rosplc_reader_observe(&reader, &r, 0);
    CHECK(take(&reader, ROSPLC_TAKE_NEXT) == 18);
    CHECK(reader.lost == 0); /* what was before is none of its business */
    CHECK(take(&reader, ROSPLC_TAKE_NEXT) == 19);
    CHECK(take(&reader, ROSPLC_TAKE_NEXT) == 20);
    CHECK(take(&reader, ROSPLC_TAKE_NEXT) == -1);
}

static void test_identity(void)
{
    rosplc_region r = make_region(4, 8);
    uint8_t image[512], copy[512];
    rosplc_identity *id = (rosplc_identity *)(void *)copy;
    rosplc_geometry g;
    memcpy(image, r.header, 512);
#define EXPECT(number, size, direction, change) \
    do { \
        memcpy(copy, image, 512); \
        change; \
        CHECK(rosplc_identity_check(copy, size, direction, &g) == (number)); \
    } while (0)
#define SIGNED(change) \
    do { \
        change; \
        id->identity_crc = rosplc_identity_crc(copy); \
    } while (0)
    EXPECT(0, 4096, ROSPLC_TO_ROS, (void)0);
    EXPECT(110, 4096, 0, SIGNED(id->kind = ROSPLC_KIND_GOAL));
    CHECK(rosplc_identity_check_kind(copy, 4096, ROSPLC_KIND_GOAL, 0, &g) == 0 && g.kind == ROSPLC_KIND_GOAL);
    CHECK(rosplc_identity_check_kind(copy, 4096, 0, 0, &g) == 0);
    CHECK(rosplc_identity_check_kind(copy, 4096, ROSPLC_KIND_RESULT, 0, &g) == 110);
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
    EXPECT(110, 4096, ROSPLC_TO_PLC, (void)0);
    EXPECT(110, 4096, 0, SIGNED(id->kind = 2));
    EXPECT(110, 4096, 0, SIGNED(id->direction = 3));
    EXPECT(111, 4096, 0, id->state = ROSPLC_STATE_RETIRED);
    CHECK(rosplc_crc32(0, (const uint8_t *)"123456789", 9) == 0xCBF43926u);
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
    rosplc_region r = make_region(8, 100), fresh = r;
    rosplc_writer w;
    rosplc_reader reader;
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
            CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
            rosplc_reader_observe(&reader, &r, 0);
            CHECK(rosplc_reader_claim(&reader, 0, 0, 9, 100, 1) == 0);
            publish(&w, 1);
            CHECK(take(&reader, ROSPLC_TAKE_NEXT) == 1);
        }
        word = target < 128u ? (uint32_t *)(void *)r.header + target
                             : (uint32_t *)(void *)rosplc_slot(&r, target) + near % 16u;
        /* Identity and claim are spared most of the time, or nothing would be left to test. */
        if ((target >= 32u && target != 33u && target != 48u) || near % 64u == 0)
            rosplc_store(word, near & 1u ? w.head + near % 20u - 10u : random_word());
        for (int mode = ROSPLC_TAKE_NEWEST; mode <= ROSPLC_TAKE_PEEK; mode++) {
            uint32_t before = reader.lost;
            int got = take(&reader, mode);
            taken += got >= 0;
            wrong += before > reader.lost && reader.lost > 1000000u;
        }
        if (random_word() % 2)
            (void)try_publish(&w, (uint8_t)round); /* 111, 112 and 115 are answers too */
        if (rosplc_region_check(&r) == 0 && rosplc_load(&r.header->writer.writer_epoch) == w.epoch && random_word() % 8 == 0) {
            publish(&w, (uint8_t)round);
            CHECK(take(&reader, ROSPLC_TAKE_PEEK) == (uint8_t)round); /* one publication heals head */
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
    rosplc_region r = make_region(slots, size);
    unsigned long reads = 0, accepted = 0, torn = 0, backwards = 0;
    int unchecked = !strcmp(mode, "unchecked");
    int take_mode = !strcmp(mode, "next") ? ROSPLC_TAKE_NEXT : ROSPLC_TAKE_NEWEST;
    uint8_t *copy = malloc(size), *source = malloc(size);
    double end = seconds() + limit;
    uint32_t last = 0;
    rosplc_reader reader;
    pid_t writer;
    r.header->writer.head = 0xFFFFFFFFu - 1000u; /* through the wrap */
    writer = fork();
    if (writer == 0) {
        rosplc_writer w;
        pin(1);
        if (rosplc_writer_claim(&w, &r, 0, 7, 100, 1))
            _exit(3);
        for (;;) {
            static const rosplc_meta meta;
            rosplc_error error;
            rosplc_slot_header *slot;
            fill(source, size, rosplc_next(w.head, slots));
            if (!(slot = rosplc_writer_begin(&w, &error)))
                _exit(4);
            memcpy(rosplc_record(slot), source, size);
            rosplc_writer_commit(&w, slot, &meta);
        }
    }
    pin(0);
    rosplc_reader_observe(&reader, &r, r.header->writer.head);
    while (accepted < wanted && seconds() < end && (!unchecked || torn < 10)) {
        for (int i = 0; i < 200; i++) {
            reads++;
            if (unchecked) {
                uint32_t s = rosplc_load(&r.header->writer.head);
                rosplc_fence_acquire();
                memcpy(copy, rosplc_record(rosplc_slot(&r, s)), size);
                accepted++;
                torn += (unsigned long)(s != 0xFFFFFFFFu - 1000u && is_torn(copy, size, s));
            } else {
                rosplc_take t = rosplc_take_start(take_mode);
                while (rosplc_take_begin(&reader, &t)) {
                    memcpy(copy, rosplc_record(t.slot), size);
                    if (rosplc_take_check(&reader, &t)) {
                        rosplc_take_accept(&reader, &t);
                        accepted++;
                        torn += (unsigned long)is_torn(copy, size, t.sequence);
                        backwards += last && rosplc_distance(last, t.sequence, slots) >= ROSPLC_DISCONTINUITY;
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

/* M26 and M27: what a new answerer takes, and what it may act on. */
static void test_calls(void)
{
    rosplc_region r = make_region(4, 8);
    rosplc_writer w;
    rosplc_reader first, second;
    CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    publish(&w, 1);
    r.header->reader[0].taken = 9;
    rosplc_reader_observe(&first, &r, 0);
    CHECK(rosplc_answerer_claim(&first, 0, 5, 50, 1) == 0);
    CHECK(first.last == 1 && r.header->reader[0].taken == 9 && r.header->reader[0].generation == 33);
    CHECK(take(&first, ROSPLC_TAKE_NEWEST) == -1);
    publish(&w, 2);
    CHECK(!rosplc_call_begun(&w, 10) && rosplc_call_begun(&w, 9));
    CHECK(take(&first, ROSPLC_TAKE_NEWEST) == 2 && rosplc_call_begin(&first));
    CHECK(rosplc_call_begun(&w, 2) && !rosplc_call_begun(&w, 3));
    publish(&w, 3);
    CHECK(!rosplc_call_begin(&first));
    CHECK(take(&first, ROSPLC_TAKE_NEWEST) == 3 && rosplc_call_begin(&first));
    rosplc_reader_observe(&second, &r, 0);
    CHECK(rosplc_answerer_claim(&second, 0, 6, 50, 1) == 114);
    CHECK(rosplc_answerer_claim(&second, 5, 6, 50, 1) == 0);
    CHECK(second.last == 3 && !rosplc_call_begin(&first) && rosplc_call_begin(&second));
    r.header->identity.state = ROSPLC_STATE_RETIRED;
    CHECK(!rosplc_call_begin(&second));
}

static int run_withdrawn(uint32_t calls)
{
    rosplc_region r = make_region(4, 8);
    uint32_t *executed = mmap(NULL, (calls + 1) * sizeof *executed, PROT_READ | PROT_WRITE,
                              MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    uint8_t *refused = calloc(calls + 1, 1);
    unsigned long acted = 0, both = 0;
    rosplc_writer w;
    pid_t answerer;
    CHECK(rosplc_writer_claim(&w, &r, 0, 7, 100, 1) == 0);
    answerer = fork();
    if (answerer == 0) {
        rosplc_reader reader;
        uint8_t record[8];
        pin(1);
        rosplc_reader_observe(&reader, &r, 0);
        if (rosplc_answerer_claim(&reader, 0, 5, 100, 1))
            _exit(3);
        for (;;) {
            rosplc_take t = rosplc_take_start(ROSPLC_TAKE_NEWEST);
            if (rosplc_take_record(&reader, &t, record) && rosplc_call_begin(&reader)
                && !(t.status & ROSPLC_ASK_WITHDRAWN))
                rosplc_store(&executed[t.correlation_lo], 1);
        }
    }
    pin(0);
    while (rosplc_load(&r.header->reader[0].claim) != 5)
        sched_yield();
    for (uint32_t call = 1; call <= calls; call++) {
        static const uint8_t record[8];
        rosplc_meta meta = {.status = ROSPLC_ASK_CALL, .correlation_lo = call};
        CHECK(rosplc_publish(&w, record, &meta) == ROSPLC_OK);
        meta.status |= ROSPLC_ASK_WITHDRAWN;
        for (volatile uint32_t pause = random_word() % 1024u; pause; pause--)
            ;
        while (call % 4096u == 1 && !rosplc_load(&executed[call])) /* so that some are, on one core too */
            sched_yield();
        uint32_t first = w.head;
        CHECK(rosplc_publish(&w, record, &meta) == ROSPLC_OK);
        refused[call] = (uint8_t)!rosplc_call_begun(&w, first);
    }
    while (rosplc_load(&r.header->reader[0].taken) != w.head)
        sched_yield();
    kill(answerer, SIGKILL);
    waitpid(answerer, NULL, 0);
    for (uint32_t call = 1; call <= calls; call++) {
        acted += executed[call];
        both += executed[call] && refused[call];
    }
    free(refused);
    printf("calls %u executed %lu both %lu\n", calls, acted, both);
    return failures || both;
}

int main(int argc, char **argv)
{
    if (argc == 3 && !strcmp(argv[1], "withdrawn"))
        return run_withdrawn((uint32_t)strtoul(argv[2], NULL, 0));
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
    test_handover_to_the_delayed_rule();
    test_latched();
    test_identity();
    test_calls();
    printf("%d failures\n", failures);
    return failures != 0;
}
