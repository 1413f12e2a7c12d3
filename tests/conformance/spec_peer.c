/* spec_peer: a reader and a writer of the shared-memory format, written from spec/shm-format.md and its vectors alone.
 *
 *   spec_peer read PATH COUNT SECONDS [latched]       every message, in order; an object of either direction
 *   spec_peer write PATH COUNT INTERVAL_US [FIRST]    an object towards ROS
 *   spec_peer take PATH ORDER LAST [LO:HI SIZE DIRECTION]  what one reader of a vector takes, a line per message (for tests)
 *
 * Its author had read the document and the vectors, and nothing else of the project; keep it so: a change of this file
 * follows a change of the document, never one of the product. A record is a counter in eight bytes, and then the counter's
 * lowest byte over and over. Rule numbers (M..) and sections are those of shm-format.md. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>
#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "section 1: every number is little-endian; this program does not swap"
#endif

enum { HEAD = 128, EPOCH = 132, BEAT = 136, BEAT_MS = 140, REFUSED = 144, TRUNCATED = 148, RULE = 152, SOURCES = 156,
       WRITER_PID = 160, WRITER_ERROR = 164, LINES = 192 };                          /* section 3, 4 */
enum { L_CLAIM = 0, L_BEAT = 4, L_BEAT_MS = 8, L_TAKEN = 12, L_LAYOUT = 16, L_LOST = 24, L_RETRIES = 28,
       L_GENERATION = 32, L_ERROR = 36, L_SINKS = 40, L_PID = 44, L_TASK = 48 };
enum { MY_BEAT_MS = 500, ATTEMPTS = 4 /* M12: one, and three repetitions */ };

/* The validated private copy (M3); ring geometry and lengths come from here only. */
struct object {
    unsigned char *map;
    int writable, expect_record, expect_layout;
    uint32_t direction, n, stride, record, slots, size, layout_lo, layout_hi, generation;
};
static volatile sig_atomic_t stopped;
static void on_signal(int number) { stopped = number; }

static uint32_t ld(const struct object *o, uint32_t at)
{
    return __atomic_load_n((uint32_t *)(void *)(o->map + at), __ATOMIC_RELAXED);
}
static void st(const struct object *o, uint32_t at, uint32_t value)
{
    __atomic_store_n((uint32_t *)(void *)(o->map + at), value, __ATOMIC_RELAXED);
}
static int cas(const struct object *o, uint32_t at, uint32_t from, uint32_t to)
{
    return __atomic_compare_exchange_n((uint32_t *)(void *)(o->map + at), &from, to, 0, __ATOMIC_SEQ_CST,
                                       __ATOMIC_RELAXED);
}
static int64_t now_us(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return (int64_t)t.tv_sec * 1000000 + t.tv_nsec / 1000;
}
static void pause_us(int64_t us)
{
    struct timespec t = {us / 1000000, us % 1000000 * 1000};
    if (us > 0) nanosleep(&t, NULL);
}
static uint32_t random_word(void)
{
    uint32_t r = 0;
    while (r == 0)
        if (getentropy(&r, sizeof r) != 0) abort();
    return r;
}

/* ---- section 9: validation; the number of the first check that fails, 0 if none does ---- */
static const char *words_of(int error)
{
    static const struct { int number; const char *words; } text[] = {
        {101, "the object does not exist"}, {121, "it is no plain file"}, {102, "it may not be opened"},
        {103, "it has less than 512 bytes"}, {104, "magic differs"}, {105, "version's major is not 1"},
        {106, "features_required has an unknown bit"}, {107, "identity_crc differs"}, {108, "a size or word of the identity is not valid"},
        {109, "the object is smaller than object_size"}, {110, "kind or direction is not the expected one"},
        {111, "state is not LIVE"}, {112, "layout_id or record_size is not the expected one"},
        {114, "the claim is held by another writer"}, {115, "the claim was taken over"}};
    for (size_t i = 0; i < sizeof text / sizeof *text; i++)
        if (text[i].number == error) return text[i].words;
    return "unknown";
}
static uint32_t crc_of(uint32_t crc, const unsigned char *p, size_t size) /* CRC-32/ISO-HDLC, chained as zlib's */
{
    for (crc = ~crc; size--; p++) {
        crc ^= *p;
        for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}
static int judge(const uint32_t *w, uint64_t file_size, struct object *o) /* w: a copy of lines 0 and 1 */
{
    const unsigned char *b = (const void *)w;
    if (w[0] != 0x434C5052u) return 104;
    if (w[1] >> 16 != 1) return 105;
    if (w[4] != 0) return 106;
    if (w[27] != crc_of(crc_of(0, b, 12), b + 16, 92)) return 107;
    uint32_t header = w[2], state = w[3], n = w[8], stride = w[9], slot_header = w[10], record = w[11], slots = w[12],
             size = w[13], d_at = w[14], d_size = w[15];
    if (header != 512 || slot_header != 64 || w[26] != 4 || (state != 1 && state != 2) || w[18] == 0) return 108;
    if (n < 4 || n > 65536 || (n & (n - 1)) || record < 1 || record > 1u << 30) return 108;
    if (stride % 64 || stride < (uint64_t)slot_header + record || d_at < header || d_size < 2 || d_size > 1u << 20) return 108;
    if (slots % 64 || slots < (uint64_t)d_at + d_size || size > 0x7FFFFFFFu) return 108;
    if (size < slots + (uint64_t)n * stride) return 108;
    if (file_size < size) return 109;
    if (w[6] != 1 || (w[7] != 1 && w[7] != 2) || (o->direction && w[7] != o->direction)) return 110;
    if (state != 1) return 111;
    if (o->expect_record && record != o->record) return 112;
    if (o->expect_layout && (w[16] != o->layout_lo || w[17] != o->layout_hi)) return 112;
    o->direction = w[7], o->n = n, o->stride = stride, o->record = record, o->slots = slots, o->size = size;
    o->layout_lo = w[16], o->layout_hi = w[17], o->generation = w[18];
    o->expect_record = o->expect_layout = 1; /* opened again, it must be the same */
    return 0;
}
/* Opens and maps. On entry *o says what is expected: direction (0: any), record and layout id (if expect_..). */
static int open_object(const char *path, int want_write, struct object *o)
{
    struct stat s;
    if (lstat(path, &s) != 0) return errno == EACCES ? 102 : 101;
    if (!S_ISREG(s.st_mode)) return 121;
    int flags = O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, fd = open(path, O_RDWR | flags);
    int writable = fd >= 0;
    if (fd < 0 && !want_write && (errno == EACCES || errno == EROFS)) fd = open(path, O_RDONLY | flags);
    if (fd < 0) return errno == ENOENT ? 101 : errno == ELOOP ? 121 : 102;
    int error = fstat(fd, &s) != 0 ? 102 : !S_ISREG(s.st_mode) ? 121 : s.st_size < 512 ? 103 : 0;
    if (!error) {
        uint32_t w[32], *first = mmap(NULL, 512, PROT_READ, MAP_SHARED, fd, 0); /* M4: nothing beyond byte 511 yet */
        if (first == MAP_FAILED) error = 102;
        else {
            for (int i = 0; i < 32; i++) w[i] = __atomic_load_n(&first[i], __ATOMIC_RELAXED);
            munmap(first, 512);
            error = judge(w, (uint64_t)s.st_size, o);
        }
    }
    if (!error) {
        void *map = mmap(NULL, o->size, PROT_READ | (writable ? PROT_WRITE : 0), MAP_SHARED, fd, 0);
        if (map == MAP_FAILED) error = 102;
        else o->map = map, o->writable = writable;
    }
    close(fd);
    return error;
}
static void close_object(struct object *o)
{
    if (o->map) munmap(o->map, o->size);
    o->map = NULL;
}
static int valid(const struct object *o) /* section 9, the end: at every call */
{
    return ld(o, 12) != 1 ? 111 : ld(o, 64) != o->layout_lo || ld(o, 68) != o->layout_hi ? 112 : 0;
}

/* ---- liveness: M21, and the silence of M6 and M9; the caller's own clock only ---- */
struct silence { uint32_t claim, beat, moved; int64_t since; int seen; };
static int64_t patience(uint32_t beat_ms)
{
    uint32_t ms = beat_ms == 0 ? 1000 : 3 * (beat_ms > 10000 ? 10000 : beat_ms);
    return (ms < 100 ? 100 : ms) * INT64_C(1000);
}
static int silent(struct silence *s, uint32_t claim, uint32_t beat, uint32_t moved, uint32_t beat_ms, int64_t now)
{
    if (!s->seen || claim != s->claim || beat != s->beat || moved != s->moved)
        *s = (struct silence){claim, beat, moved, now, 1};
    return now - s->since >= patience(beat_ms);
}
/* Section 8.6: where the peer is silent the name may lead to another object by now; 1: that one is in *fresh. */
struct again { struct silence peer; int64_t next, wait; };
static int moved_on(const char *path, int want_write, const struct object *o, struct again *a, struct object *fresh)
{
    int64_t now = now_us(CLOCK_MONOTONIC);
    uint32_t at = want_write ? LINES : EPOCH; /* the bridge's line 0, or the writer's line */
    if (o->map && !silent(&a->peer, ld(o, at), ld(o, at + 4), 0, ld(o, at + 8), now)) return a->wait = 0;
    if (a->wait && now < a->next) return 0;
    a->wait = a->wait == 0 ? 100000 : a->wait < 3200000 ? 2 * a->wait : a->wait; /* back-off */
    a->next = now + a->wait, *fresh = *o, fresh->map = NULL;
    if (open_object(path, want_write, fresh)) return 0;
    if (o->map && fresh->generation == o->generation) return close_object(fresh), 0;
    *a = (struct again){0};
    return 1;
}

/* ---- section 7.1 ---- */
static uint32_t advance(uint32_t s, uint32_t k, uint32_t n) { return s + k < s ? s + k + n : s + k; }
static uint32_t distance(uint32_t a, uint32_t b, uint32_t n) { return b - a - (b < a ? n : 0); }
static uint32_t slot_at(const struct object *o, uint32_t s) { return o->slots + s % o->n * o->stride; }

/* ---- section 7.3 ---- */
struct message { uint32_t sequence, lost, header[16]; unsigned char *record; };
struct reader { uint32_t last, lost, discontinuities, retries, line, epoch; struct silence other[4]; };

static int take(const struct object *o, struct reader *r, int in_order, struct message *m)
{
    uint32_t n = o->n, failed_head = 0, failed = 0;
    for (int attempt = 0; attempt < ATTEMPTS; attempt++) {
        uint32_t h = ld(o, HEAD), less = ld(o, RULE) == 2, last = r->last, s = h; /* M23: loaded together with h */
        if (h == 0 || h == last || (last && distance(h, last, n) < n)) return 0;  /* M13: nothing new */
        uint32_t d = distance(last, h, n), jump = d >= 1u << 31;
        if (d == 0) return 0; /* a head among the sequences that the wrap skips */
        if (in_order && !jump && !(failed >= 2 && failed_head == h))
            s = advance(last, d > n - 1 - less ? d - (n - 2 - less) : 1, n);
        uint32_t at = slot_at(o, s), q = ld(o, at);
        __atomic_thread_fence(__ATOMIC_ACQUIRE); /* F3; before giving up, too: the next load of head is a later one */
        int good = q == s;
        if (good) {
            for (uint32_t i = 0; i < 16; i++) m->header[i] = ld(o, at + 4 * i);
            uint32_t i = 0;
            for (; i + 4 <= o->record; i += 4) {
                uint32_t w = ld(o, at + 64 + i);
                memcpy(m->record + i, &w, 4);
            }
            for (; i < o->record; i++) m->record[i] = __atomic_load_n(o->map + at + 64 + i, __ATOMIC_RELAXED);
            __atomic_thread_fence(__ATOMIC_ACQUIRE); /* F4 */
            uint32_t h2 = ld(o, HEAD), q2 = ld(o, at);
            less |= ld(o, RULE) == 2; /* M23: and again */
            good = q2 == s && m->header[1] == o->record;
            if (good && distance(s, h2, n) <= n - 2 - less) { /* M12: both conditions */
                m->sequence = s, m->lost = last == 0 || jump ? 0 : distance(last, s, n) - 1;
                r->last = s, r->lost += m->lost, r->discontinuities += last != 0 && jump;
                return 1;
            }
            r->retries++;
        }
        if (!good) failed = failed_head == h ? failed + 1 : 1, failed_head = h;
    }
    return 0;
}
static void release_line(const struct object *o, struct reader *r)
{
    if (r->epoch && o->map) cas(o, r->line + L_CLAIM, r->epoch, 0);
    r->epoch = 0;
}
/* M9: claims a free line, or one that was silent; otherwise this stays an observer. Then shows the reader's state. */
static void show_line(const struct object *o, struct reader *r, int64_t now)
{
    if (!o->writable) return;
    for (int pass = 0; pass < 2 && !r->epoch; pass++)
        for (uint32_t k = o->direction == 2; k < 4 && !r->epoch; k++) {
            uint32_t l = LINES + 64 * k, c = ld(o, l), own = random_word();
            if (pass == 0 && c != 0) continue;
            if (c && !silent(&r->other[k], c, ld(o, l + L_BEAT), ld(o, l + L_TAKEN), ld(o, l + L_BEAT_MS), now)) continue;
            if (!cas(o, l, c, own)) continue;
            char task[16] = "spec_peer";
            uint32_t w[4];
            r->line = l, r->epoch = own;
            st(o, l + L_BEAT_MS, MY_BEAT_MS), st(o, l + L_LAYOUT, o->layout_lo), st(o, l + L_LAYOUT + 4, o->layout_hi);
            st(o, l + L_GENERATION, o->generation), st(o, l + L_ERROR, 0), st(o, l + L_SINKS, UINT32_MAX);
            st(o, l + L_PID, (uint32_t)getpid());
            memcpy(w, task, sizeof w);
            for (uint32_t i = 0; i < 4; i++) st(o, l + L_TASK + 4 * i, w[i]);
        }
    if (!r->epoch) return;
    if (ld(o, r->line) != r->epoch) { r->epoch = 0; return; } /* taken over: an observer from now on */
    st(o, r->line + L_TAKEN, r->last), st(o, r->line + L_LOST, r->lost), st(o, r->line + L_RETRIES, r->retries);
    st(o, r->line + L_BEAT, ld(o, r->line + L_BEAT) + 1);
}

/* ---- section 7.2 ---- */
struct writer { uint32_t epoch, head, marked; };

static int claim(const struct object *o, struct writer *w) /* M6; 0, 111, 112 or 114 */
{
    struct silence s = {0};
    uint32_t first = ld(o, EPOCH), beat = ld(o, BEAT), head = ld(o, HEAD);
    *w = (struct writer){.epoch = random_word()};
    for (;; pause_us(5000)) {
        uint32_t e = ld(o, EPOCH);
        if (valid(o)) return valid(o);
        if (e != 0 && (e != first || ld(o, BEAT) != beat || ld(o, HEAD) != head)) return 114;
        if (e != 0 && !silent(&s, e, beat, head, ld(o, BEAT_MS), now_us(CLOCK_MONOTONIC))) continue;
        if (cas(o, EPOCH, e, w->epoch)) break;
        if (e != 0) return 114;
    }
    w->head = ld(o, HEAD); /* M7: once */
    st(o, BEAT_MS, MY_BEAT_MS), st(o, BEAT, ld(o, BEAT) + 1), st(o, RULE, 1), st(o, SOURCES, UINT32_MAX);
    st(o, REFUSED, 0), st(o, TRUNCATED, 0), st(o, WRITER_PID, (uint32_t)getpid()), st(o, WRITER_ERROR, 0);
    return 0;
}
static int beat(const struct object *o, const struct writer *w)
{
    if (ld(o, EPOCH) != w->epoch) return 115;
    st(o, BEAT, ld(o, BEAT) + 1);
    return 0;
}
static int publish(const struct object *o, struct writer *w, const unsigned char *record)
{
    int error = valid(o);
    if (!error) error = beat(o, w); /* M6: the epoch, before each publication */
    if (error) return error;
    uint32_t s = advance(w->head, 1, o->n), at = slot_at(o, s), h[16] = {0}, i;
    int64_t stamp = now_us(CLOCK_REALTIME) * 1000;
    h[1] = o->record, h[2] = !w->marked; /* M24 */
    h[4] = (uint32_t)stamp, h[5] = (uint32_t)((uint64_t)stamp >> 32), h[6] = 1;
    __atomic_thread_fence(__ATOMIC_RELEASE); /* F1 */
    st(o, at, 0);                            /* M22: the seal */
    __atomic_thread_fence(__ATOMIC_RELEASE); /* F5 */
    for (i = 1; i < 16; i++) st(o, at + 4 * i, h[i]);
    for (i = 0; i + 4 <= o->record; i += 4) {
        uint32_t word;
        memcpy(&word, record + i, 4);
        st(o, at + 64 + i, word);
    }
    for (; i < o->record; i++) __atomic_store_n(o->map + at + 64 + i, record[i], __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_RELEASE); /* F6 */
    st(o, at, s);
    __atomic_thread_fence(__ATOMIC_RELEASE); /* F2, M10 */
    st(o, HEAD, s);
    w->head = s, w->marked = 1;
    return 0;
}
static void release_writer(const struct object *o, const struct writer *w)
{
    if (o->map && w->epoch) cas(o, EPOCH, w->epoch, 0); /* M6; only over the own epoch, never over a successor's */
}

/* ---- commands ---- */
static int refuse(const char *path, int error)
{
    fprintf(stderr, "SHM%d: %s: %s\n", error, path, words_of(error));
    return 3;
}
static int command_read(const char *path, uint64_t count, double seconds, int latched)
{
    struct object o = {0}, fresh;
    int error = open_object(path, 0, &o);
    if (!error && o.record < 8) error = 112; /* the convention of this program's records */
    if (error) return refuse(path, error);
    struct reader r = {.last = latched ? 0 : ld(&o, HEAD)}; /* M14 */
    struct message m = {.record = malloc(o.record)};
    struct again again = {0};
    uint64_t messages = 0, lost = 0, discontinuities = 0, torn = 0, backwards = 0, miscounted = 0, before = 0, c;
    int64_t now = now_us(CLOCK_MONOTONIC), end = now + (int64_t)(seconds * 1e6), shown = 0;
    int from_start = latched;
    if (!m.record) return 1;
    for (; messages < count && now < end && !stopped; now = now_us(CLOCK_MONOTONIC)) {
        if (o.map && valid(&o)) release_line(&o, &r), close_object(&o);
        if (moved_on(path, 0, &o, &again, &fresh)) { /* another generation: M14 */
            release_line(&o, &r), close_object(&o);
            o = fresh, lost += r.lost, discontinuities += r.discontinuities;
            r = (struct reader){.last = latched ? 0 : ld(&o, HEAD)};
            from_start = 1;
        }
        int got = o.map && take(&o, &r, 1, &m);
        if (o.map && (got || now - shown > 100000)) show_line(&o, &r, now), shown = now;
        if (!got) { pause_us(500); continue; }
        memcpy(&c, m.record, 8);
        int whole = 1;
        for (uint32_t i = 8; i < o.record; i++) whole &= m.record[i] == (unsigned char)c;
        if (!whole) torn++, fprintf(stderr, "torn: sequence %" PRIu32 " counter %" PRIu64 "\n", m.sequence, c);
        else if (messages && c <= before)
            torn++, backwards++, fprintf(stderr, "back: sequence %" PRIu32 ", counter %" PRIu64 " after %" PRIu64 "\n",
                                         m.sequence, c, before);
        else if (messages && !from_start && !(m.header[2] & 1) && c != before + m.lost + 1) miscounted++;
        if (m.header[2] & 1) fprintf(stderr, "first after its writer's start: sequence %" PRIu32 " counter %" PRIu64 "\n", m.sequence, c);
        before = whole ? c : before, from_start = 0, messages++;
    }
    if (o.map) show_line(&o, &r, now), release_line(&o, &r);
    if (miscounted) fprintf(stderr, "miscounted=%" PRIu64 "\n", miscounted);
    printf("messages=%" PRIu64 " lost=%" PRIu64 " torn=%" PRIu64 " discontinuities=%" PRIu64 "\n", messages, lost + r.lost,
           torn, discontinuities + r.discontinuities);
    free(m.record), close_object(&o);
    return torn > 0;
}
static int command_write(const char *path, uint64_t count, int64_t interval, uint64_t first)
{
    struct object o = {.direction = 2}, fresh;
    struct writer w;
    int error = open_object(path, 1, &o);
    if (!error && o.record < 8) error = 112;
    if (!error) error = claim(&o, &w);
    if (error) return refuse(path, error);
    unsigned char *record = malloc(o.record);
    struct again again = {0};
    uint64_t written = 0;
    int64_t due = now_us(CLOCK_MONOTONIC), limit = 0;
    if (!record) return 1;
    while (written < count && !stopped && !error) {
        int64_t now = now_us(CLOCK_MONOTONIC);
        if (o.map && (error = valid(&o)) != 0) { /* retired or damaged: away from it, and by name again */
            release_writer(&o, &w), close_object(&o);
            limit = now + 10000000;
        }
        if (moved_on(path, 1, &o, &again, &fresh)) {
            release_writer(&o, &w), close_object(&o);
            o = fresh, error = claim(&o, &w);
        } else if (!o.map) {
            if (now > limit) break;
            error = 0, pause_us(5000);
            continue;
        }
        if (error) break;
        if (now < due) { /* beat while waiting */
            error = beat(&o, &w);
            pause_us(due - now < MY_BEAT_MS * 250 ? due - now : MY_BEAT_MS * 250);
            continue;
        }
        uint64_t c = first + written;
        memcpy(record, &c, 8);
        memset(record + 8, (int)(c & 255), o.record - 8);
        error = publish(&o, &w, record);
        if (error == 111 || error == 112) { error = 0; continue; } /* the loop's beginning leaves it */
        if (!error) written++, due = (due + interval > now ? due : now) + interval;
    }
    if (!o.map && !error && written < count && !stopped) error = 101;
    release_writer(&o, &w), free(record), close_object(&o);
    printf("written=%" PRIu64 "\n", written);
    return error ? refuse(path, error) : 0;
}
static int command_take(const char *path, int in_order, uint32_t last, struct object expected)
{
    struct object o = expected;
    int error = open_object(path, 0, &o);
    if (error) return refuse(path, error);
    struct reader r = {.last = last};
    struct message m = {.record = malloc(o.record)};
    if (!m.record) return 1;
    while (take(&o, &r, in_order, &m)) {
        printf("%" PRIu32 " %" PRIu32 " %" PRIu32 " %" PRIu64 " %" PRIu32 " %" PRIu64 " ", m.sequence, m.lost, m.header[2],
               m.header[4] | (uint64_t)m.header[5] << 32, m.header[6], m.header[8] | (uint64_t)m.header[9] << 32);
        for (uint32_t i = 0; i < o.record; i++) printf("%02x", m.record[i]);
        putchar('\n');
    }
    printf("end %" PRIu32 " %" PRIu32 " %" PRIu32 "\n", r.last, r.lost, r.discontinuities);
    free(m.record), close_object(&o);
    return 0;
}
int main(int argc, char **argv)
{
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    if (argc >= 5 && argc <= 6 && !strcmp(argv[1], "read") && (argc == 5 || !strcmp(argv[5], "latched")))
        return command_read(argv[2], strtoull(argv[3], NULL, 10), atof(argv[4]), argc == 6);
    if (argc >= 5 && argc <= 6 && !strcmp(argv[1], "write"))
        return command_write(argv[2], strtoull(argv[3], NULL, 10), atoll(argv[4]), argc == 6 ? strtoull(argv[5], NULL, 10) : 1);
    if ((argc == 5 || argc == 8) && !strcmp(argv[1], "take")) {
        struct object expected = {0};
        if (argc == 8) { /* LO:HI as hexadecimal words, or "any"; record size and direction, or 0 */
            expected.expect_layout = sscanf(argv[5], "%8" SCNx32 ":%8" SCNx32, &expected.layout_lo, &expected.layout_hi) == 2;
            expected.expect_record = (expected.record = (uint32_t)strtoul(argv[6], NULL, 10)) != 0;
            expected.direction = (uint32_t)strtoul(argv[7], NULL, 10);
        }
        return command_take(argv[2], !strcmp(argv[3], "in_order"), (uint32_t)strtoul(argv[4], NULL, 10), expected);
    }
    fprintf(stderr, "usage: spec_peer read PATH COUNT SECONDS [latched] | write PATH COUNT INTERVAL_US [FIRST] |\n"
                    "       take PATH newest|in_order LAST [LAYOUT_LO:LAYOUT_HI RECORD_SIZE DIRECTION]\n");
    return 2;
}
