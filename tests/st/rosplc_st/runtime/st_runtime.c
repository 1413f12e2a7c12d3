/* Stand-ins for SysShm, SysMem, MemoryBarrier and the clock, as their documentation describes them. */
#define _GNU_SOURCE
#include "st_runtime.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum {
    ERR_OK = 0, ERR_FAILED = 1, ERR_PARAMETER = 2, ERR_BUFFERSIZE = 0xF, ERR_NO_OBJECT = 0x10,
    ERR_NOMEMORY = 0x11, ERR_DUPLICATE = 0x12, ERR_INVALID_HANDLE = 0x14,
};

#define HANDLES 4096

struct mapping {
    char name[256];
    uint8_t *memory;
    size_t size;
    unsigned users;
};

struct st_options st_options;
struct st_counters st_counters;
uint8_t st_nowhere[65536];
void (*st_barrier_hook)(void);
static struct mapping mappings[HANDLES];
static char directory[4096] = "/dev/shm";
static char last_fault[256];
static uint32_t set_time;

void st_set_directory(const char *path) { snprintf(directory, sizeof directory, "%s", path); }
void st_set_time(uint32_t milliseconds) { set_time = milliseconds; }
const char *st_last_fault(void) { return last_fault; }

void st_fault(const char *what, const char *file, int line)
{
    st_counters.faults++;
    snprintf(last_fault, sizeof last_fault, "%s:%d: %s", file, line, what);
}

uint64_t st_ltime(void)
{
    if (st_options.real_clock) {
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
    }
    return (uint64_t)set_time * 1000000u;
}

uint32_t st_time(void) { return st_options.real_clock ? (uint32_t)(st_ltime() / 1000000u) : set_time; }

void *st_memory(size_t size)
{
    void *memory = NULL;
    if (posix_memalign(&memory, 64, size ? size : 1))
        abort();
    memset(memory, 0, size);
    return memory;
}

/* An old instance after an online change: whoever still uses its address finds nonsense. */
void st_poison(void *memory, size_t size) { memset(memory, 0xDD, size); }

int st_scan(const char *program)
{
    for (const struct st_program *p = st_programs; p->name; p++)
        if (!strcmp(p->name, program)) {
            p->body(*p->instance);
            return 0;
        }
    return -1;
}

static void put_result(uint8_t *result, uint32_t value)
{
    if (result)
        memcpy(result, &value, sizeof value);
}

static st_uxint refuse(uint8_t *result, uint32_t value)
{
    put_result(result, value);
    return SHM_INVALID;
}

static size_t countable(size_t size)
{
    size_t page = (size_t)sysconf(_SC_PAGESIZE);
    return st_options.round_pages ? (size + page - 1) / page * page : size;
}

static st_uxint open_object(const char *name, uint8_t *psize, uint8_t *result, int flags)
{
    st_uxint asked = 0;
    char path[4400];
    struct stat about;
    if (!name || !*name || strchr(name, '/') || strlen(name) > 255 || !psize)
        return refuse(result, ERR_PARAMETER);
    memcpy(&asked, psize, st_uxint_size);
    if (asked == 0)
        return refuse(result, ERR_PARAMETER);
    if (st_options.cache_names)
        for (size_t i = 0; i < HANDLES; i++)
            if (mappings[i].users && !strcmp(mappings[i].name, name) && mappings[i].size >= asked) {
                mappings[i].users++;
                st_counters.open_handles++;
                put_result(result, ERR_OK);
                return (st_uxint)i + 1;
            }
    snprintf(path, sizeof path, "%s/%s%s", directory, st_prefix(), name);
    uint32_t answer = ERR_OK;
    int made = 0, fd = -1;
    if (flags & O_CREAT) {
        fd = open(path, O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0640);
        made = fd >= 0;
        answer = made || st_options.no_duplicate ? ERR_OK : ERR_DUPLICATE;
    }
    if (fd < 0)
        fd = open(path, O_RDWR | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0)
        return refuse(result, errno == ENOENT ? ERR_NO_OBJECT : ERR_FAILED);
    if (made && ftruncate(fd, (off_t)asked)) {
        close(fd);
        return refuse(result, ERR_NOMEMORY);
    }
    if (fstat(fd, &about) || !S_ISREG(about.st_mode)) {
        close(fd);
        return refuse(result, ERR_FAILED);
    }
    size_t actual = countable((size_t)about.st_size);
    if (st_options.check_size && asked > actual) {
        close(fd);
        return refuse(result, ERR_BUFFERSIZE);
    }
    void *memory = mmap(NULL, asked, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    if (memory == MAP_FAILED)
        return refuse(result, ERR_NOMEMORY);
    for (size_t i = 0; i < HANDLES; i++)
        if (!mappings[i].users) {
            struct mapping *m = &mappings[i];
            snprintf(m->name, sizeof m->name, "%s", name);
            m->memory = memory;
            m->size = asked;
            m->users = 1;
            st_counters.open_handles++;
            if (st_options.return_size) {
                st_uxint size = (st_uxint)actual;
                memcpy(psize, &size, st_uxint_size);
            }
            put_result(result, answer);
            return (st_uxint)i + 1;
        }
    munmap(memory, asked);
    return refuse(result, ERR_NOMEMORY);
}

st_uxint SysSharedMemoryOpen2(const char *name, st_uxint physical, uint8_t *size, uint8_t *result)
{
    (void)physical;
    st_counters.opens++;
    st_uxint handle = open_object(name, size, result, O_RDWR);
    st_counters.opened += handle != SHM_INVALID;
    return handle;
}

st_uxint SysSharedMemoryCreate(const char *name, st_uxint physical, uint8_t *size, uint8_t *result)
{
    (void)physical;
    st_counters.creates++;
    return open_object(name, size, result, O_RDWR | O_CREAT);
}

static struct mapping *find(st_uxint handle)
{
    if (handle == 0 || handle > HANDLES || !mappings[handle - 1].users) {
        st_counters.bad_handles++;
        return NULL;
    }
    return &mappings[handle - 1];
}

uint8_t *SysSharedMemoryGetPointer(st_uxint handle, uint8_t *result)
{
    struct mapping *m = find(handle);
    put_result(result, m ? ERR_OK : ERR_INVALID_HANDLE);
    return m ? m->memory : NULL;
}

uint32_t SysSharedMemoryClose(st_uxint handle)
{
    struct mapping *m = find(handle);
    st_counters.closes++;
    if (!m)
        return ERR_INVALID_HANDLE;
    st_counters.open_handles--;
    if (--m->users == 0) {
        munmap(m->memory, m->size);
        m->memory = NULL;
    }
    return ERR_OK;
}

void st_forget(void)
{
    for (size_t i = 0; i < HANDLES; i++)
        if (mappings[i].users) {
            munmap(mappings[i].memory, mappings[i].size);
            mappings[i].users = 0;
        }
    st_counters.open_handles = 0;
}

uint32_t SysSharedMemoryDelete(st_uxint handle)
{
    char path[4400];
    struct mapping *m = find(handle);
    st_counters.deletes++;
    if (!m)
        return ERR_INVALID_HANDLE;
    snprintf(path, sizeof path, "%s/%s%s", directory, st_prefix(), m->name);
    unlink(path);
    return SysSharedMemoryClose(handle);
}

uint8_t *SysMemSet(uint8_t *memory, int32_t value, st_uxint size) { return memset(memory, value, size); }
uint8_t *SysMemCpy(uint8_t *to, uint8_t *from, st_uxint size) { return memmove(to, from, size); }
int32_t SysMemCmp(uint8_t *a, uint8_t *b, st_uxint size) { return memcmp(a, b, size); }

uint8_t MemoryBarrier_MemoryBarrier(void)
{
    st_counters.barriers++;
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    if (st_barrier_hook)
        st_barrier_hook();
    return 1;
}
