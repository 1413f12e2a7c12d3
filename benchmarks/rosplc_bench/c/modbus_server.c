/* B over Modbus TCP with libmodbus: answers requests; adds one to what was written into registers 0 to 99 and
 * puts it into 100 to 199, at once or in its own cycle. Prints `ready PORT`.
 *
 *   modbus_server B
 */
#include "exchange.h"

#include <modbus.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

static modbus_mapping_t *map;
static int fresh; /* written, and not yet answered */

/* The server has no use for these; its own loop waits. */
static void transport_send(const uint16_t *values) { (void)values; }
static int transport_try(uint16_t *values) { (void)values; return 1; }
static void transport_ring(void) {}
static void transport_sleep(void) {}

static void work(const uint16_t *values)
{
    for (int i = 0; i < COUNT; i++)
        map->tab_registers[COUNT + i] = (uint16_t)(values[i] + 1);
}

static int port_of(int socket)
{
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    if (getsockname(socket, (struct sockaddr *)&address, &size))
        stop("getsockname");
    return ntohs(address.sin_port);
}

static void serve(modbus_t *server, uint8_t *query)
{
    int size = modbus_receive(server, query), header = modbus_get_header_length(server);
    if (size < 0)
        exit(0); /* the client has gone */
    if (size == 0)
        return;
    if (query[header] == 0x17) { /* FC23 reads after it has written: its answer must be there before */
        uint16_t values[COUNT];
        for (int i = 0; i < COUNT; i++)
            values[i] = (uint16_t)(query[header + 10 + 2 * i] << 8 | query[header + 11 + 2 * i]);
        work(values);
    }
    if (modbus_reply(server, query, size, map) < 0)
        stop("modbus_reply");
    if (query[header] == 0x10) {
        if (order.wait == CYCLE)
            fresh = 1;
        else
            work(map->tab_registers);
    }
}

static void take_order(void)
{
    static char line[4096];
    if (!fgets(line, sizeof line, stdin))
        exit(0);
    strtok(line, " \n");
    set_order('B');
    fresh = 0;
    printf("answering\n");
    fflush(stdout);
}

int main(void)
{
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    modbus_t *server = modbus_new_tcp("127.0.0.1", 0);
    int listener;
    prepare();
    setvbuf(stdin, NULL, _IONBF, 0); /* poll() must see what fgets() has not taken */
    map = modbus_mapping_new(0, 0, 2 * COUNT, 0);
    if (!server || !map || (listener = modbus_tcp_listen(server, 1)) < 0)
        stop("modbus_tcp_listen");
    printf("ready %d\n", port_of(listener));
    fflush(stdout);
    if (modbus_tcp_accept(server, &listener) < 0)
        stop("modbus_tcp_accept");
    struct pollfd fds[2] = {{0, POLLIN, 0}, {modbus_get_socket(server), POLLIN, 0}};
    for (;;) {
        int cyclic = order.wait == CYCLE;
        uint64_t tick = cyclic ? next_tick() : 0, now = now_ns();
        uint64_t left = tick > now ? tick - now : 0;
        struct timespec wait = {(time_t)(left / 1000000000u), (long)(left % 1000000000u)};
        int found = ppoll(fds, 2, cyclic ? &wait : NULL, NULL);
        if (found < 0 && errno != EINTR)
            stop("ppoll");
        if (cyclic && now_ns() >= tick && fresh) {
            work(map->tab_registers);
            fresh = 0;
        }
        if (found > 0 && fds[0].revents)
            take_order();
        if (found > 0 && fds[1].revents)
            serve(server, query);
    }
}
