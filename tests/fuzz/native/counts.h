/* Executions and bytes in a file that the campaign reads (tests/fuzz/counts.py), and the fuzzer's own counters per
 * kind of input: libFuzzer keeps an input that reaches a kind for the first time. */
#ifndef COUNTS_H
#define COUNTS_H

#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

static struct {
    uint64_t *words; /* executions, bytes, then one word for each kind; NULL: nobody wants to know */
    uint64_t kinds;
} counts;

static inline void counts_open(void)
{
    const char *path = getenv("ROSPLC_FUZZ_COUNTS");
    struct stat status;
    int fd = path ? open(path, O_RDWR | O_CLOEXEC) : -1;
    void *memory;
    if (fd < 0)
        return;
    if (!fstat(fd, &status) && status.st_size >= 16) {
        memory = mmap(NULL, (size_t)status.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
        if (memory != MAP_FAILED) {
            counts.words = memory;
            counts.kinds = (uint64_t)status.st_size / 8 - 2;
        }
    }
    close(fd);
}

static inline void counts_add(size_t size)
{
    if (counts.words) {
        counts.words[0]++;
        counts.words[1] += size;
    }
}

static inline void counts_kind(uint64_t kind)
{
    if (counts.words && kind < counts.kinds)
        counts.words[2 + kind]++;
}

#endif
