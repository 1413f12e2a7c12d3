/* A program of the field, written against the C headers of 0.1.0: every record of one object goes into another.
 *
 *   echo FROM TO   takes each message in order; ends with 0 when its standard input is closed.
 */
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "channel.h"

static int attach(const char *path, uint32_t direction, ch_region *region)
{
    struct stat facts;
    int file = open(path, O_RDWR);
    if (file < 0 || fstat(file, &facts))
        return perror(path), 1;
    uint8_t *base = mmap(NULL, (size_t)facts.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (base == MAP_FAILED)
        return perror(path), 1;
    close(file);
    int error = ch_identity_check(base, (uint64_t)facts.st_size, direction, &region->geometry);
    if (error)
        return fprintf(stderr, "%s: error %d\n", path, error), 1;
    region->header = (ch_header *)(void *)base;
    return 0;
}

int main(int count, char **arguments)
{
    ch_region from, to;
    ch_reader reader;
    ch_writer writer;
    static uint8_t record[1 << 16];
    if (count != 3 || attach(arguments[1], 1, &from) || attach(arguments[2], 2, &to))
        return 2;
    ch_reader_observe(&reader, &from, 0);
    if (ch_reader_claim(&reader, 0, 0, 0x01000001, 1000, (uint32_t)getpid()))
        return fprintf(stderr, "no reader line\n"), 3;
    if (ch_writer_claim(&writer, &to, 0, 0x01000002, 1000, (uint32_t)getpid()))
        return fprintf(stderr, "no claim\n"), 4;
    puts("ready");
    fflush(stdout);
    for (struct pollfd input = {.fd = 0, .events = POLLIN}; poll(&input, 1, 0) == 0;) {
        ch_reader_beat(&reader);
        ch_writer_beat(&writer);
        int taken = 0;
        ch_take t = ch_take_start(CH_TAKE_NEXT);
        while (ch_take_begin(&reader, &t)) {
            memcpy(record, ch_record(t.slot), from.geometry.record_size);
            if (ch_take_check(&reader, &t)) {
                ch_take_accept(&reader, &t);
                int error = 0;
                ch_slot_header *slot = ch_writer_begin(&writer, &error);
                if (!slot)
                    return fprintf(stderr, "writer: error %d\n", error), 5;
                memcpy(ch_record(slot), record, from.geometry.record_size);
                ch_meta meta = {0};
                ch_writer_commit(&writer, slot, &meta);
                taken = 1;
                break;
            }
        }
        if (!taken)
            usleep(200);
    }
    printf("lost %u\n", reader.lost);
    ch_reader_release(&reader);
    ch_writer_release(&writer);
    return 0;
}
