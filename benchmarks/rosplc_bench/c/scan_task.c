/* The PLC's task of the scan-cycle view: reads and writes one message per scan, and keeps what each scan cost.
 *
 *   scan_task none
 *   scan_task rosplc TO_PLC TO_ROS
 *   scan_task semaphore FILE
 *   scan_task plain FILE                the same memory, and nobody asks the semaphore
 *   scan_task modbus-slave              a server thread beside the task; prints its port
 *   scan_task modbus-master PORT        requests inside the task
 *
 * Order: `run CYCLE_NS SCANS PRIORITY`; priority 0 is SCHED_OTHER, else SCHED_FIFO. The answer is one line of
 * JSON: how it was scheduled, per scan how late it began and what its calls took, per new message its age
 * (ns), messages seen and torn, and scans left out because a whole period had passed.
 */
#include "scan_cycle.h"

static const char *method;
static __attribute__((unused)) void *client;

static int read_message(message *m, const message *before)
{
    if (!strcmp(method, "rosplc"))
        return rosplc_reader_news(&reader) && take(m);
    if (!strcmp(method, "semaphore"))
        lock_and_copy(&areas[0], m, &areas[0].content);
    else if (!strcmp(method, "plain"))
        memcpy(m, &areas[0].content, SIZE);
#ifdef WITH_MODBUS
    else if (!strcmp(method, "modbus-slave"))
        memcpy(m, map->tab_registers, SIZE);
    else if (!strcmp(method, "modbus-master"))
        request_read(client, m);
#endif
    else
        return 0;
    return memcmp(m, before, SIZE) != 0;
}

static void write_message(const message *m)
{
    if (!strcmp(method, "rosplc"))
        transport_send((const uint16_t *)m);
    else if (!strcmp(method, "semaphore"))
        lock_and_copy(&areas[1], &areas[1].content, m);
    else if (!strcmp(method, "plain"))
        memcpy(&areas[1].content, m, SIZE);
#ifdef WITH_MODBUS
    else if (!strcmp(method, "modbus-slave"))
        memcpy(map->tab_registers + REGISTERS, m, SIZE);
    else if (!strcmp(method, "modbus-master"))
        request_write(client, m);
#endif
}

static void print_list(const char *name, const uint64_t *values, long count)
{
    printf(", \"%s\": [", name);
    for (long i = 0; i < count; i++)
        printf("%s%llu", i ? "," : "", (unsigned long long)values[i]);
    printf("]");
}

static void run_scans(uint64_t cycle, long scans, int priority)
{
    uint64_t *late = calloc((size_t)scans, sizeof *late), *calls = calloc((size_t)scans, sizeof *calls);
    uint64_t *ages = calloc((size_t)scans, sizeof *ages);
    struct sched_param parameter = {.sched_priority = priority};
    long seen = 0, torn = 0, aged = 0, missed = 0, done = 0;
    static message in, before;
    message back = {0};
    int refused;
    if (!late || !calls || !ages)
        stop("calloc");
    memset(late, 0, (size_t)scans * sizeof *late); /* no page fault while it runs */
    memset(calls, 0, (size_t)scans * sizeof *calls);
    memset(ages, 0, (size_t)scans * sizeof *ages);
    refused = sched_setscheduler(0, priority ? SCHED_FIFO : SCHED_OTHER, &parameter) != 0;
    read_message(&in, &before); /* what stood there before is no news */
    before = in;
    uint64_t due = now_ns() + cycle;
    for (; done < scans; done++) {
        sleep_until(due);
        uint64_t began = now_ns();
        late[done] = began - due;
        int news = read_message(&in, &before);
        uint64_t now = now_ns();
        if (news) {
            seen++;
            if (is_torn(&in))
                torn++;
            else if (in.number)
                ages[aged++] = now - in.stamp_ns;
            before = in;
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
    print_list("late_ns", late, scans);
    print_list("calls_ns", calls, scans);
    print_list("ages_ns", ages, aged);
    printf("}\n");
    fflush(stdout);
    free(late);
    free(calls);
    free(ages);
}

int main(int argc, char **argv)
{
    char line[128];
    int port = 0;
    prepare();
    method = argc > 1 ? argv[1] : "";
    if (!strcmp(method, "rosplc") && argc == 4)
        attach(argv[3], argv[2], 0);
    else if ((!strcmp(method, "semaphore") || !strcmp(method, "plain")) && argc == 3)
        areas = map_file(argv[2], 2 * sizeof *areas);
#ifdef WITH_MODBUS
    else if (!strcmp(method, "modbus-slave"))
        port = start_server(0);
    else if (!strcmp(method, "modbus-master") && argc == 3)
        client = start_client(atoi(argv[2]));
#endif
    else if (strcmp(method, "none"))
        return 2;
    printf("{\"ready\": true, \"port\": %d}\n", port);
    fflush(stdout);
    while (fgets(line, sizeof line, stdin)) {
        unsigned long long cycle;
        long scans;
        int priority;
        if (sscanf(line, "run %llu %ld %d", &cycle, &scans, &priority) != 3 || !cycle || scans < 1)
            return 2;
        alarm(WATCHDOG);
        run_scans(cycle, scans, priority);
        alarm(0);
    }
    return 0;
}
