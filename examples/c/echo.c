/* A control program in C: takes every message of /cmd_vel, sends half of it on as /cmd_vel_echo, every 10 ms.
 *
 *   rosplc generate rosplc.yaml --out plc
 *   cc -std=c11 -I"$(python -c 'import rosplc; print(rosplc.include_dir())')" -Iplc echo.c -o echo
 *   ./echo rosplc
 *
 * It may start before or after the bridge, and outlives it: each channel is opened again when it is replaced.
 * It compiles as C++17, too. */
#define _POSIX_C_SOURCE 200809L
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <rosplc/channel.h>
#include <rosplc/posix.h>

#include "rosplc.h" /* geometry_msgs__Twist: `rosplc generate` names the file after the prefix */

#define CYCLE_MS 10
#define BEAT_MS 100 /* the longest time between two beats that this program promises */

static volatile sig_atomic_t stopped;

static void stop(int number)
{
    (void)number;
    stopped = 1;
}

/* A channel of Twist messages: mapped while `open`. */
typedef struct {
    char path[128];
    uint32_t direction;
    int open;
    rosplc_region region;
} channel;

static channel make_channel(const char *prefix, const char *topic, uint32_t direction)
{
    channel made;
    memset(&made, 0, sizeof made);
    snprintf(made.path, sizeof made.path, "/dev/shm/%s.t.%s", prefix, topic);
    made.direction = direction;
    return made;
}

/* A claim: random, and not 0. */
static uint32_t random_claim(void)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return ((uint32_t)now.tv_nsec * 2654435761u ^ (uint32_t)now.tv_sec * 40503u ^ (uint32_t)getpid()) | 1u;
}

/* 1 if the channel was opened just now. */
static int try_open(channel *c)
{
    rosplc_error error;
    if (c->open)
        return 0;
    error = rosplc_open(&c->region, c->path, 1, c->direction, geometry_msgs__Twist_LAYOUT_ID_LO,
                        geometry_msgs__Twist_LAYOUT_ID_HI, sizeof(geometry_msgs__Twist));
    c->open = error == ROSPLC_OK;
    if (!c->open && error != ROSPLC_ERROR_NO_OBJECT)
        fprintf(stderr, "%s: SHM%d\n", c->path, (int)error);
    return c->open;
}

int main(int count, char **arguments)
{
    const char *prefix = count > 1 ? arguments[1] : "rosplc";
    channel in = make_channel(prefix, "cmd_vel", ROSPLC_TO_PLC);
    channel out = make_channel(prefix, "cmd_vel_echo", ROSPLC_TO_ROS);
    rosplc_reader reader;
    rosplc_writer writer;
    int claimed = 0;
    uint32_t generation = 0, seen_beat = 0, silent_ms = 0;
    const struct timespec cycle = {0, CYCLE_MS * 1000000L};

    signal(SIGINT, stop);
    signal(SIGTERM, stop);
    memset(&reader, 0, sizeof reader);
    memset(&writer, 0, sizeof writer);
    while (!stopped) {
        /* M14: in a new object begin with the next message; in the same one go on where we were. */
        if (try_open(&in)) {
            uint32_t last = in.region.geometry.generation == generation
                                ? reader.last
                                : rosplc_load(&in.region.header->writer.head);
            generation = in.region.geometry.generation;
            rosplc_reader_observe(&reader, &in.region, last);
            /* M9: a free line shows who reads; without one we read as an observer. */
            for (uint32_t line = 0; line < ROSPLC_READER_LINES && !reader.line; line++)
                (void)rosplc_reader_claim(&reader, line, 0, random_claim(), BEAT_MS, (uint32_t)getpid());
        }
        if (try_open(&out)) {
            claimed = 0;
            silent_ms = 0;
        }
        /* M6: a claim that is free, or whose holder has been silent for long enough by our own clock. */
        if (out.open && !claimed) {
            rosplc_writer_line *line = &out.region.header->writer;
            uint32_t holder = rosplc_load(&line->writer_epoch), beat = rosplc_load(&line->writer_beat);
            silent_ms = beat == seen_beat ? silent_ms + CYCLE_MS : 0;
            seen_beat = beat;
            if (holder == 0 || silent_ms > rosplc_silence_ms(rosplc_load(&line->writer_beat_ms))) {
                claimed = rosplc_writer_claim(&writer, &out.region, holder, random_claim(), BEAT_MS,
                                              (uint32_t)getpid())
                          == ROSPLC_OK;
            }
        }
        if (in.open) {
            geometry_msgs__Twist message;
            for (;;) {
                rosplc_take take = rosplc_take_start(ROSPLC_TAKE_NEXT);
                if (!rosplc_take_record(&reader, &take, &message))
                    break;
                message.linear.x /= 2;
                if (claimed) {
                    rosplc_meta meta;
                    memset(&meta, 0, sizeof meta);
                    if (rosplc_publish(&writer, &message, &meta) != ROSPLC_OK)
                        claimed = 0;
                }
            }
            rosplc_reader_beat(&reader);
        }
        if (claimed)
            rosplc_writer_beat(&writer);
        /* Section 9, last rule: a retired object makes way for the one that is at its name now. */
        if (in.open && rosplc_region_check(&in.region) != ROSPLC_OK) {
            rosplc_close(&in.region);
            in.open = 0;
        }
        if (out.open && rosplc_region_check(&out.region) != ROSPLC_OK) {
            rosplc_close(&out.region);
            out.open = claimed = 0;
        }
        nanosleep(&cycle, NULL);
    }
    if (claimed)
        rosplc_writer_release(&writer);
    if (in.open)
        rosplc_reader_release(&reader);
    printf("%u messages lost\n", (unsigned)reader.lost);
    return 0;
}
