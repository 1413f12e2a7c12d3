/* How one extension module hands messages to another, without Python in between: a capsule named ROSPLC_SINK around
 * a rosplc_sink, which lives as long as the capsule. The channel's sinks are in py_sink.c, those of DDS in
 * ros/dds/batch.c, those of ROS 1 in ros/rospy/tcp.c; no module knows another.
 */
#ifndef ROSPLC_SINK_H
#define ROSPLC_SINK_H

#include <pthread.h>
#include <stddef.h>
#include <stdint.h>
#include <time.h>

#define ROSPLC_SINK "rosplc.sink"
enum { ROSPLC_SINK_ROOM = 3 }; /* zero bytes that may be read behind a message */

typedef struct rosplc_sink {
    /* Passes a message on, its encapsulation included; called by rosplc_sink_put under the mutex, without the GIL. 0, or
     * nonzero where Python has to do it, and to say what is wrong. */
    int (*pass)(struct rosplc_sink *self, const uint8_t *wire, size_t size, int64_t stamp_ns);
    pthread_mutex_t mutex; /* guards what follows; nobody waits for the GIL while holding it */
    int open;              /* closed by any message that was not passed on: Python opens it again */
    int64_t limit_ns;      /* a silence of the source that Python wants to know of; 0: none */
    int64_t last_ns;       /* CLOCK_MONOTONIC of the last message */
    uint64_t messages;
} rosplc_sink;

static inline int64_t rosplc_sink_now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

/* 0 if the message was passed on and counted; the caller may hold the GIL or not. */
static inline int rosplc_sink_put(rosplc_sink *sink, const uint8_t *wire, size_t size, int64_t stamp_ns)
{
    int64_t now = rosplc_sink_now();
    pthread_mutex_lock(&sink->mutex);
    sink->open = sink->open && stamp_ns > 0 && (!sink->limit_ns || now - sink->last_ns <= sink->limit_ns)
                 && !sink->pass(sink, wire, size, stamp_ns);
    int passed = sink->open;
    if (passed) {
        sink->last_ns = now;
        sink->messages++;
    }
    pthread_mutex_unlock(&sink->mutex);
    return !passed;
}

#endif
