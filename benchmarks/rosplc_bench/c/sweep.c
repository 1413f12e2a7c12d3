/* One message one way, by size and by number of topics, in C.
 *
 *   sweep payload PATH SIZE            PATH: a channel of SIZE bytes that nobody writes yet
 *   sweep topics PATHS SIZE            PATHS: a file with a channel's path per line
 *   sweep modbus-server                prints its port
 *   sweep modbus PORT SIZE             SIZE bytes in as many requests as it takes, and back
 *
 * An order is one number: how often. The answer is a line of JSON with the nanoseconds that one message took
 * (payload, modbus), or one round over all topics (topics). But for Modbus, writing and taking happen in one
 * process, one after the other: nobody waits, so this is what the work itself costs.
 */
#include <pthread.h>

#include <rosplc/channel.h>
#include "shared.h"
#ifdef WITH_MODBUS
#include <modbus.h>
#include <netinet/in.h>
#include <sys/socket.h>
#endif

static void transport_send(const uint16_t *values) { (void)values; }
static int transport_try(uint16_t *values) { (void)values; return 0; }
static void transport_ring(void) {}
static void transport_sleep(void) {}

typedef struct {
    rosplc_region region;
    rosplc_writer writer;
    rosplc_reader reader;
} topic;

static void open_topic(topic *t, const char *path)
{
    struct stat status;
    uint8_t first[ROSPLC_HEADER_SIZE];
    int fd = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0 || fstat(fd, &status) || read(fd, first, sizeof first) != (ssize_t)sizeof first)
        stop(path);
    if (rosplc_identity_check(first, (uint64_t)status.st_size, 0, &t->region.geometry)) {
        fprintf(stderr, "%s is not an object\n", path);
        exit(1);
    }
    t->region.header = mmap(NULL, t->region.geometry.object_size, PROT_READ | PROT_WRITE,
                            MAP_SHARED | MAP_POPULATE, fd, 0);
    if (t->region.header == MAP_FAILED)
        stop(path);
    close(fd);
    if (rosplc_writer_claim(&t->writer, &t->region, 0, (uint32_t)getpid(), 1000, (uint32_t)getpid())) {
        fprintf(stderr, "%s is in use\n", path);
        exit(1);
    }
    rosplc_reader_observe(&t->reader, &t->region, t->writer.head);
}

static void publish(topic *t, const uint8_t *record)
{
    static const rosplc_meta meta;
    rosplc_error error;
    rosplc_slot_header *slot = rosplc_writer_begin(&t->writer, &error);
    if (!slot)
        exit(1);
    memcpy(rosplc_record(slot), record, t->region.geometry.record_size);
    rosplc_writer_commit(&t->writer, slot, &meta);
}

static void take(topic *t, uint8_t *out)
{
    rosplc_take attempt = rosplc_take_start(ROSPLC_TAKE_NEWEST);
    while (rosplc_take_begin(&t->reader, &attempt)) {
        memcpy(out, rosplc_record(attempt.slot), t->region.geometry.record_size);
        if (rosplc_take_check(&t->reader, &attempt)) {
            rosplc_take_accept(&t->reader, &attempt);
            return;
        }
    }
    fprintf(stderr, "a message just published was not there\n");
    exit(1);
}

/* Keeps a copy that nobody reads. */
static void used(void *memory)
{
    __asm__ volatile("" : : "r"(memory) : "memory");
}

static uint8_t *zeroed(size_t size)
{
    void *memory = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS | MAP_POPULATE, -1, 0);
    if (memory == MAP_FAILED)
        stop("mmap");
    return memory;
}

/* The last byte tells whether it was this message that arrived. */
static void expect(const uint8_t *out, const uint8_t *record, size_t size)
{
    if (out[0] != record[0] || out[size - 1] != record[size - 1]) {
        fprintf(stderr, "what arrived is not what was sent\n");
        exit(1);
    }
}

static void report(const char *name, uint64_t spent, long count)
{
    printf("\"%s\": %.1f", name, (double)spent / (double)count);
}

static void payload(const char *path, size_t size)
{
    char line[32];
    topic t;
    uint8_t *record = zeroed(size), *out = zeroed(size), *four = zeroed(4 * size);
    sem_t *lock = (sem_t *)(void *)zeroed(sizeof *lock);
    open_topic(&t, path);
    if (t.region.geometry.record_size != size || sem_init(lock, 1, 1))
        stop("payload");
    while (fgets(line, sizeof line, stdin)) {
        long count = number(line);
        uint64_t a = now_ns(), b, c, d;
        for (long i = 0; i < count; i++) {
            uint8_t *slot = four + (size_t)(i & 3) * size;
            record[0] = record[size - 1] = (uint8_t)i;
            memcpy(slot, record, size);
            used(slot);
            memcpy(out, slot, size);
            used(out);
        }
        b = now_ns();
        for (long i = 0; i < count; i++) {
            record[0] = record[size - 1] = (uint8_t)i;
            publish(&t, record);
            take(&t, out);
            expect(out, record, size);
        }
        c = now_ns();
        for (long i = 0; i < count; i++) {
            record[0] = record[size - 1] = (uint8_t)i;
            down(lock);
            memcpy(four, record, size);
            sem_post(lock);
            down(lock);
            memcpy(out, four, size);
            sem_post(lock);
            expect(out, record, size);
        }
        d = now_ns();
        printf("{");
        report("memcpy", b - a, count);
        printf(", ");
        report("rosplc", c - b, count);
        printf(", ");
        report("semaphore", d - c, count);
        printf("}\n");
        fflush(stdout);
    }
}

static void topics(const char *paths, size_t size)
{
    char line[4096];
    long count = 0;
    uint8_t *record = zeroed(size), *out = zeroed(size);
    static topic all[1024];
    FILE *file = fopen(paths, "r");
    if (!file)
        stop(paths);
    while (count < 1024 && fgets(line, sizeof line, file)) {
        line[strcspn(line, "\n")] = 0;
        open_topic(&all[count++], line);
    }
    fclose(file);
    while (fgets(line, sizeof line, stdin)) {
        long rounds = number(line);
        uint64_t a = now_ns(), b;
        for (long i = 0; i < rounds; i++) {
            record[0] = record[size - 1] = (uint8_t)i;
            for (long n = 0; n < count; n++)
                publish(&all[n], record);
            for (long n = 0; n < count; n++) {
                take(&all[n], out);
                expect(out, record, size);
            }
        }
        b = now_ns();
        printf("{");
        report("rosplc", b - a, rounds);
        printf("}\n");
        fflush(stdout);
    }
}

#ifdef WITH_MODBUS
#define REGISTERS 65536
#define MOST_WRITTEN 123
#define MOST_READ 125

static void serve(void)
{
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    modbus_t *server = modbus_new_tcp("127.0.0.1", 0);
    modbus_mapping_t *map = modbus_mapping_new(0, 0, REGISTERS, 0);
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    int listener;
    if (!server || !map || (listener = modbus_tcp_listen(server, 1)) < 0)
        stop("modbus_tcp_listen");
    if (getsockname(listener, (struct sockaddr *)&address, &size))
        stop("getsockname");
    printf("{\"port\": %d}\n", ntohs(address.sin_port));
    fflush(stdout);
    for (;;) {
        if (modbus_tcp_accept(server, &listener) < 0)
            stop("modbus_tcp_accept");
        for (int found; (found = modbus_receive(server, query)) >= 0;)
            if (found > 0 && modbus_reply(server, query, found, map) < 0)
                break;
        modbus_close(server);
    }
}

static void ask(int port, size_t size)
{
    char line[32];
    long registers = (long)(size + 1) / 2;
    uint16_t *values = (uint16_t *)(void *)zeroed((size_t)registers * 2);
    uint16_t *back = (uint16_t *)(void *)zeroed((size_t)registers * 2);
    modbus_t *client = modbus_new_tcp("127.0.0.1", port);
    if (registers > REGISTERS || !client || modbus_connect(client) < 0)
        stop("modbus_connect");
    while (fgets(line, sizeof line, stdin)) {
        long count = number(line);
        uint64_t a = now_ns(), b, c;
        for (long i = 0; i < count; i++) {
            values[0] = values[registers - 1] = (uint16_t)(i + 1);
            for (long at = 0; at < registers; at += MOST_WRITTEN) {
                int part = (int)(registers - at < MOST_WRITTEN ? registers - at : MOST_WRITTEN);
                if (modbus_write_registers(client, (int)at, part, values + at) != part)
                    stop("modbus_write_registers");
            }
        }
        b = now_ns();
        for (long i = 0; i < count; i++)
            for (long at = 0; at < registers; at += MOST_READ) {
                int part = (int)(registers - at < MOST_READ ? registers - at : MOST_READ);
                if (modbus_read_registers(client, (int)at, part, back + at) != part)
                    stop("modbus_read_registers");
            }
        c = now_ns();
        if (memcmp(back, values, (size_t)registers * 2)) {
            fprintf(stderr, "what arrived is not what was sent\n");
            exit(1);
        }
        printf("{");
        report("modbus", b - a, count);
        printf(", ");
        report("there and back", c - a, count);
        printf("}\n");
        fflush(stdout);
    }
}
#endif

int main(int argc, char **argv)
{
    const char *what = argc > 1 ? argv[1] : "";
    prepare();
    if (!strcmp(what, "payload") && argc == 4)
        payload(argv[2], (size_t)number(argv[3]));
    else if (!strcmp(what, "topics") && argc == 4)
        topics(argv[2], (size_t)number(argv[3]));
#ifdef WITH_MODBUS
    else if (!strcmp(what, "modbus-server"))
        serve();
    else if (!strcmp(what, "modbus") && argc == 4)
        ask(atoi(argv[2]), (size_t)number(argv[3]));
#endif
    else
        return 2;
    return 0;
}
