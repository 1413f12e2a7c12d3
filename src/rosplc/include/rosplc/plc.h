/* Blocks for PLC programs in C and C++: one call a scan, as the generated Read and Write blocks of CODESYS. plc.c is
 * the one source file; it compiles as C11 and as C++17 alike.
 *
 *   static geometry_msgs__Twist message;
 *   static rosplc_plc_reader reader;
 *   rosplc_plc_reader_init(&reader, "rosplc", "/cmd_vel", geometry_msgs__Twist_LAYOUT_ID_LO,
 *                          geometry_msgs__Twist_LAYOUT_ID_HI, sizeof message, &message);
 *   for each scan:
 *       may_open = 1;                                 one attempt to open in a scan, over all blocks of a task
 *       if (rosplc_plc_read(&reader, now_ms)) ...     `message` has changed; act on it if reader.is_new
 *   rosplc_plc_reader_close(&reader);                 gives claim and mapping back
 *
 * Only a call that opens or closes an object makes system calls, and none allocates. A block starts no thread, and has
 * no clock: `now_ms` is any clock that runs on steadily, in milliseconds, and may wrap. In C++, rosplc::plc_reader and
 * rosplc::plc_writer close themselves. A block is used by one task; a call by a second one at once is refused (124). */
#ifndef ROSPLC_PLC_H
#define ROSPLC_PLC_H

#include "reader.h"
#include "writer.h"

/* What a message becomes that is stale. HOLD: it stays; ZERO: all bytes 0; SAFE: the record that `safe` points to. */
enum { ROSPLC_PLC_HOLD, ROSPLC_PLC_ZERO, ROSPLC_PLC_SAFE };

/* What both blocks have. */
typedef struct {
    /* Set by the init function, or before the first call. */
    const char *prefix, *topic; /* stay where they are for as long as the block is used */
    uint32_t layout_lo, layout_hi, record_size;
    uint32_t beat_ms;           /* the longest time between two calls that this block promises */
    int *may_open;              /* set to 1 at the begin of each scan, shared by a task's blocks; NULL: no limit */
    /* What the block shows. */
    int attached;     /* the object is open and fits */
    int peer_alive;   /* the bridge shows signs of life */
    uint32_t error;   /* 0, or a number of the format's section 9 (rosplc_error) */
    uint32_t reentries; /* calls by a second task while the first was inside */
    uint32_t found_layout_lo, found_layout_hi; /* with error 112 */
    /* Its own. */
    rosplc_region region;
    uint32_t now, elapsed, retry_at, back_off, generation, peer_beat, peer_head, silent, seed, entered;
    uint32_t other_claim, other_beat, other_head, other_silent;
    int inside, clock_runs, waiting, opened, opened_another;
} rosplc_plc_channel;

typedef struct {
    rosplc_plc_channel channel;
    /* Inputs. */
    void *record;            /* record_size bytes of the caller; overwritten by each copy, accepted or not */
    const void *safe;        /* with ROSPLC_PLC_SAFE: a record */
    uint32_t stale_after_ms; /* 0: never */
    uint32_t max_per_scan;   /* in order: messages in one scan at most */
    int on_stale, in_order, latched; /* latched: the state found when opening is a new message */
    /* Outputs, as those of the generated blocks. */
    int valid, is_new, stale, first, recovered, truncated, substituted, source_present;
    uint32_t sequence, age_ms, lost, retries, discontinuities, sources, taken, stamp_lo, stamp_hi;
    /* Its own. */
    rosplc_reader reader;
    uint32_t watched, writer;
    int show, ever_new;
} rosplc_plc_reader;

typedef struct {
    rosplc_plc_channel channel;
    /* Inputs. */
    uint32_t stamp_lo, stamp_hi; /* the program's own time stamp in ns; both 0: none */
    /* Outputs. */
    int ready, published;
    uint32_t sequence, count, unsent, takeover_ms, taken, sinks; /* count: messages published since the start */
    /* Its own. */
    rosplc_writer writer;
    rosplc_slot_header *slot;
} rosplc_plc_writer;

#ifdef __cplusplus
extern "C" {
#endif

/* Writes the name of a topic's object (section 8.1), with its NUL; ROSPLC_ERROR_NAME if prefix or topic is invalid. */
rosplc_error rosplc_plc_name(char name[ROSPLC_MAX_NAME + 1], const char *prefix, const char *topic);

/* Prepare a block; no system call. `record` is where messages are copied to. */
void rosplc_plc_reader_init(rosplc_plc_reader *r, const char *prefix, const char *topic, uint32_t layout_lo,
                            uint32_t layout_hi, uint32_t record_size, void *record);
void rosplc_plc_writer_init(rosplc_plc_writer *w, const char *prefix, const char *topic, uint32_t layout_lo,
                            uint32_t layout_hi, uint32_t record_size);

/* A scan's call: 1 if `record` holds another message than before: a new one (`is_new`), the state found when
 * opening, or what replaces a stale one. 0: `record` holds nothing of use; keep what was copied from it. */
int rosplc_plc_read(rosplc_plc_reader *r, uint32_t now_ms);

/* In order: the next message of this scan; 0: none is left, or max_per_scan are taken. */
int rosplc_plc_next(rosplc_plc_reader *r, uint32_t now_ms);

/* A scan's call, in two halves: the record to fill in place, or NULL; then, in any case, the end. `enable` 0: the block
 * claims and beats, and publishes nothing. */
void *rosplc_plc_write_begin(rosplc_plc_writer *w, uint32_t now_ms, int enable);
void rosplc_plc_write_end(rosplc_plc_writer *w);

/* The same at once: publishes `record`; 1 if it was published. */
int rosplc_plc_write(rosplc_plc_writer *w, uint32_t now_ms, int enable, const void *record);

/* Give claim and mapping back. The block may be used again, and opens again. */
void rosplc_plc_reader_close(rosplc_plc_reader *r);
void rosplc_plc_writer_close(rosplc_plc_writer *w);

#ifdef __cplusplus
}

namespace rosplc {

struct plc_reader : rosplc_plc_reader {
    plc_reader() : rosplc_plc_reader() {}
    ~plc_reader() { rosplc_plc_reader_close(this); }
    plc_reader(const plc_reader &) = delete;
    plc_reader &operator=(const plc_reader &) = delete;
};

struct plc_writer : rosplc_plc_writer {
    plc_writer() : rosplc_plc_writer() {}
    ~plc_writer() { rosplc_plc_writer_close(this); }
    plc_writer(const plc_writer &) = delete;
    plc_writer &operator=(const plc_writer &) = delete;
};

} // namespace rosplc
#endif

#endif
