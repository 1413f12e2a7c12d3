/* Shared memory and named semaphores, as any C program uses them. */
#ifndef ROSPLC_BENCH_SHARED_H
#define ROSPLC_BENCH_SHARED_H

#include <fcntl.h>
#include <semaphore.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include "exchange.h"

/* The file is made, with `size` bytes of zero, by whoever comes first. */
static __attribute__((unused)) void *map_file(const char *path, size_t size)
{
    void *memory;
    int fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (fd < 0 || ftruncate(fd, (off_t)size))
        stop(path);
    memory = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
    if (memory == MAP_FAILED)
        stop(path);
    close(fd);
    return memory;
}

static __attribute__((unused)) sem_t *named_semaphore(const char *name, unsigned value)
{
    sem_t *semaphore = sem_open(name, O_CREAT, 0600, value);
    if (semaphore == SEM_FAILED)
        stop(name);
    return semaphore;
}

static __attribute__((unused)) void down(sem_t *semaphore)
{
    while (sem_wait(semaphore))
        if (errno != EINTR)
            stop("sem_wait");
}

#endif
