/* Opening a channel on a POSIX system: spec/shm-format.md, sections 8 and 9. Not part of channel.h: a PLC runtime
 * opens shared memory in its own way. Needs _POSIX_C_SOURCE 200809L before the first include. */
#ifndef ROSPLC_POSIX_H
#define ROSPLC_POSIX_H

#include <errno.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "region.h"

/* Opens the object at `path` (/dev/shm/PREFIX.t.TOPIC), checks it in the order of section 9, and maps it. `kind` is
 * ROSPLC_KIND_TOPIC, ROSPLC_KIND_REQUEST ..., `direction` ROSPLC_TO_PLC or ROSPLC_TO_ROS. Returns ROSPLC_OK after
 * filling `region`; unmap it with rosplc_close. */
static inline rosplc_error rosplc_open_kind(rosplc_region *region, const char *path, int writable, uint32_t kind,
                                            uint32_t direction, uint32_t layout_lo, uint32_t layout_hi,
                                            uint32_t record_size)
{
    uint8_t first[ROSPLC_HEADER_SIZE];
    struct stat status;
    rosplc_error error = ROSPLC_OK;
    void *mapped;
    int fd = open(path, (writable ? O_RDWR : O_RDONLY) | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0)
        return errno == ENOENT ? ROSPLC_ERROR_NO_OBJECT
               : errno == ELOOP || errno == EISDIR || errno == ENXIO ? ROSPLC_ERROR_NOT_PLAIN_FILE
                                                                      : ROSPLC_ERROR_NO_PERMISSION;
    if (fstat(fd, &status) || !S_ISREG(status.st_mode))
        error = ROSPLC_ERROR_NOT_PLAIN_FILE;
    else if (pread(fd, first, sizeof first, 0) != (ssize_t)sizeof first)
        error = ROSPLC_ERROR_TOO_SMALL;
    else
        error = rosplc_identity_check_kind(first, (uint64_t)status.st_size, kind, direction, &region->geometry);
    if (error == ROSPLC_OK
        && (region->geometry.layout_lo != layout_lo || region->geometry.layout_hi != layout_hi
            || region->geometry.record_size != record_size))
        error = ROSPLC_ERROR_LAYOUT;
    if (error == ROSPLC_OK) {
        mapped = mmap(NULL, region->geometry.object_size, writable ? PROT_READ | PROT_WRITE : PROT_READ, MAP_SHARED,
                      fd, 0);
        if (mapped == MAP_FAILED)
            error = ROSPLC_ERROR_NO_PERMISSION;
        else
            region->header = (rosplc_header *)mapped;
    }
    (void)close(fd);
    return error;
}

/* The same for a topic's object. */
static inline rosplc_error rosplc_open(rosplc_region *region, const char *path, int writable, uint32_t direction,
                                       uint32_t layout_lo, uint32_t layout_hi, uint32_t record_size)
{
    return rosplc_open_kind(region, path, writable, ROSPLC_KIND_TOPIC, direction, layout_lo, layout_hi, record_size);
}

static inline void rosplc_close(rosplc_region *region)
{
    (void)munmap(region->header, region->geometry.object_size);
    region->header = NULL;
}

#endif
