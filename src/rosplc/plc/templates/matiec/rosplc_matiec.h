/* The common part of all blocks for matiec; only for rosplc_blocks.c. C11, and C++ as compiled by OpenPLC v3.
 *
 * A block's resources (mapping, claims, copies of records) are not in its instance, because retained variables would
 * restore those of an earlier run. They are in a list, by the address of the instance, and are released when the
 * program is unloaded. All tasks of a program compiled by matiec run in one thread. */
#include <stdlib.h>

typedef struct rosplc_own {
    struct rosplc_own *next;
    const void *block;
    void (*close)(struct rosplc_own *);
    char name[STR_MAX_LEN + 1], client[33];
    union {
        rosplc_plc_reader reader;
        rosplc_plc_writer writer;
        rosplc_plc_client client;
        rosplc_plc_server server;
    } of;
    rosplc_plc_part parts[3];
    uint8_t *record;
} rosplc_own;

static rosplc_own *rosplc_owns;

/* The first call of an instance allocates memory. */
static rosplc_own *rosplc_own_of(const void *block, size_t records, void (*close)(rosplc_own *))
{
    rosplc_own *own;
    for (own = rosplc_owns; own; own = own->next) {
        if (own->block == block)
            return own;
    }
    own = (rosplc_own *)calloc(1, sizeof *own);
    if (!own)
        return NULL;
    own->record = (uint8_t *)calloc(1, records);
    if (!own->record) {
        free(own);
        return NULL;
    }
    own->block = block;
    own->close = close;
    own->next = rosplc_owns;
    rosplc_owns = own;
    return own;
}

__attribute__((destructor)) static void rosplc_leave(void)
{
    while (rosplc_owns) {
        rosplc_own *own = rosplc_owns;
        rosplc_owns = own->next;
        own->close(own);
        free(own->record);
        free(own);
    }
}

/* True at the call that gives an instance its name. */
static inline int rosplc_keep(char *place, size_t size, STRING text)
{
    if (place[0] || text.len == 0 || (size_t)text.len >= size)
        return 0;
    memcpy(place, text.body, (size_t)text.len);
    return 1;
}

static inline uint32_t rosplc_to_ms(TIME time)
{
    return (uint32_t)((int64_t)time.tv_sec * 1000 + (time.tv_nsec + 999999) / 1000000);
}

static inline TIME rosplc_of_ms(uint32_t ms)
{
    TIME time;
    time.tv_sec = ms / 1000u;
    time.tv_nsec = (long)(ms % 1000u) * 1000000;
    return time;
}

static inline uint32_t rosplc_now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000u + (uint64_t)now.tv_nsec / 1000000u);
}

/* One attempt to open per scan: the next is allowed when the block that made the last attempt is called again. */
static int rosplc_may_open = 1;
static const void *rosplc_opener;
static uint32_t rosplc_opened_at;

static inline void rosplc_before_call(const void *block, uint32_t now)
{
    if (rosplc_opener == block || now - rosplc_opened_at >= 1000u)
        rosplc_may_open = 1;
    if (rosplc_may_open)
        rosplc_opener = NULL;
}

static inline void rosplc_after_call(const void *block, uint32_t now)
{
    if (!rosplc_may_open && !rosplc_opener) {
        rosplc_opener = block;
        rosplc_opened_at = now;
    }
}

static inline void rosplc_get_string(STRING *to, const uint8_t *from, size_t capacity)
{
    size_t length = 0;
    while (length < capacity && from[length])
        length++;
    memset(to, 0, sizeof *to);
    memcpy(to->body, from, length);
    to->len = (__strlen_t)length;
}

static inline void rosplc_put_string(uint8_t *to, const STRING *from, size_t capacity)
{
    size_t length = (size_t)from->len;
    length = length < capacity ? length : capacity;
    memcpy(to, from->body, length);
    memset(to + length, 0, capacity + 1 - length);
}

/* For a string that is too long for a STRING. */
static inline void rosplc_put_bytes(uint8_t *to, const BYTE *from, size_t capacity)
{
    size_t length = 0;
    while (length < capacity && from[length])
        length++;
    memcpy(to, from, length);
    memset(to + length, 0, capacity + 1 - length);
}

static inline void rosplc_close_reader(rosplc_own *own)
{
    rosplc_plc_reader_close(&own->of.reader);
}

static inline void rosplc_close_writer(rosplc_own *own)
{
    rosplc_plc_writer_close(&own->of.writer);
}

static inline void rosplc_close_client(rosplc_own *own)
{
    rosplc_plc_client_close(&own->of.client);
}

static inline void rosplc_close_server(rosplc_own *own)
{
    rosplc_plc_server_close(&own->of.server);
}
