/* Stand-ins for SysSemProcess over POSIX named semaphores, as codesyscontrol on Linux has them. */
#define _GNU_SOURCE
#include "st_runtime.h"

#include <errno.h>
#include <fcntl.h>
#include <semaphore.h>
#include <signal.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

enum { ERR_OK = 0, ERR_FAILED = 1, ERR_PARAMETER = 2, ERR_TIMEOUT = 5, ERR_DUPLICATE = 0x12, ERR_INVALID_HANDLE = 0x14 };

#define HANDLES 4096

struct lock {
    char name[256];
    sem_t *semaphore;
    unsigned inside; /* entries of this process, for a runtime that knows its caller again */
};

void (*st_inside_hook)(void);
static struct lock locks[HANDLES];
static char prefix[64];

void st_set_prefix(const char *text) { snprintf(prefix, sizeof prefix, "%s", text); }
const char *st_prefix(void) { return prefix; }

static st_uxint give(uint8_t *result, uint32_t value, st_uxint handle)
{
    if (result)
        memcpy(result, &value, sizeof value);
    return handle;
}

st_uxint SysSemProcessCreate(const char *name, uint8_t *result)
{
    char path[400];
    uint32_t answer = ERR_OK;
    st_counters.sem_creates++;
    if (!name || !*name || strchr(name, '/') || strlen(name) > 200)
        return give(result, ERR_PARAMETER, SHM_INVALID);
    if (st_options.sem_cache)
        for (size_t i = 0; i < HANDLES; i++)
            if (locks[i].semaphore && !strcmp(locks[i].name, name))
                return give(result, ERR_DUPLICATE, (st_uxint)i + 1);
    snprintf(path, sizeof path, "/%s%s", prefix, name);
    sem_t *semaphore = sem_open(path, O_CREAT | O_EXCL, 0666, st_options.sem_born_locked ? 0u : 1u);
    if (semaphore != SEM_FAILED) {
        st_counters.sem_made++;
    } else {
        answer = st_options.no_duplicate ? ERR_OK : ERR_DUPLICATE;
        semaphore = errno == EEXIST ? sem_open(path, 0) : SEM_FAILED;
    }
    if (semaphore == SEM_FAILED)
        return give(result, ERR_FAILED, SHM_INVALID);
    for (size_t i = 0; i < HANDLES; i++)
        if (!locks[i].semaphore) {
            snprintf(locks[i].name, sizeof locks[i].name, "%s", name);
            locks[i].semaphore = semaphore;
            locks[i].inside = 0;
            return give(result, answer, (st_uxint)i + 1);
        }
    sem_close(semaphore);
    return give(result, ERR_FAILED, SHM_INVALID);
}

static struct lock *find(st_uxint handle)
{
    if (handle == 0 || handle > HANDLES || !locks[handle - 1].semaphore) {
        st_counters.bad_handles++;
        return NULL;
    }
    return &locks[handle - 1];
}

static int wait_for(sem_t *semaphore, uint32_t milliseconds)
{
    struct timespec until;
    int failed;
    if (milliseconds == 0)
        return sem_trywait(semaphore);
    if (milliseconds == UINT32_MAX) {
        st_counters.sem_endless++;
        milliseconds = 10000; /* a test must end */
    }
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_sec += milliseconds / 1000;
    until.tv_nsec += (long)(milliseconds % 1000) * 1000000;
    if (until.tv_nsec >= 1000000000) {
        until.tv_sec++;
        until.tv_nsec -= 1000000000;
    }
    do
        failed = sem_clockwait(semaphore, CLOCK_MONOTONIC, &until);
    while (failed && errno == EINTR);
    return failed;
}

uint32_t SysSemProcessEnter(st_uxint handle, uint32_t milliseconds)
{
    struct lock *l = find(handle);
    st_counters.sem_enters++;
    if (!l)
        return ERR_INVALID_HANDLE;
    if (!(st_options.sem_recursive && l->inside) && wait_for(l->semaphore, milliseconds)) {
        st_counters.sem_timeouts++;
        st_counters.sem_waited += milliseconds;
        return st_options.sem_failed ? ERR_FAILED : ERR_TIMEOUT;
    }
    l->inside++;
    if (st_options.stop_inside) {
        st_options.stop_inside = 0;
        kill(getpid(), SIGSTOP);
    }
    if (st_inside_hook)
        st_inside_hook();
    return ERR_OK;
}

uint32_t SysSemProcessLeave(st_uxint handle)
{
    struct lock *l = find(handle);
    st_counters.sem_leaves++;
    if (!l)
        return ERR_INVALID_HANDLE;
    if (l->inside)
        l->inside--;
    if (st_options.sem_recursive && l->inside)
        return ERR_OK;
    return sem_post(l->semaphore) ? ERR_FAILED : ERR_OK;
}

/* Takes the name away from everybody: a block that calls it fails its test. */
uint32_t SysSemProcessDelete(st_uxint handle)
{
    char path[400];
    struct lock *l = find(handle);
    st_counters.deletes++;
    if (!l)
        return ERR_INVALID_HANDLE;
    snprintf(path, sizeof path, "/%s%s", prefix, l->name);
    sem_unlink(path);
    sem_close(l->semaphore);
    l->semaphore = NULL;
    return ERR_OK;
}
