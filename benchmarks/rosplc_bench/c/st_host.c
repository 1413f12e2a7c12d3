/* B as a PLC: runs translated Structured Text scan by scan. All that B does in the exchange the text does: the
 * generated blocks take and publish, PLC_PRG adds one to each number and counts its answers in udiAnswered.
 *
 *   st_host B FOLDER
 *
 * Compiled together with the translated program and tests/st/rosplc_st/runtime of a checkout.
 */
#include "programs.h"

#define PROGRAMS 3

static const struct st_program *programs[PROGRAMS];
static const uint32_t *answered;
static const uint8_t *ready;

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
        if (i == 10000)
            fail("the blocks do not come up");
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
    say("ready");
    while (fgets(line, sizeof line, stdin)) {
        strtok(line, " \n");
        set_order('B');
        uint32_t end = *answered + (uint32_t)number(strtok(NULL, " \n"));
        alarm(WATCHDOG);
        come_up(); /* the other side was silent meanwhile: the blocks may have opened their objects again */
        say("answering");
        while (*answered != end) {
            if (order.wait == CYCLE)
                sleep_until(next_tick());
            scan();
        }
        alarm(0);
    }
    st_stop();
    return 0;
}
