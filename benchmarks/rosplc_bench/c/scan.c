/* The scan-cycle view: a PLC's task that reads and writes one message per scan, and the other side, where the
 * bridge is, that sends a message now and then and reads the PLC's.
 *
 *   scan task|peer none
 *   scan task|peer rosplc OUT IN
 *   scan task|peer semaphore FILE
 *   scan task|peer plain FILE            the same memory, without the semaphore
 *   scan task|peer modbus-slave [PORT]   the PLC is the server, in a thread beside its task; prints its port
 *   scan task|peer modbus-master [PORT]  the PLC asks inside its task
 *   scan hog                             uses a core until its input ends
 *
 * Orders of the task: `run CYCLE_NS SCANS PRIORITY`; priority 0 is SCHED_OTHER, else SCHED_FIFO. The answer is one
 * line of JSON: how it was scheduled, per scan how late it began and what its calls took, per new message its
 * age (ns), messages seen and torn, and scans left out because a whole period had passed.
 * Orders of the peer, each answered by a line of JSON: `go CYCLE_NS`: send at random times, between one and two
 * cycles apart; `halt`: stop that; `stall NS`: stand still for so long at the worst moment of sending a message.
 *
 * A message has 200 bytes: 25 numbers of 64 bits. The first is when it was sent (ns, CLOCK_MONOTONIC), the
 * second its number, and every other one must equal the number: if one does not, the message is torn.
 */
#include "objects.h"

#include <pthread.h>

#ifdef WITH_MODBUS
#include "libmodbus.h"
#endif

#define WORDS 25
#define REGISTERS (WORDS * 4)

typedef struct {
    uint64_t stamp_ns, number, rest[WORDS - 2];
} message;
_Static_assert(sizeof(message) == BYTES, "the message is 25 numbers");

static void fill(message *m, uint64_t number)
{
    m->number = number;
    for (int i = 0; i < WORDS - 2; i++)
        m->rest[i] = number;
    m->stamp_ns = now_ns();
}

static int is_torn(const message *m)
{
    for (int i = 0; i < WORDS - 2; i++)
        if (m->rest[i] != m->number)
            return 1;
    return 0;
}

static volatile int stall_asked;
static volatile uint64_t stall_ns;

static void stand_still(void)
{
    if (stall_asked)
        sleep_until(now_ns() + stall_ns);
    stall_asked = 0;
}

/* Copies a message that is sent: in its middle this side may stop. */
static void copy(void *to, const message *from)
{
    memcpy(to, from, BYTES / 2);
    stand_still();
    memcpy((uint8_t *)to + BYTES / 2, (const uint8_t *)from + BYTES / 2, BYTES - BYTES / 2);
}

/* ---------------------------------------------------------------- the methods */

static int read_rosplc(message *m)
{
    return rosplc_reader_news(&reader) && take(&reader, rosplc_take_start(ROSPLC_TAKE_NEWEST), m, BYTES);
}

static void write_rosplc(const message *m)
{
    rosplc_slot_header *slot = begin(&writer);
    copy(rosplc_record(slot), m);
    commit(&writer, slot);
}

/* The design of the thesis: a semaphore as a lock, and the message behind it, one such thing per direction. An
 * unnamed semaphore in the memory itself is what a named one maps, and leaves no name behind. */
typedef struct {
    sem_t lock;
    _Alignas(64) message content;
} area;

static area *out, *in;

static int read_plain(message *m)
{
    memcpy(m, &in->content, BYTES);
    return 1;
}

static void write_plain(const message *m)
{
    copy(&out->content, m);
}

static int read_semaphore(message *m)
{
    down(&in->lock);
    read_plain(m);
    sem_post(&in->lock);
    return 1;
}

static void write_semaphore(const message *m)
{
    down(&out->lock);
    write_plain(m);
    sem_post(&out->lock);
}

#ifdef WITH_MODBUS
/* A server in a thread of its own, as a PLC's runtime has it: registers 0 … from the client, REGISTERS … to it.
 * The peer's server holds the lock while it answers; a PLC's program copies beside its server. Both sides are this
 * machine, so the registers simply hold the message's bytes, 16 bits each. */
static pthread_mutex_t guard = PTHREAD_MUTEX_INITIALIZER;
static int guarded;

static void lock(void)
{
    if (guarded)
        pthread_mutex_lock(&guard);
}

static void unlock(void)
{
    if (guarded)
        pthread_mutex_unlock(&guard);
}

static void *serve(void *nothing)
{
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    if (modbus_tcp_accept(server, &listener) < 0)
        stop("modbus_tcp_accept");
    for (;;) {
        int size = modbus_receive(server, query);
        if (size < 0)
            return nothing; /* the client has gone */
        lock();
        if (size > 0 && modbus_reply(server, query, size, registers) < 0)
            stop("modbus_reply");
        unlock();
    }
}

static int read_server(message *m)
{
    lock();
    memcpy(m, registers->tab_registers, BYTES);
    unlock();
    return 1;
}

static void write_server(const message *m)
{
    lock();
    copy(registers->tab_registers + REGISTERS, m);
    unlock();
}

static int read_client(message *m)
{
    request_read(REGISTERS, REGISTERS, (uint16_t *)m);
    return 1;
}

static void write_client(const message *m)
{
    stand_still(); /* the client may stop where it will: its request is there or not */
    request_write(0, REGISTERS, (const uint16_t *)m);
}
#endif

static int read_nothing(message *m)
{
    (void)m;
    return 0;
}

static void write_nothing(const message *m)
{
    (void)m;
    stand_still();
}

static int (*read_message)(message *) = read_nothing;
static void (*write_message)(const message *) = write_nothing;

static void start_thread(void *(*work)(void *))
{
    pthread_t thread;
    if (pthread_create(&thread, NULL, work, NULL))
        stop("pthread_create");
}

/* Chooses the method; returns the port of its server, or 0. */
static int choose(int peer, const char *method, int count, char **places)
{
    if (!strcmp(method, "rosplc") && count == 2) {
        attach(places[0], places[1], 0);
        read_message = read_rosplc;
        write_message = write_rosplc;
    } else if ((!strcmp(method, "semaphore") || !strcmp(method, "plain")) && count == 1) {
        area *areas = map_file(places[0], 2 * sizeof *areas);
        out = &areas[!peer];
        in = &areas[peer];
        for (int i = 0; peer && i < 2; i++)
            if (sem_init(&areas[i].lock, 1, 1))
                stop("sem_init");
        read_message = *method == 's' ? read_semaphore : read_plain;
        write_message = *method == 's' ? write_semaphore : write_plain;
    }
#ifdef WITH_MODBUS
    else if (!strncmp(method, "modbus-", 7) && count == 1) {
        start_client(places[0]);
        read_message = read_client;
        write_message = write_client;
    } else if (!strncmp(method, "modbus-", 7)) {
        int port = start_server(2 * REGISTERS);
        guarded = peer;
        read_message = read_server;
        write_message = write_server;
        start_thread(serve);
        return port;
    }
#endif
    else if (strcmp(method, "none"))
        fail("no method %s", method);
    return 0;
}

/* ---------------------------------------------------------------- the PLC's task */

static void run_scans(uint64_t cycle, long scans, int priority)
{
    size_t size = (size_t)scans * sizeof(uint64_t) + 1;
    uint64_t *late = map(-1, size), *calls = map(-1, size), *ages = map(-1, size);
    struct sched_param parameter = {.sched_priority = priority};
    long seen = 0, torn = 0, aged = 0, missed = 0;
    static message here, before;
    message back = {0};
    int refused = sched_setscheduler(0, priority ? SCHED_FIFO : SCHED_OTHER, &parameter) != 0;
    read_message(&here); /* what was there before is no news */
    before = here;
    uint64_t due = now_ns() + cycle;
    for (long done = 0; done < scans; done++) {
        sleep_until(due);
        uint64_t began = now_ns();
        late[done] = began - due;
        int news = read_message(&here) && memcmp(&here, &before, BYTES);
        uint64_t now = now_ns();
        if (news) {
            seen++;
            if (is_torn(&here))
                torn++;
            else if (here.number)
                ages[aged++] = now - here.stamp_ns;
            before = here;
        }
        fill(&back, (uint64_t)done + 1);
        uint64_t again = now_ns();
        write_message(&back);
        calls[done] = (now_ns() - again) + (now - began);
        due += cycle;
        uint64_t end = now_ns();
        if (end > due + cycle) { /* as runtimes do: a scan whose whole period has passed is left out */
            uint64_t skipped = (end - due) / cycle;
            missed += (long)skipped;
            due += skipped * cycle;
        }
    }
    parameter.sched_priority = 0;
    sched_setscheduler(0, SCHED_OTHER, &parameter);
    printf("{\"scheduling\": \"%s\", \"seen\": %ld, \"torn\": %ld, \"missed\": %ld",
           !priority ? "SCHED_OTHER" : refused ? "refused" : "SCHED_FIFO", seen, torn, missed);
    print_list(", \"late_ns\": ", late, scans);
    print_list(", \"calls_ns\": ", calls, scans);
    print_list(", \"ages_ns\": ", ages, aged);
    say("}");
    munmap(late, size);
    munmap(calls, size);
    munmap(ages, size);
}

/* ---------------------------------------------------------------- the other side */

static volatile uint64_t peer_cycle;
static uint64_t sent;

static void *send_now_and_then(void *nothing)
{
    uint32_t random = 2463534242u;
    uint64_t due = now_ns();
    message m;
    for (;;) {
        uint64_t period = peer_cycle;
        if (!period) {
            due = now_ns() + 1000000;
            sleep_until(due);
            continue;
        }
        fill(&m, ++sent);
        write_message(&m);
        read_message(&m);
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        due += period + (uint64_t)((double)period * random / 4294967296.0);
        if (due < now_ns())
            due = now_ns();
        sleep_until(due);
    }
    return nothing;
}

static void *spin(void *nothing)
{
    volatile uint64_t counter = 0;
    for (;;)
        counter = counter + 1;
    return nothing;
}

int main(int argc, char **argv)
{
    char line[128], word[8];
    const char *role = argc > 1 ? argv[1] : "";
    int peer = !strcmp(role, "peer"), port = 0, found, priority;
    unsigned long long value;
    long scans;
    prepare();
    if (!strcmp(role, "hog"))
        start_thread(spin);
    else if (argc > 2)
        port = choose(peer, argv[2], argc - 3, argv + 3);
    if (peer)
        start_thread(send_now_and_then);
    say("{\"ready\": true, \"port\": %d}", port);
    while (fgets(line, sizeof line, stdin)) {
        found = sscanf(line, "%7s %llu %ld %d", word, &value, &scans, &priority);
        if (!peer && found == 4 && value && scans > 0) {
            alarm(WATCHDOG);
            run_scans(value, scans, priority);
            alarm(0);
            continue;
        }
        if (peer && !strcmp(word, "stall") && found == 2) {
            stall_ns = value;
            stall_asked = 1;
        } else if (peer && (found == 2 || !strcmp(word, "halt"))) {
            peer_cycle = found == 2 ? value : 0;
        } else {
            return 2;
        }
        say("{\"sent\": %llu}", (unsigned long long)sent);
    }
    return 0;
}
