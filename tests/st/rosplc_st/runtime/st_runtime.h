/* What translated Structured Text stands on: strings, checks, and the libraries of CODESYS. */
#ifndef ST_RUNTIME_H
#define ST_RUNTIME_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* A handle and __UXINT have the processor's width. */
typedef uintptr_t st_uxint;
#define SHM_INVALID ((st_uxint)-1)
/* Bytes of the program's own __UXINT: fewer where a program for 32 bits runs on a processor of 64. */
extern const size_t st_uxint_size;

/* Tables of a translated program. */
struct st_global { const char *name; void **pointer; size_t size; };
struct st_program { const char *name; void (*body)(void *); void **instance; };
struct st_member { const char *owner, *name; size_t offset, size; };
extern const struct st_global st_globals[];
extern const struct st_program st_programs[];
extern const struct st_member st_members[];
void st_start(void);
void st_stop(void);
void st_warm_start(void);
/* What the end of a runtime does to its programs: every handle and mapping is gone. */
void st_forget(void);
void st_online_change(void);

/* What is documented as unknown, or differs between runtimes: switchable while a program runs. */
struct st_options {
    uint32_t round_pages;  /* an object's size counts as rounded up to pages */
    uint32_t check_size;   /* Open2 with more bytes than there are: BUFFERSIZE */
    uint32_t return_size;  /* Open2 stores the object's size in *pulSize */
    uint32_t cache_names;  /* a second Open2 of a name gives the mapping made first, while one is open */
    uint32_t real_clock;   /* TIME() by the machine's clock instead of st_set_time */
    uint32_t sem_born_locked; /* SysSemProcessCreate makes semaphores with the count 0 */
    uint32_t sem_failed;      /* Enter in vain gives FAILED instead of TIMEOUT */
    uint32_t sem_recursive;   /* Enter lets its own process in again */
    uint32_t sem_cache;       /* Create of a name that this process knows gives the handle made first */
    uint32_t no_duplicate;    /* Create of an existing memory or semaphore gives OK */
    uint32_t stop_inside;     /* the next Enter that succeeds stops the process there (SIGSTOP) */
};
extern struct st_options st_options;

/* What a test asserts about the libraries' use. */
struct st_counters {
    uint32_t opens, opened, closes, creates, deletes, faults, open_handles, bad_handles, barriers;
    uint32_t sem_creates, sem_made, sem_enters, sem_timeouts, sem_leaves;
    uint32_t sem_waited;  /* ms that Enter was told to wait, where it was in vain, added up */
    uint32_t sem_endless; /* calls of Enter without a limit */
};
extern struct st_counters st_counters;

/* Called at each MemoryBarrier: a test then looks at, or changes, what the program has in hand. */
extern void (*st_barrier_hook)(void);

/* Called inside the lock, after each SysSemProcessEnter that succeeds. */
extern void (*st_inside_hook)(void);

void st_set_directory(const char *path);
/* Put before every name of a memory or semaphore, so that tests with fixed names do not meet. */
void st_set_prefix(const char *prefix);
const char *st_prefix(void);
void st_set_time(uint32_t milliseconds);
const char *st_last_fault(void);
int st_scan(const char *program);
void st_fault(const char *what, const char *file, int line);
void *st_memory(size_t size);
void st_poison(void *memory, size_t size);
extern uint8_t st_nowhere[65536];

/* Libraries. */
st_uxint SysSharedMemoryCreate(const char *name, st_uxint physical, uint8_t *size, uint8_t *result);
st_uxint SysSharedMemoryOpen2(const char *name, st_uxint physical, uint8_t *size, uint8_t *result);
uint8_t *SysSharedMemoryGetPointer(st_uxint handle, uint8_t *result);
uint32_t SysSharedMemoryClose(st_uxint handle);
uint32_t SysSharedMemoryDelete(st_uxint handle);
st_uxint SysSemProcessCreate(const char *name, uint8_t *result);
uint32_t SysSemProcessEnter(st_uxint handle, uint32_t milliseconds);
uint32_t SysSemProcessLeave(st_uxint handle);
uint32_t SysSemProcessDelete(st_uxint handle);
uint8_t *SysMemSet(uint8_t *memory, int32_t value, st_uxint size);
uint8_t *SysMemCpy(uint8_t *to, uint8_t *from, st_uxint size);
int32_t SysMemCmp(uint8_t *a, uint8_t *b, st_uxint size);
uint8_t MemoryBarrier_MemoryBarrier(void);
uint32_t st_time(void);
uint64_t st_ltime(void);

static inline int32_t st_xadd(uint8_t *word, int32_t value)
{
    return __atomic_fetch_add((int32_t *)word, value, __ATOMIC_SEQ_CST);
}

/* Checks. An index beyond its array counts as a fault and becomes the first one. */
static inline intptr_t st_index(int64_t index, int64_t low, int64_t high, const char *file, int line)
{
    if (index < low || index > high) {
        st_fault("index", file, line);
        return 0;
    }
    return (intptr_t)(index - low);
}

static inline uint64_t st_divisor_check(uint64_t value, const char *file, int line)
{
    if (value == 0) {
        st_fault("division by 0", file, line);
        return 1;
    }
    return value;
}
#define st_divisor(value, file, line) ((__typeof__(value))st_divisor_check((uint64_t)(value), file, line))

/* Strings. The bytes behind the end keep what they held. */
static inline void st_assign(char *to, size_t length, const char *from)
{
    size_t count = strnlen(from, length);
    memmove(to, from, count);
    to[count] = 0;
}

static inline char *st_concat(char *out, const char *a, const char *b)
{
    size_t first = strnlen(a, 255), second = strnlen(b, 255 - first);
    memcpy(out, a, first);
    memcpy(out + first, b, second);
    out[first + second] = 0;
    return out;
}

static inline int16_t st_len(const char *text) { return (int16_t)strnlen(text, 255); }

static inline char *st_mid(char *out, const char *text, int16_t count, int16_t position)
{
    int length = st_len(text), from = position < 1 ? 0 : position - 1;
    int size = count < 0 || from >= length ? 0 : count;
    if (size > length - from)
        size = from >= length ? 0 : length - from;
    memcpy(out, text + (size ? from : 0), (size_t)size);
    out[size] = 0;
    return out;
}

static inline char *st_left(char *out, const char *text, int16_t count) { return st_mid(out, text, count, 1); }

static inline char *st_right(char *out, const char *text, int16_t count)
{
    int length = st_len(text);
    return st_mid(out, text, count, (int16_t)(count < length ? length - count + 1 : 1));
}

static inline int16_t st_find(const char *text, const char *part)
{
    const char *at = *part ? strstr(text, part) : 0;
    return (int16_t)(at ? at - text + 1 : 0);
}

/* REAL to integer: to the nearest, halves away from zero. */
static inline double st_round(double value) { return round(value); }

/* Shifts by the type's width and more: zeros, or the sign for signed types. */
static inline uint64_t st_shl_u(uint64_t v, uint64_t n, unsigned bits) { return n >= bits ? 0 : v << n; }
static inline uint64_t st_shr_u(uint64_t v, uint64_t n, unsigned bits) { return n >= bits ? 0 : v >> n; }
static inline int64_t st_shl_s(int64_t v, uint64_t n, unsigned bits)
{
    return n >= bits ? 0 : (int64_t)((uint64_t)v << n);
}
static inline int64_t st_shr_s(int64_t v, uint64_t n, unsigned bits) { return v >> (n >= bits ? bits - 1 : n); }
static inline uint64_t st_rol_u(uint64_t v, uint64_t n, unsigned bits)
{
    n %= bits;
    return n ? (v << n) | (v >> (bits - n)) : v;
}
static inline uint64_t st_ror_u(uint64_t v, uint64_t n, unsigned bits)
{
    n %= bits;
    return n ? (v >> n) | (v << (bits - n)) : v;
}
#define st_rol_s(v, n, bits) st_rol_u((uint64_t)(v) & (~0ULL >> (64 - (bits))), n, bits)
#define st_ror_s(v, n, bits) st_ror_u((uint64_t)(v) & (~0ULL >> (64 - (bits))), n, bits)

#endif
