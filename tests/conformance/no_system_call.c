/* Once both blocks are open the kernel kills this program for any system call but read, write and exit: it passes
 * twenty messages of /cmd_vel on to /cmd_vel_echo, and ends. */
#define _GNU_SOURCE
#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <rosplc/plc.h>

#include "rosplc.h"

int main(int count, char **arguments)
{
    static geometry_msgs__Twist message;
    static rosplc_plc_reader in;
    static rosplc_plc_writer out;
    const struct timespec pause = {0, 10000000};
    uint32_t now = 0;
    int left = 20;
    if (count != 2)
        return 2;
    rosplc_plc_reader_init(&in, arguments[1], "/cmd_vel", geometry_msgs__Twist_LAYOUT_ID_LO,
                           geometry_msgs__Twist_LAYOUT_ID_HI, sizeof message, &message);
    rosplc_plc_writer_init(&out, arguments[1], "/cmd_vel_echo", geometry_msgs__Twist_LAYOUT_ID_LO,
                           geometry_msgs__Twist_LAYOUT_ID_HI, sizeof message);
    in.in_order = 1;
    while (!in.channel.peer_alive || !out.ready) {
        (void)rosplc_plc_read(&in, now);
        (void)rosplc_plc_write(&out, now, 0, &message);
        now += 10;
        nanosleep(&pause, NULL);
    }
    if (prctl(PR_SET_SECCOMP, SECCOMP_MODE_STRICT))
        return 3;
    while (left > 0) { /* `now` stands still: no peer grows silent, so nothing is closed */
        (void)rosplc_plc_read(&in, now);
        for (; in.is_new; (void)rosplc_plc_next(&in, now)) {
            (void)rosplc_plc_write(&out, now, 1, &message);
            left--;
        }
        (void)rosplc_plc_write(&out, now, 0, &message);
    }
    syscall(SYS_exit, 0);
}
