/* Either side of the exchange over rosplc's channel, with a named semaphore beside each object as the bell of a
 * side that sleeps: the channel itself has none.
 *
 *   channel SIDE OBJECT_TO_B OBJECT_TO_A NAME_A NAME_B
 */
#include "exchange.h"
#include "objects.h"

static void transport_send(const uint16_t *values)
{
    publish(&writer, values, BYTES);
}

static int transport_try(uint16_t *values)
{
    return rosplc_reader_news(&reader) && take(&reader, rosplc_take_start(ROSPLC_TAKE_NEXT), values, BYTES);
}

int main(int argc, char **argv)
{
    if (argc != 6)
        return 2;
    int b = argv[1][0] == 'B';
    /* Line 0 of an object towards ROS is the bridge's, which A stands for. */
    attach(argv[b ? 3 : 2], argv[b ? 2 : 3], b ? 1 : 0);
    out_bell = named_semaphore(argv[4 + b], 0);
    in_bell = named_semaphore(argv[4 + !b], 0);
    exchange_main(argv[1][0]);
    rosplc_writer_release(&writer);
    rosplc_reader_release(&reader);
    return 0;
}
