/* The task of echo.c with the blocks of rosplc/plc.h, which open, claim, watch and count: takes every message of
 * /cmd_vel, sends half of it on as /cmd_vel_echo, every 10 ms.
 *
 *   rosplc generate rosplc.yaml --out plc
 *   include="$(python -c 'import rosplc; print(rosplc.include_dir())')"
 *   cc -std=c11 -I"$include" -Iplc blocks.c "$include/rosplc/plc.c" -o blocks
 *   ./blocks rosplc
 *
 * It compiles as C++17, too. */
#define _POSIX_C_SOURCE 200809L
#include <signal.h>
#include <stdio.h>
#include <time.h>

#include <rosplc/plc.h>

#include "rosplc.h" /* geometry_msgs__Twist: `rosplc generate` names the file after the prefix */

static volatile sig_atomic_t stopped;

static void stop(int number)
{
    (void)number;
    stopped = 1;
}

static uint32_t now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000u + (uint64_t)now.tv_nsec / 1000000u);
}

int main(int count, char **arguments)
{
    const char *prefix = count > 1 ? arguments[1] : "rosplc";
    const struct timespec cycle = {0, 10 * 1000000L};
    static geometry_msgs__Twist message;
    static rosplc_plc_reader in;
    static rosplc_plc_writer out;
    int may_open;

    rosplc_plc_reader_init(&in, prefix, "/cmd_vel", geometry_msgs__Twist_LAYOUT_ID_LO,
                           geometry_msgs__Twist_LAYOUT_ID_HI, sizeof message, &message);
    rosplc_plc_writer_init(&out, prefix, "/cmd_vel_echo", geometry_msgs__Twist_LAYOUT_ID_LO,
                           geometry_msgs__Twist_LAYOUT_ID_HI, sizeof message);
    in.channel.may_open = out.channel.may_open = &may_open;
    in.in_order = 1;
    signal(SIGINT, stop);
    signal(SIGTERM, stop);
    while (!stopped) {
        uint32_t now = now_ms();
        may_open = 1;
        (void)rosplc_plc_read(&in, now);
        while (in.is_new) {
            message.linear.x /= 2;
            (void)rosplc_plc_write(&out, now, 1, &message);
            (void)rosplc_plc_next(&in, now);
        }
        (void)rosplc_plc_write(&out, now, 0, &message); /* beats while there is nothing to send */
        nanosleep(&cycle, NULL);
    }
    rosplc_plc_reader_close(&in);
    rosplc_plc_writer_close(&out);
    printf("%u messages lost\n", (unsigned)in.lost);
    return 0;
}
