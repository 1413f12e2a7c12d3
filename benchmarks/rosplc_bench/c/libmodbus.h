/* libmodbus as its users start it. */
#ifndef ROSPLC_BENCH_LIBMODBUS_H
#define ROSPLC_BENCH_LIBMODBUS_H

#include <modbus.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include "common.h"

static modbus_t *server, *client;
static modbus_mapping_t *registers;
static int listener;

/* Serves `count` holding registers; returns the port. */
HELPER int start_server(int count)
{
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    server = modbus_new_tcp("127.0.0.1", 0);
    registers = modbus_mapping_new(0, 0, count, 0);
    if (!server || !registers || (listener = modbus_tcp_listen(server, 1)) < 0)
        stop("modbus_tcp_listen");
    if (getsockname(listener, (struct sockaddr *)&address, &size))
        stop("getsockname");
    return ntohs(address.sin_port);
}

HELPER void start_client(const char *port)
{
    client = modbus_new_tcp("127.0.0.1", atoi(port));
    if (!client || modbus_connect(client))
        stop("modbus_connect");
}

HELPER void expect_done(int done, int count)
{
    if (done != count)
        fail("Modbus: %s", modbus_strerror(errno));
}

HELPER void request_write(int at, int count, const uint16_t *values)
{
    expect_done(modbus_write_registers(client, at, count, values), count);
}

HELPER void request_read(int at, int count, uint16_t *values)
{
    expect_done(modbus_read_registers(client, at, count, values), count);
}

#endif
