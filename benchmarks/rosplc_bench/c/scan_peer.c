/* The other side of the scan-cycle view, where the bridge is: sends a message now and then, and reads the PLC's.
 *
 *   scan_peer none | hog
 *   scan_peer rosplc TO_ROS TO_PLC
 *   scan_peer semaphore FILE | plain FILE
 *   scan_peer modbus-slave PORT         the PLC is the server
 *   scan_peer modbus-master             the PLC is the client; prints the server's port
 *
 * Orders, each answered by a line of JSON: `go CYCLE_NS`: send at random times, between one and two cycles apart;
 * `halt`: stop that; `stall NS`: stand still for so long at the worst moment of sending a message.
 * `hog` uses a core until its input ends.
 */
#include "scan_cycle.h"

static const char *method;
static __attribute__((unused)) void *client;
static volatile uint64_t cycle;
static uint64_t sent;
static volatile int stall_asked;
static volatile uint64_t stall_ns;

static void stand_still(void)
{
    if (stall_asked)
        sleep_until(now_ns() + stall_ns);
}

static void send_message(void)
{
    message m;
    fill(&m, ++sent);
    if (!strcmp(method, "rosplc")) {
        static const rosplc_meta meta;
        rosplc_error error;
        rosplc_slot_header *slot = rosplc_writer_begin(&writer, &error);
        if (!slot)
            exit(1);
        memcpy(rosplc_record(slot), &m, SIZE / 2);
        stand_still();
        memcpy(rosplc_record(slot) + SIZE / 2, (uint8_t *)&m + SIZE / 2, SIZE - SIZE / 2);
        rosplc_writer_commit(&writer, slot, &meta);
    } else if (!strcmp(method, "semaphore")) {
        down(&areas[0].lock);
        memcpy(&areas[0].content, &m, SIZE / 2);
        stand_still();
        memcpy((uint8_t *)&areas[0].content + SIZE / 2, (uint8_t *)&m + SIZE / 2, SIZE - SIZE / 2);
        sem_post(&areas[0].lock);
    } else if (!strcmp(method, "plain")) {
        memcpy(&areas[0].content, &m, SIZE / 2);
        stand_still();
        memcpy((uint8_t *)&areas[0].content + SIZE / 2, (uint8_t *)&m + SIZE / 2, SIZE - SIZE / 2);
    }
#ifdef WITH_MODBUS
    else if (!strcmp(method, "modbus-slave")) {
        stand_still(); /* the client may stop where it will: its request is there or not */
        request_write(client, &m);
    } else if (!strcmp(method, "modbus-master")) {
        pthread_mutex_lock(&guard);
        memcpy(map->tab_registers + REGISTERS, &m, SIZE / 2);
        stand_still();
        memcpy((uint8_t *)(map->tab_registers + REGISTERS) + SIZE / 2, (uint8_t *)&m + SIZE / 2,
               SIZE - SIZE / 2);
        pthread_mutex_unlock(&guard);
    }
#endif
    else
        stand_still();
    stall_asked = 0;
}

static void receive_message(void)
{
    message m;
    if (!strcmp(method, "rosplc"))
        (void)take(&m);
    else if (!strcmp(method, "semaphore"))
        lock_and_copy(&areas[1], &m, &areas[1].content);
    else if (!strcmp(method, "plain"))
        memcpy(&m, &areas[1].content, SIZE);
#ifdef WITH_MODBUS
    else if (!strcmp(method, "modbus-slave"))
        request_read(client, &m);
    else if (!strcmp(method, "modbus-master")) {
        pthread_mutex_lock(&guard);
        memcpy(&m, map->tab_registers, SIZE);
        pthread_mutex_unlock(&guard);
    }
#endif
}

static void *work(void *nothing)
{
    uint32_t random = 2463534242u;
    uint64_t due = now_ns();
    (void)nothing;
    for (;;) {
        uint64_t period = cycle;
        if (!period) {
            due = now_ns() + 1000000;
            sleep_until(due);
            continue;
        }
        send_message();
        receive_message();
        random ^= random << 13;
        random ^= random >> 17;
        random ^= random << 5;
        due += period + (uint64_t)((double)period * random / 4294967296.0);
        if (due < now_ns())
            due = now_ns();
        sleep_until(due);
    }
    return NULL;
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
    char line[128];
    int port = 0;
    pthread_t thread;
    prepare();
    method = argc > 1 ? argv[1] : "";
    if (!strcmp(method, "rosplc") && argc == 4) {
        attach(argv[3], argv[2], 0);
    } else if ((!strcmp(method, "semaphore") || !strcmp(method, "plain")) && argc == 3) {
        areas = map_file(argv[2], 2 * sizeof *areas);
        for (int i = 0; i < 2; i++)
            if (sem_init(&areas[i].lock, 1, 1))
                stop("sem_init");
    }
#ifdef WITH_MODBUS
    else if (!strcmp(method, "modbus-slave") && argc == 3)
        client = start_client(atoi(argv[2]));
    else if (!strcmp(method, "modbus-master"))
        port = start_server(1);
#endif
    else if (strcmp(method, "none") && strcmp(method, "hog"))
        return 2;
    if (pthread_create(&thread, NULL, strcmp(method, "hog") ? work : spin, NULL))
        stop("pthread_create");
    printf("{\"ready\": true, \"port\": %d}\n", port);
    fflush(stdout);
    while (fgets(line, sizeof line, stdin)) {
        unsigned long long number = 0;
        sscanf(line, "%*s %llu", &number);
        if (!strncmp(line, "go", 2)) {
            cycle = number;
        } else if (!strncmp(line, "halt", 4)) {
            cycle = 0;
        } else if (!strncmp(line, "stall", 5)) {
            stall_ns = number;
            stall_asked = 1;
        } else {
            return 2;
        }
        printf("{\"sent\": %llu}\n", (unsigned long long)sent);
        fflush(stdout);
    }
    return 0;
}
