/* What the programs share: the clock, orders on standard input, shared memory and named semaphores. */
#ifndef ROSPLC_BENCH_COMMON_H
#define ROSPLC_BENCH_COMMON_H

#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <semaphore.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#define COUNT 100
#define BYTES (COUNT * 2)
#define WATCHDOG 300 /* seconds for one order; who waits longer has lost its peer */
#define HELPER static __attribute__((unused))

enum { SPIN, YIELD, BLOCK, CYCLE };

/* How the program that was ordered last waits. */
static struct {
    int wait;
    uint64_t period, phase; /* ns */
} order;

HELPER void stop(const char *what)
{
    perror(what);
    exit(1);
}

HELPER __attribute__((format(printf, 1, 2))) void fail(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
    exit(1);
}

/* Prints a line for the program that measures. */
HELPER __attribute__((format(printf, 1, 2))) void say(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vprintf(format, arguments);
    va_end(arguments);
    putchar('\n');
    fflush(stdout);
}

HELPER void print_list(const char *lead, const uint64_t *values, long count)
{
    printf("%s", lead);
    for (long i = 0; i < count; i++)
        printf("%c%llu", i ? ',' : '[', (unsigned long long)values[i]);
    printf(count ? "]" : "[]");
}

HELPER uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

HELPER void sleep_until(uint64_t tick)
{
    struct timespec t = {(time_t)(tick / 1000000000u), (long)(tick % 1000000000u)};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR)
        ;
}

HELPER uint64_t next_tick(void)
{
    uint64_t now = now_ns();
    return (now - order.phase) / order.period * order.period + order.period + order.phase;
}

HELPER void prepare(void)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    signal(SIGPIPE, SIG_DFL);
}

/* ---------------------------------------------------------------- orders */

HELPER long number(const char *text)
{
    long value = text ? atol(text) : 0;
    if (value < 0 || (value == 0 && (!text || strcmp(text, "0"))))
        fail("an order lacks a number");
    return value;
}

HELPER void set_order(char side)
{
    const char *word = strtok(NULL, " \n");
    static const char *const words[] = {"spin", "yield", "block", "cycle"};
    order.wait = -1;
    for (int i = 0; word && i < 4; i++)
        if (!strcmp(word, words[i]))
            order.wait = i;
    order.period = (uint64_t)number(strtok(NULL, " \n"));
    order.phase = side == 'B' ? order.period / 2 : 0;
    if (order.wait < 0 || (order.wait == CYCLE && !order.period))
        fail("an order lacks a way to wait");
}

/* ---------------------------------------------------------------- shared memory and semaphores */

/* Maps a file, or with -1 memory of the same kind without a name. */
HELPER void *map(int fd, size_t size)
{
    int kind = MAP_SHARED | MAP_POPULATE | (fd < 0 ? MAP_ANONYMOUS : 0);
    void *memory = mmap(NULL, size, PROT_READ | PROT_WRITE, kind, fd, 0);
    if (memory == MAP_FAILED)
        stop("mmap");
    if (fd >= 0)
        close(fd);
    return memory;
}

/* The file is made, with `size` bytes of zero, by the side that comes first. */
HELPER void *map_file(const char *path, size_t size)
{
    int fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (fd < 0 || ftruncate(fd, (off_t)size))
        stop(path);
    return map(fd, size);
}

HELPER sem_t *named_semaphore(const char *name, unsigned value)
{
    sem_t *semaphore = sem_open(name, O_CREAT, 0600, value);
    if (semaphore == SEM_FAILED)
        stop(name);
    return semaphore;
}

HELPER void down(sem_t *semaphore)
{
    while (sem_wait(semaphore))
        if (errno != EINTR)
            stop("sem_wait");
}

#endif
