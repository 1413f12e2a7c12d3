/* As no_system_call.c, for clients and servers of services and actions: it calls /close and /drive, serves /start with
 * what /close answered and /cycle with what /drive did, and ends. */
#define _GNU_SOURCE
#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <rosplc/plc.h>

#include "rosplc.h"

#define PART(type, record) {type##_LAYOUT_ID_LO, type##_LAYOUT_ID_HI, sizeof record, &record}

static std_srvs__srv__Trigger_Request close_request;
static std_srvs__srv__Trigger_Response close_response;
static std_srvs__srv__SetBool_Request start_request;
static std_srvs__srv__SetBool_Response start_response;
static example_interfaces__action__Fibonacci_Goal drive_goal, cycle_goal;
static example_interfaces__action__Fibonacci_Result drive_result, cycle_result;
static example_interfaces__action__Fibonacci_Feedback drive_feedback, cycle_feedback;
static const rosplc_plc_part close_parts[] = {
    PART(std_srvs__srv__Trigger_Request, close_request),
    PART(std_srvs__srv__Trigger_Response, close_response),
};
static const rosplc_plc_part start_parts[] = {
    PART(std_srvs__srv__SetBool_Request, start_request),
    PART(std_srvs__srv__SetBool_Response, start_response),
};
static const rosplc_plc_part drive_parts[] = {
    PART(example_interfaces__action__Fibonacci_Goal, drive_goal),
    PART(example_interfaces__action__Fibonacci_Result, drive_result),
    PART(example_interfaces__action__Fibonacci_Feedback, drive_feedback),
};
static const rosplc_plc_part cycle_parts[] = {
    PART(example_interfaces__action__Fibonacci_Goal, cycle_goal),
    PART(example_interfaces__action__Fibonacci_Result, cycle_result),
    PART(example_interfaces__action__Fibonacci_Feedback, cycle_feedback),
};
static rosplc_plc_client pick, drive;
static rosplc_plc_server start, cycle;

static int ready(void)
{
    return pick.server && pick.out.ready && drive.server && drive.out.ready && start.block.peer_alive &&
           start.out.ready && cycle.block.peer_alive && cycle.out.ready && cycle.feedback.ready;
}

static void scan(uint32_t now)
{
    int wanted;
    if (rosplc_plc_client_begin(&drive, now))
        drive_goal.order = 7;
    (void)rosplc_plc_client_end(&drive);

    cycle.steps = (cycle.request ? ROSPLC_PLC_ACCEPT : 0u) | (drive.done ? ROSPLC_PLC_SUCCEED : 0u);
    cycle.send_feedback = drive.active;
    wanted = rosplc_plc_server_begin(&cycle, now);
    if (wanted & ROSPLC_PLC_RESPONSE)
        cycle_result = drive_result;
    if (wanted & ROSPLC_PLC_FEEDBACK)
        cycle_feedback = drive_feedback;
    rosplc_plc_server_end(&cycle);

    (void)rosplc_plc_client_begin(&pick, now);
    (void)rosplc_plc_client_end(&pick);

    start.steps = start.request && pick.done ? ROSPLC_PLC_REPLY : 0u;
    if (rosplc_plc_server_begin(&start, now) & ROSPLC_PLC_RESPONSE) {
        start_response.success = start_request.data;
        memcpy(start_response.message, close_response.message, sizeof start_response.message);
    }
    rosplc_plc_server_end(&start);
}

int main(int count, char **arguments)
{
    const struct timespec pause = {0, 10000000};
    uint32_t now = 0;
    int active = 0, asked = 0;
    if (count != 2)
        return 2;
    rosplc_plc_client_init(&pick, arguments[1], "/close", "pick", close_parts, 0);
    rosplc_plc_client_init(&drive, arguments[1], "/drive", "", drive_parts, 1);
    rosplc_plc_server_init(&start, arguments[1], "/start", start_parts, 0);
    rosplc_plc_server_init(&cycle, arguments[1], "/cycle", cycle_parts, 1);
    while (!ready()) {
        scan(now);
        now += 10;
        nanosleep(&pause, NULL);
    }
    if (prctl(PR_SET_SECCOMP, SECCOMP_MODE_STRICT))
        return 3;
    pick.execute = drive.execute = 1;
    while (!(pick.done && drive.done && active && !cycle.active && asked && !start.request)) {
        scan(now); /* `now` stands still: no peer grows silent, so nothing is closed */
        active |= cycle.active;
        asked |= start.request;
    }
    syscall(SYS_exit, 0);
}
