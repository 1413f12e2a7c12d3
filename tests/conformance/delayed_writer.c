/* A writer under the delayed rule (spec/shm-format.md, section 7.4), from the document's tables: spec_peer.c has fences.
 *
 *   delayed_writer PATH COUNT delayed     publishes COUNT messages
 *   delayed_writer PATH COUNT handover    changes between the delayed rule and fences every twenty messages
 *
 * A record is the message's number in eight bytes, and then the number's lowest byte over and over.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

/* Sections 2, 3 and 5. */
enum { MAGIC = 0, VERSION = 4, STATE = 12, SLOT_COUNT = 32, STRIDE = 36, RECORD_SIZE = 44, SLOTS_OFFSET = 48,
       OBJECT_SIZE = 52, HEAD = 128, EPOCH = 132, BEAT = 136, BEAT_MS = 140, RULE = 152, PID = 160 };
enum { SEQUENCE = 0, LENGTH = 4, FLAGS = 8, STATUS = 12, STAMP_LO = 16, STAMP_HI = 20, STAMP_CLOCK = 24,
       CORRELATION_LO = 32, CORRELATION_HI = 36, RECORD = 64 };

static uint8_t *base;
static uint32_t n, stride, record_size, slots_offset;

static void fail(const char *what, uint32_t a, uint32_t b)
{
    fprintf(stderr, "%s: %" PRIu32 ", %" PRIu32 "\n", what, a, b);
    exit(1);
}

static uint32_t get(const uint8_t *at) { return __atomic_load_n((const uint32_t *)(const void *)at, __ATOMIC_RELAXED); }
static void put(uint8_t *at, uint32_t value) { __atomic_store_n((uint32_t *)(void *)at, value, __ATOMIC_RELAXED); }
static void release(void) { __atomic_thread_fence(__ATOMIC_RELEASE); }
static uint8_t *slot_of(uint32_t s) { return base + slots_offset + (size_t)(s % n) * stride; }

/* Section 7.1. */
static uint32_t next(uint32_t s) { return s < UINT32_MAX ? s + 1 : n; }

static void open_object(const char *path)
{
    struct stat status;
    uint8_t first[512];
    int fd = open(path, O_RDWR | O_NOFOLLOW);
    if (fd < 0 || fstat(fd, &status) || pread(fd, first, 512, 0) != 512)
        fail("101: cannot open", 0, 0);
    if (get(first + MAGIC) != 0x434C5052u || get(first + VERSION) >> 16 != 1 || get(first + STATE) != 1)
        fail("104: not an object that is live", get(first + MAGIC), get(first + STATE));
    n = get(first + SLOT_COUNT);
    stride = get(first + STRIDE);
    record_size = get(first + RECORD_SIZE);
    slots_offset = get(first + SLOTS_OFFSET);
    if (n < 4 || (n & (n - 1)) || stride < 64u + record_size
        || slots_offset + (uint64_t)n * stride > get(first + OBJECT_SIZE)
        || (uint64_t)status.st_size < get(first + OBJECT_SIZE))
        fail("108: inconsistent", n, stride);
    base = mmap(NULL, (size_t)status.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (base == MAP_FAILED)
        fail("102: cannot map", 0, 0);
}

/* ---- section 3 and 7.2, 7.4 */

static uint32_t head; /* private, M7 */

static void fill(uint8_t *slot, uint32_t number)
{
    put(slot + LENGTH, record_size);
    put(slot + FLAGS, number == 1);
    put(slot + STATUS, 0);
    put(slot + STAMP_LO, number);
    put(slot + STAMP_HI, 0);
    put(slot + STAMP_CLOCK, 1);
    put(slot + CORRELATION_LO, 0);
    put(slot + CORRELATION_HI, 0);
    uint64_t counter = number;
    memcpy(slot + RECORD, &counter, 8);
    memset(slot + RECORD + 8, (int)(number & 255), record_size - 8);
}

static void write_fenced(uint32_t from, uint32_t to)
{
    put(base + RULE, 1);
    for (uint32_t number = from; number <= to; number++) {
        uint32_t s = next(head);
        uint8_t *slot = slot_of(s);
        release(); /* F1 */
        put(slot + SEQUENCE, 0);
        release(); /* F5 */
        fill(slot, number);
        release(); /* F6 */
        put(slot + SEQUENCE, s);
        release(); /* F2 */
        put(base + HEAD, s);
        head = s;
        put(base + BEAT, get(base + BEAT) + 1);
        if (number % 64 == 0)
            usleep(100);
    }
}

static void write_delayed(uint32_t from, uint32_t to)
{
    put(base + RULE, 2);
    for (uint32_t number = from; number <= to + 1; number++) {
        if (number > from)
            put(base + HEAD, head = next(head));
        if (number <= to) {
            fill(slot_of(next(head)), number);
            put(slot_of(next(head)) + SEQUENCE, next(head));
        }
        put(base + BEAT, get(base + BEAT) + 1);
        __atomic_thread_fence(__ATOMIC_SEQ_CST); /* the end of a scan */
        if (number % 64 == 0)
            usleep(100);
    }
}

static void write_messages(uint32_t count, const char *rule)
{
    uint32_t mine = (uint32_t)getpid(), free_claim = 0;
    if (!__atomic_compare_exchange_n((uint32_t *)(void *)(base + EPOCH), &free_claim, mine, 0, __ATOMIC_SEQ_CST,
                                     __ATOMIC_RELAXED))
        fail("114: claimed by", free_claim, 0);
    put(base + BEAT_MS, 1000);
    put(base + PID, mine);
    head = get(base + HEAD);
    if (!strcmp(rule, "delayed"))
        write_delayed(1, count);
    for (uint32_t from = 1; strcmp(rule, "delayed") && from <= count; from += 20) {
        uint32_t to = from + 19 < count ? from + 19 : count;
        if (from / 20 % 2)
            write_delayed(from, to);
        else
            write_fenced(from, to);
        __atomic_thread_fence(__ATOMIC_SEQ_CST);
    }
    if (get(base + EPOCH) != mine)
        fail("115: claim lost to", get(base + EPOCH), 0);
    put(base + EPOCH, 0);
}

int main(int count, char **arguments)
{
    if (count != 4)
        return 2;
    open_object(arguments[1]);
    write_messages((uint32_t)strtoul(arguments[2], NULL, 10), arguments[3]);
    return 0;
}
