/* One Read and one Write block in translated Structured Text, against the C core doing the same.
 *
 *   st_loop FOLDER IN OUT OTHER READ WRITE BATCH
 *
 * FOLDER holds the objects IN (towards the PLC), OUT (towards ROS) and OTHER (as OUT, for the core). READ and
 * WRITE are programs that call one block each and count its messages in udiCount. Prints one JSON line per line
 * read from standard input: the mean nanoseconds of one call in each of TURNS turns, by contender.
 *
 * Messages go through IN in bursts, published outside of the measured time, and are taken in order.
 */
#include "objects.h"
#include "programs.h"

#define TURNS 20
#define BURST 16 /* less than the objects have slots */

static rosplc_region object(const char *folder, const char *name)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return open_object(path, 0);
}

/* What a Read block does in a cycle: the object's state, one message in order, beat. */
static void core_read(rosplc_reader *from, uint8_t *out, uint32_t size)
{
    if (rosplc_region_check(from->region))
        stop("retired");
    int taken = take(from, rosplc_take_start(ROSPLC_TAKE_NEXT), out, size);
    rosplc_reader_beat(from);
    used(out);
    if (!taken)
        stop("nothing was there");
}

/* What a Write block does in a cycle: the object's state and the claim, one message, beat. */
static void core_write(rosplc_writer *to, const uint8_t *record, uint32_t size)
{
    publish(to, record, size);
    rosplc_writer_beat(to);
}

static void fill(rosplc_writer *source, const uint8_t *record, uint32_t size)
{
    for (int i = 0; i < BURST; i++)
        publish(source, record, size);
}

int main(int argc, char **argv)
{
    rosplc_region in, out, other;
    rosplc_writer source;
    rosplc_reader sink;
    char line[16];
    uint32_t clock = 0, size, reads, writes;
    if (argc != 8)
        return 2;
    const struct st_program *read_block = program(argv[5]), *write_block = program(argv[6]);
    long bursts = (atol(argv[7]) + BURST - 1) / BURST;
    in = object(argv[1], argv[2]);
    out = object(argv[1], argv[3]);
    other = object(argv[1], argv[4]);
    size = in.geometry.record_size;
    uint8_t *record = map(-1, size), *taken = map(-1, size);
    claim(&source, &in);
    claim(&writer, &other);
    rosplc_reader_observe(&reader, &in, 0);
    rosplc_reader_observe(&sink, &out, 0);
    if (rosplc_reader_claim(&reader, 3, 0, 1, 1000, 0) || rosplc_reader_claim(&sink, 0, 0, 1, 1000, 0))
        stop("a line is taken");
    st_set_directory(argv[1]);
    st_start();
    const uint32_t *read_count = variable(read_block, "udiCount"), *write_count = variable(write_block, "udiCount");
    for (int i = 0; i < 100; i++) { /* open, attach, claim */
        st_set_time(++clock);
        rosplc_writer_beat(&source);
        rosplc_reader_beat(&sink);
        read_block->body(*read_block->instance);
        write_block->body(*write_block->instance);
    }
    while (fgets(line, sizeof line, stdin)) {
        double times[4][TURNS];
        reads = *read_count;
        writes = *write_count;
        for (int turn = 0; turn < TURNS; turn++) {
            uint64_t spent[4] = {0};
            for (long burst = 0; burst < bursts; burst++) {
                uint64_t start;
                st_set_time(++clock);
                rosplc_reader_beat(&sink);

                fill(&source, record, size);
                start = now_ns();
                for (int i = 0; i < BURST; i++)
                    read_block->body(*read_block->instance);
                spent[0] += now_ns() - start;
                reader.last = source.head; /* the turn of the other */

                fill(&source, record, size);
                start = now_ns();
                for (int i = 0; i < BURST; i++)
                    core_read(&reader, taken, size);
                spent[1] += now_ns() - start;
                for (int i = 0; i < BURST; i++)
                    read_block->body(*read_block->instance);

                start = now_ns();
                for (int i = 0; i < BURST; i++)
                    write_block->body(*write_block->instance);
                spent[2] += now_ns() - start;
                start = now_ns();
                for (int i = 0; i < BURST; i++)
                    core_write(&writer, record, size);
                spent[3] += now_ns() - start;
            }
            for (int i = 0; i < 4; i++)
                times[i][turn] = (double)spent[i] / (double)(bursts * BURST);
        }
        uint32_t expected = (uint32_t)(TURNS * bursts * BURST);
        if (*read_count - reads != 2 * expected || *write_count - writes != expected) {
            fail("%u of %u messages read, %u of %u written", *read_count - reads, 2 * expected,
                 *write_count - writes, expected);
        }
        static const char *const names[] = {"ST, read", "C core, read", "ST, write", "C core, write"};
        for (int i = 0; i < 4; i++) {
            printf("%s\"%s\": ", i ? ", " : "{", names[i]);
            for (int turn = 0; turn < TURNS; turn++)
                printf("%c%.3f", turn ? ',' : '[', times[i][turn]);
            printf("]");
        }
        say("}");
    }
    return 0;
}
