/* Modbus TCP with libmodbus: registers 0 to 99 are written, 100 to 199 are B's answer.
 *
 *   modbus A separate|combined PORT     separate: one request writes (FC16), one reads (FC03); combined: one does
 *                                       both (FC23)
 *   modbus B                            answers requests, adds one to what was written, at once or in its own
 *                                       cycle; prints `ready PORT`
 */
#include "exchange.h"
#include "libmodbus.h"

#include <poll.h>

static int combined;
static uint16_t pending[COUNT], seen[COUNT];

static void transport_send(const uint16_t *values)
{
    if (combined)
        memcpy(pending, values, BYTES);
    else
        request_write(0, COUNT, values);
}

static int transport_try(uint16_t *values)
{
    if (combined)
        expect_done(modbus_write_and_read_registers(client, 0, COUNT, pending, COUNT, COUNT, values), COUNT);
    else
        request_read(COUNT, COUNT, values);
    if (!memcmp(values, seen, BYTES))
        return 0;
    memcpy(seen, values, BYTES);
    return 1;
}

static int fresh; /* written, and not yet answered */

static void work(const uint16_t *values)
{
    for (int i = 0; i < COUNT; i++)
        registers->tab_registers[COUNT + i] = (uint16_t)(values[i] + 1);
    fresh = 0;
}

static void serve(uint8_t *query)
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
    if (modbus_reply(server, query, size, registers) < 0)
        stop("modbus_reply");
    if (query[header] == 0x10) {
        fresh = 1;
        if (order.wait != CYCLE)
            work(registers->tab_registers);
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
    say("answering");
}

static void serve_forever(void)
{
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    prepare();
    setvbuf(stdin, NULL, _IONBF, 0); /* poll() must see what fgets() has not taken */
    say("ready %d", start_server(2 * COUNT));
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
        if (cyclic && now_ns() >= tick && fresh)
            work(registers->tab_registers);
        if (found > 0 && fds[0].revents)
            take_order();
        if (found > 0 && fds[1].revents)
            serve(query);
    }
}

int main(int argc, char **argv)
{
    if (argc == 2)
        serve_forever();
    if (argc != 4)
        return 2;
    combined = !strcmp(argv[2], "combined");
    memset(seen, 0xff, sizeof seen);
    start_client(argv[3]);
    modbus_set_response_timeout(client, 30, 0);
    exchange_main('A');
    modbus_close(client);
    modbus_free(client);
    return 0;
}
