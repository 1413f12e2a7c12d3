/* A PLC program with blocks of plc.h, driven by c_plc.py: blocks by topic, variables by the names of the generated blocks. */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include <rosplc/plc.h>

typedef struct {
    char topic[256];
    int reads, enable;
    rosplc_plc_reader reader;
    rosplc_plc_writer writer;
    uint8_t *msg, *safe, *shadow;
} block;

typedef struct {
    const char *name;
    size_t offset;
} variable;

#define READER(name, member) {name, offsetof(block, reader) + offsetof(rosplc_plc_reader, member)}
#define WRITER(name, member) {name, offsetof(block, writer) + offsetof(rosplc_plc_writer, member)}
#define BOTH(KIND)                                                                                                  \
    KIND("xAttached", channel.attached), KIND("xPeerAlive", channel.peer_alive), KIND("udiError", channel.error),    \
        KIND("udiReentries", channel.reentries), KIND("udiFoundLayoutLo", channel.found_layout_lo),                  \
        KIND("udiFoundLayoutHi", channel.found_layout_hi), KIND("xInside", channel.inside),                          \
        KIND("udiWantLo", channel.layout_lo), KIND("udiWantHi", channel.layout_hi),                                  \
        KIND("udiWantSize", channel.record_size), KIND("udiBeatMs", channel.beat_ms),                                \
        KIND("udiSequence", sequence), KIND("udiStampLo", stamp_lo), KIND("udiStampHi", stamp_hi)

static const variable READS[] = {
    BOTH(READER), READER("xValid", valid), READER("xNew", is_new), READER("xStale", stale), READER("xFirst", first),
    READER("xRecovered", recovered), READER("xTruncated", truncated), READER("xSubstituted", substituted),
    READER("xSourcePresent", source_present), READER("tAge", age_ms), READER("udiLost", reader.lost),
    READER("udiRetries", reader.retries), READER("udiDiscontinuities", reader.discontinuities),
    READER("udiSources", sources), READER("uiTaken", taken), READER("tStaleAfter", stale_after_ms),
    READER("uiOnStale", on_stale), READER("xInOrder", in_order), READER("xLatched", latched),
    READER("udiLast", reader.last), READER("xFreshReader", reader.fresh), READER("xShow", show), {NULL, 0}};
static const variable WRITES[] = {
    BOTH(WRITER), WRITER("xReady", ready), WRITER("xPublished", published), WRITER("udiPublished", count),
    WRITER("udiUnsent", unsent), WRITER("tTakeover", takeover_ms), WRITER("udiTaken", taken),
    WRITER("udiSinks", sinks), {"xEnable", offsetof(block, enable)}, {NULL, 0}};

/* A client or server: the records that its block uses, and those of the program. */
typedef struct {
    char name[256], use[64];
    int serves;
    rosplc_plc_client client;
    rosplc_plc_server server;
    uint64_t own[3], msg[3];
} call;

#define CLIENT(name, member) {name, offsetof(call, client) + offsetof(rosplc_plc_client, member)}
#define SERVER(name, member) {name, offsetof(call, server) + offsetof(rosplc_plc_server, member)}
#define EITHER(KIND)                                                                                                \
    KIND("xAttached", block.attached), KIND("xPeerAlive", block.peer_alive), KIND("udiError", block.error),          \
        KIND("eError", block.error), KIND("udiBeatMs", block.beat_ms), KIND("xActive", active),                      \
        KIND("udiCalls", calls), KIND("xInside", block.inside), KIND("udiReentries", block.reentries)

static const variable CLIENTS[] = {
    EITHER(CLIENT), CLIENT("xExecute", execute), CLIENT("xAbort", stop), CLIENT("xCancel", stop),
    CLIENT("tTimeout", timeout_ms), CLIENT("tBridgeGrace", grace_ms), CLIENT("xBusy", busy), CLIENT("xDone", done), CLIENT("xError", failed),
    CLIENT("xAborted", aborted), CLIENT("xServer", server), CLIENT("eReason", reason), CLIENT("udiLate", late),
    CLIENT("xCancelRejected", cancel_rejected), CLIENT("xNewFeedback", new_feedback), CLIENT("eStatus", status),
    {NULL, 0}};
static const variable SERVERS[] = {
    EITHER(SERVER), SERVER("steps", steps), SERVER("xSendFeedback", send_feedback), SERVER("xRequest", request),
    SERVER("xGoal", request), SERVER("xCancelRequested", cancel_requested), SERVER("xCanceling", canceling),
    SERVER("xPreempt", preempt), SERVER("xCallerGone", caller_gone), SERVER("tAge", age_ms),
    SERVER("udiCallers", callers), SERVER("udiRefused", refused), {NULL, 0}};

#ifdef __cplusplus
extern "C" {
#endif

void (*c_inside)(void); /* called at each fence */

static int may_open;
static char directory[256], prefix[64];
uint32_t opens, opened, closes;

void c_fence(void)
{
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    if (c_inside)
        c_inside();
}

int __real_open(const char *path, int flags, ...);
int __wrap_open(const char *path, int flags, ...);
void *__real_mmap(void *at, size_t size, int protection, int flags, int file, off_t offset);
void *__wrap_mmap(void *at, size_t size, int protection, int flags, int file, off_t offset);
int __real_munmap(void *at, size_t size);
int __wrap_munmap(void *at, size_t size);

int __wrap_open(const char *path, int flags, ...)
{
    char moved[512];
    opens++;
    snprintf(moved, sizeof moved, "%s/%s", directory, path + strlen("/dev/shm/"));
    return __real_open(moved, flags);
}

void *__wrap_mmap(void *at, size_t size, int protection, int flags, int file, off_t offset)
{
    opened++;
    return __real_mmap(at, size, protection, flags, file, offset);
}

int __wrap_munmap(void *at, size_t size)
{
    closes++;
    return __real_munmap(at, size);
}

void c_start(const char *in, const char *with)
{
    snprintf(directory, sizeof directory, "%s", in);
    snprintf(prefix, sizeof prefix, "%s", with);
}

void *c_block(const char *topic, int reads, uint32_t lo, uint32_t hi, uint32_t size)
{
    block *b = (block *)calloc(1, sizeof *b);
    snprintf(b->topic, sizeof b->topic, "%s", topic);
    b->reads = reads;
    b->msg = (uint8_t *)calloc(3, size);
    b->safe = b->msg + size;
    b->shadow = b->safe + size;
    rosplc_plc_reader_init(&b->reader, prefix, b->topic, lo, hi, size, b->shadow);
    rosplc_plc_writer_init(&b->writer, prefix, b->topic, lo, hi, size);
    b->reader.safe = b->safe;
    b->reader.channel.may_open = b->writer.channel.may_open = &may_open;
    return b;
}

void c_new_scan(void)
{
    may_open = 1;
}

static int took(block *b, int got)
{
    if (got)
        memcpy(b->msg, b->shadow, b->reader.channel.record_size);
    return b->reader.is_new;
}

int c_call(block *b, uint32_t now)
{
    if (b->reads)
        return took(b, rosplc_plc_read(&b->reader, now));
    return rosplc_plc_write(&b->writer, now, b->enable, b->msg);
}

int c_next(block *b, uint32_t now)
{
    int got = rosplc_plc_next(&b->reader, now);
    (void)took(b, got);
    return got;
}

void c_end(block *b)
{
    rosplc_plc_reader_close(&b->reader);
    rosplc_plc_writer_close(&b->writer);
    free(b->msg);
    free(b);
}

static uint32_t *place(void *b, const variable *v, const char *name)
{
    for (; v->name; v++) {
        if (strcmp(v->name, name) == 0)
            return (uint32_t *)(void *)((uint8_t *)b + v->offset);
    }
    return NULL;
}

uint32_t *c_variable(block *b, const char *name)
{
    return place(b, b->reads ? READS : WRITES, name);
}

call *c_use(const char *name, const char *use, int serves, int action, const uint32_t *layouts)
{
    call *b = (call *)calloc(1, sizeof *b);
    rosplc_plc_part parts[3];
    for (int i = 0; i < 2 + action; i++, layouts += 3) {
        parts[i].layout_lo = layouts[0];
        parts[i].layout_hi = layouts[1];
        parts[i].record_size = layouts[2];
        parts[i].record = &b->own[i];
    }
    snprintf(b->name, sizeof b->name, "%s", name);
    snprintf(b->use, sizeof b->use, "%s", use);
    b->serves = serves;
    rosplc_plc_client_init(&b->client, prefix, b->name, b->use, parts, action);
    rosplc_plc_server_init(&b->server, prefix, b->name, parts, action);
    b->client.block.may_open = b->server.block.may_open = &may_open;
    return b;
}

void c_use_scan(call *b, uint32_t now)
{
    int got;
    if (b->serves) {
        got = rosplc_plc_server_begin(&b->server, now);
        if (got & ROSPLC_PLC_REQUEST)
            b->msg[0] = b->own[0];
        if (got & ROSPLC_PLC_RESPONSE)
            b->own[1] = b->msg[1];
        if (got & ROSPLC_PLC_FEEDBACK)
            b->own[2] = b->msg[2];
        rosplc_plc_server_end(&b->server);
        return;
    }
    if (rosplc_plc_client_begin(&b->client, now))
        b->own[0] = b->msg[0];
    got = rosplc_plc_client_end(&b->client);
    if (got & ROSPLC_PLC_RESPONSE)
        b->msg[1] = b->own[1];
    if (got & ROSPLC_PLC_FEEDBACK)
        b->msg[2] = b->own[2];
}

uint32_t *c_use_variable(call *b, const char *name)
{
    return place(b, b->serves ? SERVERS : CLIENTS, name);
}

void *c_use_record(call *b, int part)
{
    return &b->msg[part];
}

void c_use_end(call *b)
{
    rosplc_plc_client_close(&b->client);
    rosplc_plc_server_close(&b->server);
    free(b);
}

uint8_t *c_record(block *b, const char *name)
{
    return strcmp(name, "stSafe") == 0 ? b->safe : b->msg;
}

rosplc_error c_name(char *name, const char *with, const char *topic)
{
    return rosplc_plc_name(name, with, topic);
}

#ifdef __cplusplus
}
#endif
