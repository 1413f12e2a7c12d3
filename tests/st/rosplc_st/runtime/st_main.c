/* A translated program as a process of its own, driven line by line through its stdin. */
#define _GNU_SOURCE
#include "st_runtime.h"

#include <grp.h>
#include <inttypes.h>
#include <stdio.h>
#include <unistd.h>

static const char *const option_names[] = { "round_pages", "check_size", "return_size", "cache_names", "real_clock",
    "sem_born_locked", "sem_failed", "sem_recursive", "sem_cache", "no_duplicate", "stop_inside" };

static void tables(void)
{
    for (const struct st_global *g = st_globals; g->name; g++)
        printf("global %s %" PRIuPTR " %zu\n", g->name, (uintptr_t)g->pointer, g->size);
    for (const struct st_member *m = st_members; m->owner; m++)
        printf("member %s %s %zu %zu\n", m->owner, *m->name ? m->name : "-", m->offset, m->size);
    printf("end %zu\n", sizeof(void *));
}

static int digit(int c) { return c <= '9' ? c - '0' : (c | 32) - 'a' + 10; }

int main(void)
{
    static char line[1 << 20], word[64], name[256];
    uintptr_t address;
    unsigned long number, step;
    setvbuf(stdout, NULL, _IOFBF, 1 << 16);
    while (fgets(line, sizeof line, stdin)) {
        int at = 0;
        if (sscanf(line, "%63s%n", word, &at) != 1)
            continue;
        const char *rest = line + at;
        if (!strcmp(word, "start")) {
            st_start();
        } else if (!strcmp(word, "stop")) {
            st_stop();
        } else if (!strcmp(word, "power")) {
            st_forget();
            st_warm_start();
        } else if (!strcmp(word, "change")) {
            st_online_change();
        } else if (!strcmp(word, "time") && sscanf(rest, "%lu", &number) == 1) {
            st_set_time((uint32_t)number);
        } else if (!strcmp(word, "scan") && sscanf(rest, "%255s %lu %lu", name, &number, &step) == 3) {
            uint32_t now = st_time();
            for (unsigned long i = 0; i < number; i++) {
                st_set_time(now += (uint32_t)step);
                if (st_scan(name))
                    break;
            }
        } else if (!strcmp(word, "directory") && sscanf(rest, "%255s", name) == 1) {
            st_set_directory(name);
        } else if (!strcmp(word, "prefix") && sscanf(rest, "%255s", name) == 1) {
            st_set_prefix(name);
        } else if (!strcmp(word, "user") && sscanf(rest, "%lu", &number) == 1) {
            if (setgroups(0, NULL) || setgid((gid_t)number) || setuid((uid_t)number))
                fputs("?", stdout);
        } else if (!strcmp(word, "option") && sscanf(rest, "%255s %lu", name, &number) == 2) {
            for (size_t i = 0; i < sizeof option_names / sizeof *option_names; i++)
                if (!strcmp(option_names[i], name))
                    ((uint32_t *)&st_options)[i] = (uint32_t)number;
        } else if (!strcmp(word, "counters")) {
            for (size_t i = 0; i < sizeof st_counters / 4; i++)
                printf("%" PRIu32 " ", ((uint32_t *)&st_counters)[i]);
        } else if (!strcmp(word, "fault")) {
            fputs(st_last_fault(), stdout);
        } else if (!strcmp(word, "tables")) {
            tables();
            fflush(stdout);
            continue;
        } else if (!strcmp(word, "peek") && sscanf(rest, "%" SCNuPTR " %lu", &address, &number) == 2) {
            for (unsigned long i = 0; i < number; i++)
                printf("%02x", ((uint8_t *)address)[i]);
        } else if (!strcmp(word, "poke") && sscanf(rest, "%" SCNuPTR " %n", &address, &at) == 1) {
            const char *hex = rest + at;
            for (uint8_t *to = (uint8_t *)address; hex[0] > ' ' && hex[1] > ' '; hex += 2)
                *to++ = (uint8_t)(digit(hex[0]) << 4 | digit(hex[1]));
        } else {
            fputs("?", stdout);
        }
        putchar('\n');
        fflush(stdout);
    }
    return 0;
}
