/* A over Modbus TCP with libmodbus: registers 0 to 99 are written, 100 to 199 are B's answer.
 *
 *   modbus_client A separate|combined PORT
 *
 * separate: one request writes (FC16), one reads (FC03); combined: one does both (FC23).
 */
#include <modbus.h>

#include "exchange.h"

static modbus_t *client;
static int combined;
static uint16_t pending[COUNT], seen[COUNT];

static void check(int done)
{
    if (done != COUNT) {
        fprintf(stderr, "Modbus: %s\n", modbus_strerror(errno));
        exit(1);
    }
}

static void transport_send(const uint16_t *values)
{
    if (combined)
        memcpy(pending, values, BYTES);
    else
        check(modbus_write_registers(client, 0, COUNT, values));
}

static int transport_try(uint16_t *values)
{
    if (combined)
        check(modbus_write_and_read_registers(client, 0, COUNT, pending, COUNT, COUNT, values));
    else
        check(modbus_read_registers(client, COUNT, COUNT, values));
    if (!memcmp(values, seen, BYTES))
        return 0;
    memcpy(seen, values, BYTES);
    return 1;
}

/* A request blocks until its answer has come: there is nobody else to wait for. */
static void transport_ring(void) {}
static void transport_sleep(void) {}

int main(int argc, char **argv)
{
    if (argc != 4)
        return 2;
    combined = !strcmp(argv[2], "combined");
    memset(seen, 0xff, sizeof seen);
    client = modbus_new_tcp("127.0.0.1", atoi(argv[3]));
    if (!client || modbus_connect(client))
        stop("modbus_connect");
    modbus_set_response_timeout(client, 30, 0);
    exchange_main('A');
    modbus_close(client);
    modbus_free(client);
    return 0;
}
