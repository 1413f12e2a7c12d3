/* Notes when a bridge hands messages to the middleware: a library that takes the place of a sink's function, and calls
 * it. One clock and one store per message. */
#define _GNU_SOURCE
#include "sink.h"

#include <string.h>

enum { MOST = 1 << 20 };

static int (*passes)(rosplc_sink *, const uint8_t *, size_t, int64_t);
static int64_t *notes; /* how many, then pairs: when it was stored, and handed over */

static int note(rosplc_sink *self, const uint8_t *wire, size_t size, int64_t stamp_ns)
{
    uint32_t words[2]; /* behind the encapsulation: header.stamp, which is when the PLC stored it */
    int64_t count = notes[0];
    memcpy(words, wire + 4, sizeof words);
    notes[1 + 2 * (count % MOST)] = (int64_t)words[0] * 1000000000 + words[1];
    notes[2 + 2 * (count % MOST)] = rosplc_sink_now();
    __atomic_store_n(notes, count + 1, __ATOMIC_RELEASE);
    return passes(self, wire, size, stamp_ns);
}

/* All sinks of a bridge have one function, and one thread hands over. */
void watch(rosplc_sink *sink, int64_t *memory)
{
    notes = memory;
    if (sink->pass != note) {
        passes = sink->pass;
        sink->pass = note;
    }
}
