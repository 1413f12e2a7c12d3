/* B as a PLC: runs translated Structured Text scan by scan. All that B does in the exchange the text does: the
 * generated blocks take and publish, PLC_PRG adds one to each number and counts its answers in udiAnswered.
 *
 *   st_host B FOLDER
 *
 * Compiled together with the translated program and tests/st/rosplc_st/runtime of a checkout.
 */
#include "exchange.h"
#include "st_runtime.h"

#define PROGRAMS 3

static const struct st_program *programs[PROGRAMS];
static const uint32_t *answered;
static const uint8_t *ready;

/* The text does what these would do. */
static void transport_send(const uint16_t *values) { (void)values; }
static int transport_try(uint16_t *values) { (void)values; return 1; }
static void transport_ring(void) {}
static void transport_sleep(void) {}

static const struct st_program *program(const char *name)
{
    for (const struct st_program *p = st_programs; p->name; p++)
        if (!strcasecmp(p->name, name))
            return p;
    fprintf(stderr, "no program %s\n", name);
    exit(1);
}

static const void *variable(const struct st_program *p, const char *name)
{
    for (const struct st_member *m = st_members; m->owner; m++)
        if (!strcasecmp(m->owner, p->name) && !strcasecmp(m->name, name))
            return (const uint8_t *)*p->instance + m->offset;
    fprintf(stderr, "no variable %s\n", name);
    exit(1);
}

static void scan(void)
{
    for (int i = 0; i < PROGRAMS; i++)
        programs[i]->body(*programs[i]->instance);
}

/* Until the blocks have opened their objects and hold their claims, as after a PLC's start. */
static void come_up(void)
{
    struct timespec pause = {0, 500000};
    for (int i = 0; i < 40 || !*ready; i++) {
        if (i == 10000) {
            fprintf(stderr, "the blocks do not come up\n");
            exit(1);
        }
        scan();
        nanosleep(&pause, NULL);
    }
}

int main(int argc, char **argv)
{
    static char line[4096];
    if (argc != 3)
        return 2;
    prepare();
    st_set_directory(argv[2]);
    st_options.real_clock = 1;
    st_start();
    programs[0] = program("SharedMemory_Read");
    programs[1] = program("PLC_PRG");
    programs[2] = program("SharedMemory_Write");
    answered = variable(programs[1], "udiAnswered");
    ready = variable(programs[1], "xReady");
    come_up();
    printf("ready\n");
    fflush(stdout);
    while (fgets(line, sizeof line, stdin)) {
        strtok(line, " \n");
        set_order('B');
        uint32_t end = *answered + (uint32_t)number(strtok(NULL, " \n"));
        alarm(WATCHDOG);
        come_up(); /* the other side was silent meanwhile: the blocks may have opened their objects again */
        printf("answering\n");
        fflush(stdout);
        while (*answered != end) {
            if (order.wait == CYCLE)
                sleep_to_tick();
            scan();
        }
        alarm(0);
    }
    st_stop();
    return 0;
}
