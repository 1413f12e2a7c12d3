/* A PLC's half of classic mode, in C: memory and semaphore as SysShm and SysSemProcess make them on Linux.
 *
 *   plc write  NAME SEMAPHORE SIZE PERIOD_US   writes a rising number into every word of the record
 *   plc read   NAME SEMAPHORE SIZE PERIOD_US   says "value N" for each change, "torn" if the words differ
 *   plc sample PREFIX                          CODESYS' sample: no lock, two integers, both directions
 *
 * SEMAPHORE may be "-" for none. Existing objects are opened, missing ones made; every wait is bounded by
 * 5 ms. It says "ready" first. Environment:
 *   HOLD=N        says "inside" in the N-th access, half-way through the copy, and stays there
 *   SPREAD_US=N   the copy takes so long
 *   INITIAL=N     the value of a semaphore that it makes (1)
 *   FIRST=N       the first number (1)
 * It ends when its input ends, and says "end WRITTEN TIMEOUTS".
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <semaphore.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static int hold_at, accesses, spread_us;

static int number(const char *name, int otherwise)
{
    const char *text = getenv(name);
    return text ? atoi(text) : otherwise;
}

static void say(const char *text)
{
    printf("%s\n", text);
    fflush(stdout);
}

static void fail(const char *what)
{
    perror(what);
    exit(1);
}

static void rest(int us)
{
    struct timespec time = {us / 1000000, (us % 1000000) * 1000L};
    nanosleep(&time, NULL);
}

static int input_ended(void)
{
    struct pollfd input = {0, POLLIN, 0};
    char byte;
    return poll(&input, 1, 0) > 0 && read(0, &byte, 1) <= 0;
}

static volatile uint32_t *memory(const char *name, size_t size)
{
    struct stat found;
    int fd = shm_open(name, O_CREAT | O_RDWR, S_IRWXU | S_IRWXG);
    if (fd < 0 || fstat(fd, &found) != 0)
        fail("memory");
    if ((size_t)found.st_size < size && ftruncate(fd, (off_t)size) != 0)
        fail("size");
    void *at = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (at == MAP_FAILED)
        fail("mapping");
    close(fd);
    return at;
}

static int enter(sem_t *lock)
{
    struct timespec until;
    if (lock == NULL)
        return 1;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_nsec += 5000000;
    if (until.tv_nsec >= 1000000000) {
        until.tv_sec++;
        until.tv_nsec -= 1000000000;
    }
    while (sem_clockwait(lock, CLOCK_MONOTONIC, &until) != 0)
        if (errno != EINTR)
            return 0;
    return 1;
}

static void half_way(void)
{
    if (hold_at && ++accesses == hold_at) {
        say("inside");
        for (;;)
            pause();
    }
    if (spread_us)
        rest(spread_us);
}

static int sample(const char *prefix)
{
    struct pair { int32_t i1, i2; };
    char name[2][200];
    snprintf(name[0], sizeof name[0], "%s_Read", prefix);
    snprintf(name[1], sizeof name[1], "%s_Write", prefix);
    struct pair last = {0, 0};
    say("ready");
    for (int round = 1; !input_ended(); round++) {
        /* Opened and closed in every round, as the sample's program does it. */
        volatile struct pair *in = (volatile struct pair *)memory(name[0], sizeof *in);
        volatile struct pair *out = (volatile struct pair *)memory(name[1], sizeof *out);
        if (in->i1 != last.i1 || in->i2 != last.i2) {
            last.i1 = in->i1;
            last.i2 = in->i2;
            printf("read %d %d\n", last.i1, last.i2);
            fflush(stdout);
        }
        out->i1 = round;
        out->i2 = -round;
        munmap((void *)in, sizeof *in);
        munmap((void *)out, sizeof *out);
        rest(50000);
    }
    return 0;
}

int main(int argc, char **argv)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* a test run that is killed leaves nobody inside */
    hold_at = number("HOLD", 0);
    spread_us = number("SPREAD_US", 0);
    if (argc == 3 && strcmp(argv[1], "sample") == 0)
        return sample(argv[2]);
    if (argc < 6)
        return 2;
    int writes = strcmp(argv[1], "write") == 0, timeouts = 0;
    size_t words = (size_t)atoi(argv[4]) / 4;
    int period = atoi(argv[5]);
    volatile uint32_t *record = memory(argv[2], words * 4);
    sem_t *lock = NULL;
    if (strcmp(argv[3], "-") != 0) {
        lock = sem_open(argv[3], O_CREAT, S_IRWXU | S_IRWXG, number("INITIAL", 1));
        if (lock == SEM_FAILED)
            fail("semaphore");
    }
    uint32_t value = (uint32_t)number("FIRST", 1), last = 0, done = 0;
    say("ready");
    while (!input_ended()) {
        if (!enter(lock)) {
            timeouts++;
        } else if (writes) {
            for (size_t i = 0; i < words; i++) {
                record[i] = value;
                if (i == words / 2)
                    half_way();
            }
            if (lock)
                sem_post(lock);
            value++;
            done++;
        } else {
            int torn = 0;
            uint32_t first = record[0];
            for (size_t i = 1; i < words; i++) {
                torn |= record[i] != first;
                if (i == words / 2)
                    half_way();
            }
            if (lock)
                sem_post(lock);
            if (torn)
                say("torn");
            else if (first != last) {
                printf("value %u\n", first);
                fflush(stdout);
                last = first;
            }
            done++;
        }
        rest(period);
    }
    printf("end %u %d\n", done, timeouts);
    return 0;
}
