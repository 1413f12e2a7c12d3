/* What the PLC's task and the other side share in the scan-cycle view: the message, orders, and the clock.
 *
 * A message has 200 bytes: 25 numbers of 64 bits. The first is when it was sent (ns, CLOCK_MONOTONIC), the
 * second its number, and every other one must equal the number: if one does not, the message is torn.
 */
#ifndef ROSPLC_BENCH_SCAN_CYCLE_H
#define ROSPLC_BENCH_SCAN_CYCLE_H

#ifndef _GNU_SOURCE
#define _GNU_SOURCE
#endif
#include <pthread.h>

#include "channel_peer.h"
#ifdef WITH_MODBUS
#include <modbus.h>
#include <netinet/in.h>
#include <sys/socket.h>
#endif

#define WORDS 25
#define SIZE BYTES
#define REGISTERS (WORDS * 4)

typedef struct {
    uint64_t stamp_ns, number, rest[WORDS - 2];
} message;
_Static_assert(sizeof(message) == BYTES, "the message is 25 numbers");

/* The source's design: a semaphore as a lock, and the message behind it, one such thing per direction. An
 * unnamed semaphore in the memory itself is what a named one maps, and leaves no name behind. */
typedef struct {
    sem_t lock;
    _Alignas(64) message content;
} locked;

static __attribute__((unused)) void fill(message *m, uint64_t number)
{
    m->number = number;
    for (int i = 0; i < WORDS - 2; i++)
        m->rest[i] = number;
    m->stamp_ns = now_ns();
}

static __attribute__((unused)) int is_torn(const message *m)
{
    for (int i = 0; i < WORDS - 2; i++)
        if (m->rest[i] != m->number)
            return 1;
    return 0;
}

static __attribute__((unused)) void sleep_until(uint64_t tick)
{
    struct timespec t = {(time_t)(tick / 1000000000u), (long)(tick % 1000000000u)};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR)
        ;
}

/* The newest message, as a PLC program takes it; publishing is transport_send(). */
static __attribute__((unused)) int take(message *m)
{
    rosplc_take t = rosplc_take_start(ROSPLC_TAKE_NEWEST);
    while (rosplc_take_begin(&reader, &t)) {
        memcpy(m, rosplc_record(t.slot), SIZE);
        if (rosplc_take_check(&reader, &t)) {
            rosplc_take_accept(&reader, &t);
            return 1;
        }
    }
    return 0;
}

/* What the semaphore's side maps: index 0 towards the PLC, 1 back. */
static locked *areas;

static __attribute__((unused)) void lock_and_copy(locked *area, message *to, const message *from)
{
    down(&area->lock);
    memcpy(to, from, SIZE);
    sem_post(&area->lock);
}

#ifdef WITH_MODBUS
/* A server in a thread of its own, as a PLC's runtime has it: registers 0 … from the client, REGISTERS … to it.
 * With `guard` it holds that lock while it answers. */
static modbus_mapping_t *map;
static pthread_mutex_t guard = PTHREAD_MUTEX_INITIALIZER;

static void *serve(void *listener)
{
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    modbus_t *server = ((void **)listener)[0];
    int socket = *(int *)((void **)listener)[1], guarded = *(int *)((void **)listener)[2];
    if (modbus_tcp_accept(server, &socket) < 0)
        stop("modbus_tcp_accept");
    for (;;) {
        int size = modbus_receive(server, query);
        if (size < 0)
            return NULL; /* the client has gone */
        if (guarded)
            pthread_mutex_lock(&guard);
        if (size > 0 && modbus_reply(server, query, size, map) < 0)
            stop("modbus_reply");
        if (guarded)
            pthread_mutex_unlock(&guard);
    }
}

/* Returns the port. */
static __attribute__((unused)) int start_server(int guarded)
{
    static modbus_t *server;
    static int listener, with;
    static void *arguments[3] = {NULL, &listener, &with};
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    pthread_t thread;
    with = guarded;
    server = arguments[0] = modbus_new_tcp("127.0.0.1", 0);
    map = modbus_mapping_new(0, 0, 2 * REGISTERS, 0);
    if (!server || !map || (listener = modbus_tcp_listen(server, 1)) < 0)
        stop("modbus_tcp_listen");
    if (getsockname(listener, (struct sockaddr *)&address, &size))
        stop("getsockname");
    if (pthread_create(&thread, NULL, serve, arguments))
        stop("pthread_create");
    return ntohs(address.sin_port);
}

static __attribute__((unused)) modbus_t *start_client(int port)
{
    modbus_t *client = modbus_new_tcp("127.0.0.1", port);
    if (!client || modbus_connect(client) < 0)
        stop("modbus_connect");
    return client;
}

/* Both sides are this machine, so the registers simply hold the message's bytes, 16 bits each. */
static __attribute__((unused)) void request_write(modbus_t *client, const message *m)
{
    uint16_t registers[REGISTERS];
    memcpy(registers, m, SIZE);
    if (modbus_write_registers(client, 0, REGISTERS, registers) != REGISTERS)
        stop("modbus_write_registers");
}

static __attribute__((unused)) void request_read(modbus_t *client, message *m)
{
    uint16_t registers[REGISTERS];
    if (modbus_read_registers(client, REGISTERS, REGISTERS, registers) != REGISTERS)
        stop("modbus_read_registers");
    memcpy(m, registers, SIZE);
}
#endif

#endif
