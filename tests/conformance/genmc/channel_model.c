/* The project's own reader and writer (rosplc/channel.h) under a checker of C memory models, exhaustively.
 *
 * Two threads share an object of four slots: a writer of MESSAGES messages from head START on, and a reader that
 * has taken START - BEHIND messages. The reader takes once, in order, with ATTEMPTS attempts. Every message has
 * two record words and a stamp that say which one it is, and who wrote it.
 *
 *   -DWRITER=1         with fences, by rosplc_publish
 *   -DWRITER=2         under the delayed rule of section 7.4, which PLC code without a fence follows
 *   -DWRITER=3         the first message with fences, then a hand-over to a writer under the delayed rule
 *   -DWRITER=4         the first messages under the delayed rule, then a hand-over to a writer with fences
 *   -DWITHOUT_F1 ...   takes a fence out: then a violation must be found
 *   -DSCRIBBLE=n       a third thread stores n into head: the case that F5 and F6 alone are there for
 *   -DONE_LOOK=1       the reader looks at writer_rule once only: must be found with WRITER=3
 */
#include <assert.h>
#include <pthread.h>
#include <stdint.h>

#define ROSPLC_PLAIN
#define ROSPLC_COPY_RECORD(to, from, size) copy_words((uint32_t *)(to), (const uint32_t *)(from), (size) / 4)
static void copy_words(uint32_t *to, const uint32_t *from, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++)
        __atomic_store_n(&to[i], __atomic_load_n(&from[i], __ATOMIC_RELAXED), __ATOMIC_RELAXED);
}

#ifdef WITHOUT_F1
#define ROSPLC_F1() ((void)0)
#endif
#ifdef WITHOUT_F2
#define ROSPLC_F2() ((void)0)
#endif
#ifdef WITHOUT_F3
#define ROSPLC_F3() ((void)0)
#endif
#ifdef WITHOUT_F4
#define ROSPLC_F4() ((void)0)
#endif
#ifdef WITHOUT_F5
#define ROSPLC_F5(size) ((void)(size))
#endif
#ifdef WITHOUT_F6
#define ROSPLC_F6(size) ((void)(size))
#endif

#include <rosplc/channel.h>

#ifndef START
#define START 5u
#endif
#ifndef BEHIND
#define BEHIND 2
#endif
#ifndef MESSAGES
#define MESSAGES 3
#endif
#ifndef ATTEMPTS
#define ATTEMPTS 1
#endif
#ifndef ONE_LOOK
#define ONE_LOOK 0
#endif
#define N 4u
#define STRIDE 128u
#define RECORD 8u
#define SCAN_ENDS() __atomic_thread_fence(__ATOMIC_SEQ_CST)

static uint32_t memory[(ROSPLC_HEADER_SIZE + N * STRIDE) / 4];
static rosplc_region region;

static uint32_t name_of(uint32_t sequence, uint32_t writer)
{
    return sequence * 4 + writer;
}

/* The sequence `steps` messages before `s`, for a start after as well as before the wrap. */
static uint32_t before(uint32_t s, uint32_t steps)
{
    return s >= steps + (s >= N && s < N + steps ? N : 0) ? s - steps : s - steps - N;
}

static void fill(rosplc_slot_header *slot, uint32_t sequence, uint32_t writer)
{
    uint32_t *record = (uint32_t *)(void *)rosplc_record(slot);
    rosplc_store(&slot->length, RECORD);
    rosplc_store(&slot->stamp_lo, name_of(sequence, writer));
    rosplc_store(&record[0], name_of(sequence, writer));
    rosplc_store(&record[1], name_of(sequence, writer));
    rosplc_store(&slot->sequence, sequence);
}

static uint32_t write_with_fences(uint32_t head, int messages, uint32_t writer)
{
    rosplc_writer w;
    w.region = &region;
    w.epoch = 0;
    w.head = head;
    w.flags = 0;
    rosplc_store(&region.header->writer.writer_rule, ROSPLC_RULE_FENCES);
    for (int i = 0; i < messages; i++) {
        uint32_t record[2];
        rosplc_meta meta;
        meta.flags = meta.status = meta.stamp_hi = meta.stamp_clock = 0;
        meta.correlation_lo = meta.correlation_hi = 0;
        record[0] = record[1] = meta.stamp_lo = name_of(rosplc_next(w.head, N), writer);
        (void)rosplc_publish(&w, record, &meta);
    }
    return w.head;
}

/* Section 7.4: each scan publishes what the scan before has filled, and fills the next. */
static uint32_t write_delayed(uint32_t head, int messages, uint32_t writer)
{
    rosplc_store(&region.header->writer.writer_rule, ROSPLC_RULE_DELAYED);
    for (int i = 0; i <= messages; i++) {
        if (i > 0) {
            head = rosplc_next(head, N);
            rosplc_store(&region.header->writer.head, head);
        }
        if (i < messages)
            fill(rosplc_slot(&region, rosplc_next(head, N)), rosplc_next(head, N), writer);
        SCAN_ENDS();
    }
    return head;
}

static void *write_thread(void *unused)
{
    uint32_t head = START;
    (void)unused;
#if WRITER == 1
    write_with_fences(head, MESSAGES, 1);
#elif WRITER == 2
    write_delayed(head, MESSAGES, 1);
#elif WRITER == 3
    head = write_with_fences(head, 1, 1);
    SCAN_ENDS();
    write_delayed(head, MESSAGES - 1, 2);
#elif WRITER == 4
    head = write_delayed(head, 1, 1);
    write_with_fences(head, MESSAGES - 1, 2);
#endif
    return NULL;
}

static void *read_thread(void *unused)
{
    /* As rosplc_reader_observe and rosplc_take_start make them: the checker cannot follow their memset. */
    static rosplc_reader reader;
    static rosplc_take take;
    uint32_t record[2];
    (void)unused;
    reader.region = &region;
    reader.last = before(START, BEHIND);
    take.mode = ROSPLC_TAKE_NEXT;
    take.attempts = ROSPLC_MAX_RETRIES + 1 - ATTEMPTS;
    while (rosplc_take_begin(&reader, &take)) {
        ROSPLC_COPY_RECORD(record, rosplc_record(take.slot), RECORD);
#if ONE_LOOK
        ROSPLC_F4();
        if (rosplc_distance(take.sequence, rosplc_load(&region.header->writer.head), N) <= take.window
            && rosplc_load(&take.slot->sequence) == take.sequence) {
#else
        if (rosplc_take_check(&reader, &take)) {
#endif
            assert(record[0] == record[1]);
            assert(record[0] == take.stamp_lo);
            assert(record[0] / 4 == (take.sequence & 0x3FFFFFFFu));
            return NULL;
        }
    }
    return NULL;
}

#ifdef SCRIBBLE
static void *scribble_thread(void *unused)
{
    (void)unused;
    rosplc_store(&region.header->writer.head, SCRIBBLE);
    return NULL;
}
#endif

int main(void)
{
    pthread_t writer, reader;
    region.header = (rosplc_header *)(void *)memory;
    region.geometry.slot_count = N;
    region.geometry.slot_stride = STRIDE;
    region.geometry.slots_offset = ROSPLC_HEADER_SIZE;
    region.geometry.record_size = RECORD;
    rosplc_store(&region.header->identity.state, ROSPLC_STATE_LIVE);
    for (uint32_t back = N; back-- > 0;)
        fill(rosplc_slot(&region, before(START, back)), before(START, back), 0);
    rosplc_store(&region.header->writer.head, START);
    rosplc_store(&region.header->writer.writer_rule,
                 WRITER == 2 || WRITER == 4 ? ROSPLC_RULE_DELAYED : ROSPLC_RULE_FENCES);
    pthread_create(&writer, NULL, write_thread, NULL);
    pthread_create(&reader, NULL, read_thread, NULL);
#ifdef SCRIBBLE
    pthread_t scribbler;
    pthread_create(&scribbler, NULL, scribble_thread, NULL);
    pthread_join(scribbler, NULL);
#endif
    pthread_join(writer, NULL);
    pthread_join(reader, NULL);
    return 0;
}
