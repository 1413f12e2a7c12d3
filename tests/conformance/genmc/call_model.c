/* Calls (section 11) with the project's own headers under a checker of C memory models, exhaustively.
 *
 * A caller publishes a call as message FIRST, and another program may act on it:
 *
 *   -DSCENE=1     the caller withdraws the call at once, while the answerer takes it (M26)
 *   -DSCENE=2     an answerer claims line 0 meanwhile (M27): what was published while the claim before was in force
 *                 is not acted on, and where the caller finds a new claim it withdraws the call
 *   -DSCENE=3     both: the answerer before takes the call while the next one claims
 *   -DWITHOUT_F7, -DWITHOUT_F8     takes a fence out: then a violation must be found
 *   -DONE_LOOK=1  the answerer does not look at head again
 *   -DKEPT=1      the caller of scene 2 believes in "not executed" without withdrawing
 */
#include <assert.h>
#include <pthread.h>
#include <stdint.h>

#define ROSPLC_PLAIN
#define ROSPLC_COPY_RECORD(to, from, size) ((void)(to), (void)(from), (void)(size))
#ifdef WITHOUT_F7
#define ROSPLC_F7() ((void)0)
#endif
#ifdef WITHOUT_F8
#define ROSPLC_F8() ((void)0)
#endif

#include <rosplc/channel.h>

#ifndef ONE_LOOK
#define ONE_LOOK 0
#endif
#ifndef KEPT
#define KEPT 0
#endif
#define N 4u
#define STRIDE 128u
#define RECORD 8u
#define START 5u
#define FIRST (START + 1)
#define BEFORE 7u /* the claim of the answerer before */

static uint32_t memory[(ROSPLC_HEADER_SIZE + N * STRIDE) / 4];
static rosplc_region region;
static int executed, executed_by_next, not_executed;

static void publish(rosplc_writer *w, uint32_t status)
{
    rosplc_meta meta;
    uint32_t record[2];
    meta.flags = meta.stamp_lo = meta.stamp_hi = meta.stamp_clock = 0;
    meta.correlation_lo = meta.correlation_hi = meta.reason = 0;
    meta.client[0] = meta.client[1] = meta.client[2] = meta.client[3] = 0;
    meta.status = status;
    (void)rosplc_publish(w, record, &meta);
}

static void *call_thread(void *unused)
{
    rosplc_writer w;
    (void)unused;
    w.region = &region;
    w.epoch = 0;
    w.head = START;
    w.flags = 0;
    publish(&w, ROSPLC_ASK_CALL);
#if SCENE == 2
    ROSPLC_F8();
    if (rosplc_load(&region.header->reader[0].claim) == BEFORE) {
        not_executed = 1; /* by the one that claims later; the one before is not in this scene */
        return NULL;
    }
#elif SCENE == 3
    if (rosplc_load(&region.header->reader[0].claim) == BEFORE)
        return NULL; /* it waits for the answer */
#endif
#if KEPT
    not_executed = rosplc_load(&region.header->reader[0].taken) == START;
#else
    publish(&w, ROSPLC_ASK_CALL | ROSPLC_ASK_WITHDRAWN);
    not_executed = !rosplc_call_begun(&w, FIRST);
#endif
    return NULL;
}

static void act(rosplc_reader *reader, rosplc_take *take, int *done)
{
    uint32_t record[2];
    take->mode = ROSPLC_TAKE_NEWEST;
    take->attempts = ROSPLC_MAX_RETRIES; /* one attempt */
    if (rosplc_take_record(reader, take, record) && (ONE_LOOK || rosplc_call_begin(reader))
        && !(take->status & ROSPLC_ASK_WITHDRAWN))
        *done = 1;
}

#if SCENE != 2
static void *answer_thread(void *unused)
{
    static rosplc_reader reader;
    static rosplc_take take;
    (void)unused;
    reader.region = &region;
    reader.last = START;
    reader.line = &region.header->reader[0];
    reader.claim = BEFORE;
    act(&reader, &take, &executed);
    return NULL;
}
#endif

#if SCENE != 1
static void *claim_thread(void *unused)
{
    static rosplc_reader reader;
    static rosplc_take take;
    (void)unused;
    reader.region = &region;
    if (rosplc_answerer_claim(&reader, BEFORE, 9, 100, 1) == ROSPLC_OK)
        act(&reader, &take, &executed_by_next);
    return NULL;
}
#endif

int main(void)
{
    pthread_t caller;
#if SCENE != 2
    pthread_t answerer;
#endif
#if SCENE != 1
    pthread_t next;
#endif
    region.header = (rosplc_header *)(void *)memory;
    region.geometry.slot_count = N;
    region.geometry.slot_stride = STRIDE;
    region.geometry.slots_offset = ROSPLC_HEADER_SIZE;
    region.geometry.record_size = RECORD;
    rosplc_store(&region.header->identity.state, ROSPLC_STATE_LIVE);
    rosplc_store(&rosplc_slot(&region, START)->sequence, START);
    rosplc_store(&region.header->writer.head, START);
    rosplc_store(&region.header->writer.writer_rule, ROSPLC_RULE_FENCES);
    rosplc_store(&region.header->reader[0].claim, BEFORE);
    rosplc_store(&region.header->reader[0].taken, START);
    pthread_create(&caller, NULL, call_thread, NULL);
#if SCENE != 2
    pthread_create(&answerer, NULL, answer_thread, NULL);
#endif
#if SCENE != 1
    pthread_create(&next, NULL, claim_thread, NULL);
    pthread_join(next, NULL);
#endif
#if SCENE != 2
    pthread_join(answerer, NULL);
#endif
    pthread_join(caller, NULL);
    assert(!(not_executed && (executed || executed_by_next)));
    assert(!(executed && executed_by_next));
    return 0;
}
