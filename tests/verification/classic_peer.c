/* A program of an existing project: a memory with one record, and a semaphore of the same name.
 *
 *     classic_peer NAME SIZE make|find|bare
 *
 * make: removes an old semaphore and makes a new one, as the source thesis' class does on each start.
 * find: opens what is there, and makes what is missing. bare: no semaphore, as CODESYS' own sample.
 * Lines on stdin are commands; each is answered by one line.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

static uint8_t *record;
static size_t size;
static sem_t *lock;

static void fail(const char *what)
{
    perror(what);
    exit(1);
}

static void enter(void)
{
    if (lock && sem_wait(lock))
        fail("sem_wait");
}

static void leave(void)
{
    if (lock && sem_post(lock))
        fail("sem_post");
}

static unsigned digit(int c) { return (unsigned)(c <= '9' ? c - '0' : (c | 32) - 'a' + 10); }

/* The first number of the record, in all of its doubles. */
static void fill(double number)
{
    for (size_t at = 0; at + sizeof number <= size; at += sizeof number)
        memcpy(record + at, &number, sizeof number);
}

static int torn(void)
{
    for (size_t at = 8; at + 8 <= size; at += 8)
        if (memcmp(record, record + at, 8))
            return 1;
    return 0;
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + (double)now.tv_nsec / 1e9;
}

int main(int count, char **words)
{
    static char line[1 << 17];
    char name[300];
    if (count != 4)
        return 2;
    snprintf(name, sizeof name, "/%s", words[1]);
    size = (size_t)atol(words[2]);
    if (!strcmp(words[3], "make"))
        sem_unlink(name);
    if (strcmp(words[3], "bare")) {
        lock = sem_open(name, O_CREAT, 0660, 1);
        if (lock == SEM_FAILED)
            fail("sem_open");
    }
    int fd = shm_open(name, O_CREAT | O_RDWR, 0770);
    if (fd < 0)
        fail("shm_open");
    if (ftruncate(fd, (off_t)size))
        fail("ftruncate");
    record = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (record == MAP_FAILED)
        fail("mmap");
    close(fd);
    puts("ready");
    fflush(stdout);
    while (fgets(line, sizeof line, stdin)) {
        char *argument = strchr(line, ' ');
        line[strcspn(line, "\n")] = 0;
        if (!strncmp(line, "write ", 6)) {
            enter();
            for (size_t i = 0; i < size && argument[1 + 2 * i]; i++)
                record[i] = (uint8_t)(digit(argument[1 + 2 * i]) << 4 | digit(argument[2 + 2 * i]));
            leave();
        } else if (!strcmp(line, "read")) {
            enter();
            for (size_t i = 0; i < size; i++)
                printf("%02x", record[i]);
            leave();
        } else if (!strcmp(line, "enter")) {
            enter();
        } else if (!strcmp(line, "leave")) {
            leave();
        } else if (!strncmp(line, "half ", 5)) { /* inside, with half a message written */
            enter();
            memset(record, atoi(argument), size / 2);
        } else if (!strncmp(line, "writing ", 8)) { /* for so many seconds, as fast as it goes */
            double until = seconds() + atof(argument), number = 1;
            for (; seconds() < until; number++) {
                enter();
                fill(number);
                leave();
            }
            printf("%.0f", number - 1);
        } else if (!strncmp(line, "reading ", 8)) {
            double until = seconds() + atof(argument);
            long looks = 0, broken = 0;
            for (; seconds() < until; looks++) {
                enter();
                broken += torn();
                leave();
            }
            printf("%ld %ld", looks, broken);
        } else if (!strcmp(line, "count")) {
            int value = -1;
            if (lock)
                sem_getvalue(lock, &value);
            printf("%d", value);
        } else {
            printf("?");
        }
        putchar('\n');
        fflush(stdout);
    }
    return 0;
}
