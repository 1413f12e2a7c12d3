/* One message one way, by size and by number of topics, in C.
 *
 *   sweep payload PATH SIZE            PATH: a channel of SIZE bytes that has no writer yet
 *   sweep topics PATHS SIZE            PATHS: a file with a channel's path per line
 *   sweep modbus-server                prints its port
 *   sweep modbus PORT SIZE             SIZE bytes in as many requests as it takes, and back
 *
 * An order is one number: how often. The answer is a line of JSON with the nanoseconds that one message took
 * (payload, modbus), or one round over all topics (topics). But for Modbus, writing and taking happen in one
 * process, one after the other: no side waits, so this is what the work itself costs.
 */
#include "objects.h"
#ifdef WITH_MODBUS
#include "libmodbus.h"
#endif

typedef struct {
    const char *name;
    void (*step)(long turn);
} contender;

static size_t size;
static uint8_t *record, *out;

/* The first and last byte tell which message arrived. */
static void mark(long turn)
{
    record[0] = record[size - 1] = (uint8_t)turn;
}

static void expect_whole(void)
{
    if (out[0] != record[0] || out[size - 1] != record[size - 1])
        fail("the messages received differ from those sent");
}

static void serve(const contender *all, int count)
{
    char line[32];
    while (fgets(line, sizeof line, stdin)) {
        long turns = number(line);
        for (int i = 0; i < count; i++) {
            uint64_t began = now_ns();
            for (long turn = 0; turn < turns; turn++)
                all[i].step(turn);
            double mean = (double)(now_ns() - began) / (double)turns;
            printf("%s\"%s\": %.1f", i ? ", " : "{", all[i].name, mean);
        }
        say("}");
    }
}

#define MOST_TOPICS 1024

static struct topic {
    rosplc_region region;
    rosplc_writer writer;
    rosplc_reader reader;
} topics[MOST_TOPICS];
static int topic_count;

static void open_topic(const char *path)
{
    struct topic *t = &topics[topic_count++];
    t->region = open_object(path, size);
    claim(&t->writer, &t->region);
    rosplc_reader_observe(&t->reader, &t->region, t->writer.head);
}

static void over_rosplc(long turn)
{
    mark(turn);
    for (int i = 0; i < topic_count; i++)
        publish(&topics[i].writer, record, size);
    for (int i = 0; i < topic_count; i++) {
        if (!take(&topics[i].reader, rosplc_take_start(ROSPLC_TAKE_NEWEST), out, size))
            fail("a message just published was not there");
        expect_whole();
    }
}

static uint8_t *slots;
static sem_t *lock;

static void over_memcpy(long turn)
{
    uint8_t *slot = slots + (size_t)(turn & 3) * size;
    mark(turn);
    memcpy(slot, record, size);
    used(slot);
    memcpy(out, slot, size);
    used(out);
}

static void over_semaphore(long turn)
{
    mark(turn);
    down(lock);
    memcpy(slots, record, size);
    sem_post(lock);
    down(lock);
    memcpy(out, slots, size);
    sem_post(lock);
    expect_whole();
}

#ifdef WITH_MODBUS
#define REGISTERS 65536
#define MOST_WRITTEN 123
#define MOST_READ 125

static void serve_registers(void)
{
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    say("{\"port\": %d}", start_server(REGISTERS));
    for (;;) {
        if (modbus_tcp_accept(server, &listener) < 0)
            stop("modbus_tcp_accept");
        for (int found; (found = modbus_receive(server, query)) >= 0;)
            if (found > 0 && modbus_reply(server, query, found, registers) < 0)
                break;
        modbus_close(server);
    }
}

static void forth(long turn)
{
    int count = (int)(size / 2);
    mark(turn + 1);
    for (int at = 0; at < count; at += MOST_WRITTEN)
        request_write(at, count - at < MOST_WRITTEN ? count - at : MOST_WRITTEN, (uint16_t *)(void *)record + at);
}

static void there_and_back(long turn)
{
    int count = (int)(size / 2);
    forth(turn);
    for (int at = 0; at < count; at += MOST_READ)
        request_read(at, count - at < MOST_READ ? count - at : MOST_READ, (uint16_t *)(void *)out + at);
    expect_whole();
}
#endif

int main(int argc, char **argv)
{
    const char *what = argc > 1 ? argv[1] : "";
    prepare();
#ifdef WITH_MODBUS
    if (!strcmp(what, "modbus-server"))
        serve_registers();
#endif
    if (argc != 4)
        return 2;
    size = (size_t)number(argv[3]);
    size += !strcmp(what, "modbus") && size % 2; /* whole registers */
    record = map(-1, size);
    out = map(-1, size);
    if (!strcmp(what, "payload")) {
        slots = map(-1, 4 * size);
        lock = map(-1, sizeof *lock);
        if (sem_init(lock, 1, 1))
            stop("sem_init");
        open_topic(argv[2]);
        serve((contender[]){{"memcpy", over_memcpy}, {"rosplc", over_rosplc}, {"semaphore", over_semaphore}}, 3);
    } else if (!strcmp(what, "topics")) {
        char line[4096];
        FILE *file = fopen(argv[2], "r");
        while (file && topic_count < MOST_TOPICS && fgets(line, sizeof line, file)) {
            line[strcspn(line, "\n")] = 0;
            open_topic(line);
        }
        if (!topic_count)
            stop(argv[2]);
        serve((contender[]){{"rosplc", over_rosplc}}, 1);
    }
#ifdef WITH_MODBUS
    else if (!strcmp(what, "modbus") && size / 2 <= REGISTERS) {
        start_client(argv[2]);
        serve((contender[]){{"modbus", forth}, {"there and back", there_and_back}}, 2);
    }
#endif
    else
        return 2;
    return 0;
}
