/* Blocks for PLC programs in C and C++: one call per scan, like the generated Read and Write blocks of CODESYS. plc.c
 * is the only source file; it compiles as C11 and as C++17.
 *
 *   static geometry_msgs__Twist message;
 *   static rosplc_plc_reader reader;
 *   rosplc_plc_reader_init(&reader, "rosplc", "/cmd_vel", geometry_msgs__Twist_LAYOUT_ID_LO,
 *                          geometry_msgs__Twist_LAYOUT_ID_HI, sizeof message, &message);
 *   for each scan:
 *       may_open = 1;                                 at most one attempt to open per scan, over all blocks of a task
 *       if (rosplc_plc_read(&reader, now_ms)) ...     `message` has changed; act on it if reader.is_new
 *   rosplc_plc_reader_close(&reader);                 releases claim and mapping
 *
 * Only a call that opens or closes an object makes system calls, and no call allocates memory. A block has neither
 * threads nor a clock: `now_ms` is any steady clock in milliseconds, and may wrap. In C++, rosplc::plc_reader and the
 * other classes close themselves. A block belongs to one task; a simultaneous call from another is refused (124).
 *
 * A client or server of a service or action uses the caller's records, and the call in each scan has two halves:
 *
 *   static const rosplc_plc_part parts[] = {{..., &request}, {..., &response}};    an action has a third part, feedback
 *   rosplc_plc_client_init(&client, "rosplc", "/gripper/close", "", parts, 0);
 *   for each scan:
 *       client.execute = ...;
 *       if (rosplc_plc_client_begin(&client, now_ms)) ...  fill `request`; do not change it before the call ends
 *       rosplc_plc_client_end(&client);                    if client.done, `response` is the answer
 *
 *       got = rosplc_plc_server_begin(&server, now_ms);    & ROSPLC_PLC_REQUEST: `request` contains a new request
 *       ...                                                & ROSPLC_PLC_RESPONSE: fill `response`
 *       rosplc_plc_server_end(&server); */
#ifndef ROSPLC_PLC_H
#define ROSPLC_PLC_H

#include "call.h"

/* What replaces a stale message. HOLD: nothing; ZERO: all bytes 0; SAFE: the record that `safe` points to. */
enum { ROSPLC_PLC_HOLD, ROSPLC_PLC_ZERO, ROSPLC_PLC_SAFE };

/* A message's words about its call: section 11.2. */
typedef struct {
    uint32_t status, number, caller, client[4], reason;
} rosplc_plc_call;

/* The members that all blocks have. */
typedef struct {
    /* Set by the init function, or before the first call. */
    const char *prefix, *topic, *client; /* must remain valid while the block is in use */
    uint32_t kind, layout_lo, layout_hi, record_size;
    uint32_t beat_ms;           /* the promised maximum time between two calls */
    int *may_open;              /* set to 1 at the start of each scan, shared by a task's blocks; NULL: no limit */
    /* Outputs. */
    int attached;     /* the object is open and matches */
    int peer_alive;   /* the bridge shows signs of life */
    uint32_t error;   /* 0, or a number of the format's section 9 (rosplc_error) */
    uint32_t reentries; /* calls by a second task while the first was inside */
    uint32_t found_layout_lo, found_layout_hi; /* with error 112 */
    /* Internal. */
    rosplc_region region;
    uint32_t now, elapsed, retry_at, back_off, generation, peer_beat, peer_head, silent, seed, entered;
    uint32_t other_claim, other_beat, other_head, other_silent;
    int inside, clock_runs, waiting, opened, opened_another;
} rosplc_plc_channel;

typedef struct {
    rosplc_plc_channel channel;
    /* Inputs. */
    void *record;            /* the caller's record_size bytes; overwritten by each copy, accepted or not */
    const void *safe;        /* with ROSPLC_PLC_SAFE: a record */
    uint32_t stale_after_ms; /* 0: never */
    uint32_t max_per_scan;   /* with in_order: maximum number of messages per scan */
    int on_stale, in_order, latched; /* latched: the state found when opening is a new message */
    /* Outputs, like those of the generated blocks. */
    int valid, is_new, stale, first, recovered, truncated, substituted, source_present;
    uint32_t sequence, age_ms, lost, retries, discontinuities, sources, taken, stamp_lo, stamp_hi;
    /* Internal. */
    rosplc_reader reader;
    rosplc_plc_call call, begun_call;
    uint32_t watched, writer, begun;
    int show, ever_new;
} rosplc_plc_reader;

typedef struct {
    rosplc_plc_channel channel;
    /* Inputs. */
    uint32_t stamp_lo, stamp_hi; /* the program's own time stamp in ns; both 0: none */
    /* Outputs. */
    int ready, published;
    uint32_t sequence, count, unsent, takeover_ms, taken, sinks; /* count: messages published since the start */
    /* Internal. */
    rosplc_writer writer;
    rosplc_slot_header *slot;
    rosplc_plc_call call, first_call;
    uint32_t epoch, first;
    int begun, held;
} rosplc_plc_writer;

/* A request or goal, a response or result, or the feedback of a client or server. */
typedef struct {
    uint32_t layout_lo, layout_hi, record_size;
    void *record;
} rosplc_plc_part;

enum { ROSPLC_PLC_REQUEST = 1, ROSPLC_PLC_RESPONSE = 2, ROSPLC_PLC_FEEDBACK = 4 }; /* goal and result likewise */

typedef struct {
    rosplc_plc_channel block; /* beat_ms, may_open; attached, peer_alive, error (the call's if `failed` or `aborted`) */
    /* Inputs. */
    int execute, stop;   /* stop: xAbort of a service, xCancel of an action */
    uint32_t timeout_ms; /* for the whole call; 0: no limit */
    uint32_t grace_ms;   /* how long the bridge may be silent; 0: no limit */
    /* Outputs, like those of the generated blocks. */
    int busy, done, failed, aborted, server, active, cancel_rejected, new_feedback;
    uint32_t reason, calls, late, status;
    /* Internal. */
    rosplc_plc_writer out;
    rosplc_plc_reader in, feedback;
    rosplc_plc_call mine, say;
    void *request;
    int action, running, before, send, opening, sent, giving_up, owed, stopped, accepted, asked;
    uint32_t outcome, number, limit, waited, grace, silent, of_object, answer;
} rosplc_plc_client;

/* The program's decisions, in `steps`; each takes effect when it is added. A service has REPLY and REJECT. */
enum {
    ROSPLC_PLC_REPLY = 1,
    ROSPLC_PLC_ACCEPT = 1,
    ROSPLC_PLC_REJECT = 2,
    ROSPLC_PLC_ACCEPT_CANCEL = 4,
    ROSPLC_PLC_REJECT_CANCEL = 8,
    ROSPLC_PLC_SUCCEED = 16,
    ROSPLC_PLC_ABORT = 32,
    ROSPLC_PLC_CANCELED = 64
};

typedef struct {
    rosplc_plc_channel block;
    /* Inputs. */
    uint32_t steps;
    int send_feedback; /* in this call, while `active` */
    /* Outputs, like those of the generated blocks. */
    int request, active, cancel_requested, canceling, preempt, caller_gone; /* request: xGoal of an action */
    uint32_t age_ms, callers, calls, refused;
    /* Internal. */
    rosplc_plc_reader in;
    rosplc_plc_writer out, feedback;
    rosplc_plc_call mine, say, news;
    void *response, *report;
    int action, running, send, found, shown, first_read, orphan, illegal, accepted, asked;
    uint32_t before, of_object, verdict, verdict_reason, cancel;
} rosplc_plc_server;

#ifdef __cplusplus
extern "C" {
#endif

/* Writes the name of a topic's object (section 8.1), with its NUL; ROSPLC_ERROR_NAME if prefix or topic is invalid. */
rosplc_error rosplc_plc_name(char name[ROSPLC_MAX_NAME + 1], const char *prefix, const char *topic);

/* Prepare a block, without a system call. Messages are copied to `record`. */
void rosplc_plc_reader_init(rosplc_plc_reader *r, const char *prefix, const char *topic, uint32_t layout_lo,
                            uint32_t layout_hi, uint32_t record_size, void *record);
void rosplc_plc_writer_init(rosplc_plc_writer *w, const char *prefix, const char *topic, uint32_t layout_lo,
                            uint32_t layout_hi, uint32_t record_size);

/* Call once per scan. 1: `record` contains another message than before: a new one (`is_new`), the state found when
 * opening, or the replacement of a stale one. 0: ignore `record`; keep what was copied from it earlier. */
int rosplc_plc_read(rosplc_plc_reader *r, uint32_t now_ms);

/* With in_order: takes the next message of this scan; 0: none is left, or max_per_scan have been taken. */
int rosplc_plc_next(rosplc_plc_reader *r, uint32_t now_ms);

/* The call of each scan, in two halves: begin returns the record to fill in place, or NULL; then always call end.
 * `enable` 0: the block claims and beats, but publishes nothing. */
void *rosplc_plc_write_begin(rosplc_plc_writer *w, uint32_t now_ms, int enable);
void rosplc_plc_write_end(rosplc_plc_writer *w);

/* Both halves in one call; 1 if `record` was published. */
int rosplc_plc_write(rosplc_plc_writer *w, uint32_t now_ms, int enable, const void *record);

/* Release claim and mapping. If the block is used again, it reopens the object. */
void rosplc_plc_reader_close(rosplc_plc_reader *r);
void rosplc_plc_writer_close(rosplc_plc_writer *w);

/* Prepare a client or server, without a system call. `client` is the client's name in the configuration, "" if it has
 * none. An action has three parts. */
void rosplc_plc_client_init(rosplc_plc_client *c, const char *prefix, const char *name, const char *client,
                            const rosplc_plc_part *parts, int action);
void rosplc_plc_server_init(rosplc_plc_server *s, const char *prefix, const char *name, const rosplc_plc_part *parts,
                            int action);

/* The call of each scan, in two halves. They return the records to fill now (client: the request; server: the response
 * and feedback), and those received (a server's request in the first half, a client's records in the second
 * half). */
int rosplc_plc_client_begin(rosplc_plc_client *c, uint32_t now_ms);
int rosplc_plc_client_end(rosplc_plc_client *c);
int rosplc_plc_server_begin(rosplc_plc_server *s, uint32_t now_ms);
void rosplc_plc_server_end(rosplc_plc_server *s);

void rosplc_plc_client_close(rosplc_plc_client *c);
void rosplc_plc_server_close(rosplc_plc_server *s);

#ifdef __cplusplus
}

namespace rosplc {

template <class Block, void (*Close)(Block *)> struct plc_block : Block {
    plc_block() : Block() {}
    ~plc_block() { Close(this); }
    plc_block(const plc_block &) = delete;
    plc_block &operator=(const plc_block &) = delete;
};

using plc_reader = plc_block<rosplc_plc_reader, rosplc_plc_reader_close>;
using plc_writer = plc_block<rosplc_plc_writer, rosplc_plc_writer_close>;
using plc_client = plc_block<rosplc_plc_client, rosplc_plc_client_close>;
using plc_server = plc_block<rosplc_plc_server, rosplc_plc_server_close>;

} // namespace rosplc
#endif

#endif
