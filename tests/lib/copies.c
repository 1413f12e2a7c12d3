/* Preloaded: counts the copies of at least COPIES_FROM bytes by the module that calls, and writes them to
 * COPIES_IN/<process id> at the end, behind the process's command. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MODULES = 64 };
static struct {
    const void *base;
    const char *name;
    long copies;
} modules[MODULES];
static size_t least;

static void count(const void *caller)
{
    Dl_info info;
    if (!dladdr(caller, &info))
        return;
    for (int i = 0; i < MODULES; i++) {
        const void *none = NULL;
        if (__atomic_compare_exchange_n(&modules[i].base, &none, info.dli_fbase, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST))
            modules[i].name = info.dli_fname;
        if (modules[i].base == info.dli_fbase) {
            __atomic_fetch_add(&modules[i].copies, 1, __ATOMIC_SEQ_CST);
            return;
        }
    }
}

static void *copy(void *to, const void *from, size_t size)
{
    unsigned char *t = to;
    const unsigned char *f = from;
    if (t <= f || t >= f + size)
        __asm__ volatile("rep movsb" : "+D"(t), "+S"(f), "+c"(size) : : "memory");
    else
        while (size--)
            t[size] = f[size];
    return to;
}

void *memcpy(void *to, const void *from, size_t size)
{
    if (least && size >= least)
        count(__builtin_return_address(0));
    return copy(to, from, size);
}

void *memmove(void *to, const void *from, size_t size)
{
    if (least && size >= least)
        count(__builtin_return_address(0));
    return copy(to, from, size);
}

__attribute__((constructor)) static void begin(void)
{
    const char *from = getenv("COPIES_FROM");
    least = from ? strtoul(from, NULL, 10) : 0;
}

__attribute__((destructor)) static void end(void)
{
    char path[4096], command[4096] = "";
    FILE *file = fopen("/proc/self/cmdline", "r");
    size_t length = file ? fread(command, 1, sizeof command - 1, file) : 0;
    for (size_t i = 0; i < length; i++)
        if (!command[i])
            command[i] = ' ';
    snprintf(path, sizeof path, "%s/%d", getenv("COPIES_IN"), (int)getpid());
    file = fopen(path, "w");
    if (!file)
        return;
    fprintf(file, "%s\n", command);
    for (int i = 0; i < MODULES && modules[i].name; i++)
        fprintf(file, "%ld %s\n", modules[i].copies, modules[i].name);
    fclose(file);
}
