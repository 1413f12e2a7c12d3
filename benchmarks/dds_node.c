/* What a user would write instead of rosplc: a node in C that copies PoseStamped or Image between DDS and shared memory.
 *
 *   dds_node DOMAIN DEPTH pose|image {in|out NAME OBJECT}...
 *
 * `in` topics go from DDS into an object, `out` topics from an object to DDS. One thread sleeps in a waitset, takes
 * and copies; another looks at the objects every millisecond and writes. Linked against the library of the
 * cyclonedds wheel, which comes without headers: what is used of dds.h 11.0.1 is declared here. CYCLONEDDS_URI is the
 * configuration. Ends with its standard input.
 */
#include "objects.h"

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>

typedef int32_t dds_entity_t;

typedef struct {
    uint32_t sample_state, view_state, instance_state;
    bool valid_data;
    int64_t source_timestamp;
    uint64_t instance_handle, publication_handle;
    uint32_t disposed, no_writers, sample_rank, generation_rank, absolute_generation_rank;
} dds_sample_info_t;

typedef struct {
    uint32_t m_size, m_align, m_flagset, m_nkeys;
    const char *m_typename;
    const void *m_keys;
    uint32_t m_nops;
    const uint32_t *m_ops;
    const char *m_meta;
    struct {
        const unsigned char *data;
        uint32_t sz;
    } information, mapping;
    uint32_t restrict_data_representation;
} dds_topic_descriptor_t;

dds_entity_t dds_create_participant(uint32_t domain, const void *qos, const void *listener);
dds_entity_t dds_create_topic(dds_entity_t, const dds_topic_descriptor_t *, const char *, const void *, const void *);
dds_entity_t dds_create_reader(dds_entity_t, dds_entity_t, const void *, const void *);
dds_entity_t dds_create_writer(dds_entity_t, dds_entity_t, const void *, const void *);
dds_entity_t dds_create_readcondition(dds_entity_t, uint32_t mask);
dds_entity_t dds_create_waitset(dds_entity_t);
int32_t dds_waitset_attach(dds_entity_t, dds_entity_t, intptr_t);
int32_t dds_waitset_wait(dds_entity_t, intptr_t *, size_t, int64_t);
int32_t dds_take(dds_entity_t, void **, dds_sample_info_t *, size_t, uint32_t);
int32_t dds_write(dds_entity_t, const void *);
void *dds_create_qos(void);
void dds_qset_reliability(void *, int kind, int64_t blocking);
void dds_qset_history(void *, int kind, int32_t depth);
void dds_qset_data_representation(void *, uint32_t, const int16_t *);

enum { ANY_STATE = 127, BATCH = 64, MOST = 256 };
static const int64_t SECOND = 1000000000;

typedef struct {
    int32_t seconds;
    uint32_t nanoseconds;
    char *frame_id;
    double pose[7];
} pose_stamped;

/* dds_opcodes.h: the fields in order, with kind and place; a 0 ends them. */
static const uint32_t FIELDS[] = {
    0x01030000, offsetof(pose_stamped, seconds),  0x01030000, offsetof(pose_stamped, nanoseconds),
    0x01050000, offsetof(pose_stamped, frame_id), 0x01080400, offsetof(pose_stamped, pose),
    7,          0,
};
static const dds_topic_descriptor_t TYPE = {
    .m_size = sizeof(pose_stamped),
    .m_align = 8,
    .m_typename = "geometry_msgs::msg::dds_::PoseStamped_",
    .m_nops = 5,
    .m_ops = FIELDS,
    .m_meta = "",
};

typedef struct {
    int32_t seconds;
    uint32_t nanoseconds;
    char *frame_id;
    uint32_t height, width;
    char *encoding;
    uint8_t is_bigendian;
    uint32_t step;
    struct {
        uint32_t most, count;
        uint8_t *bytes;
        bool release;
    } data;
} image;

static const uint32_t IMAGE_FIELDS[] = {
    0x01030000, offsetof(image, seconds),  0x01030000, offsetof(image, nanoseconds),
    0x01050000, offsetof(image, frame_id), 0x01030000, offsetof(image, height),
    0x01030000, offsetof(image, width),    0x01050000, offsetof(image, encoding),
    0x01010000, offsetof(image, is_bigendian), 0x01030000, offsetof(image, step),
    0x01070100, offsetof(image, data),     0,
};
static const dds_topic_descriptor_t IMAGE = {
    .m_size = sizeof(image),
    .m_align = 8,
    .m_typename = "sensor_msgs::msg::dds_::Image_",
    .m_nops = 10,
    .m_ops = IMAGE_FIELDS,
    .m_meta = "",
};
enum { TEXT = 120, DATA = 8 + TEXT + 8 + TEXT + 8 }; /* of an image's record: its strings, and where `data` begins */

typedef union {
    pose_stamped pose;
    image image;
} sample;

typedef struct {
    dds_entity_t entity;
    rosplc_region region;
    rosplc_writer writer;
    rosplc_reader reader;
} topic;

static topic ins[MOST], outs[MOST];
static size_t in_count, out_count, text_size;

static dds_entity_t made(dds_entity_t entity, const char *what)
{
    if (entity < 0)
        fail("cannot make a %s (%d)", what, entity);
    return entity;
}

static void put_text(uint8_t *to, const char *text, size_t room)
{
    size_t length = strlen(text);
    if (length >= room)
        fail("a text is too long");
    memcpy(to, text, length);
    memset(to + length, 0, room - length);
}

static void pose_to_record(const sample *from, uint8_t *record, size_t size)
{
    (void)size;
    memcpy(record, from, 8);
    put_text(record + 8, from->pose.frame_id, text_size);
    memcpy(record + 8 + text_size, from->pose.pose, sizeof from->pose.pose);
}

static void pose_from_record(sample *to, uint8_t *record)
{
    memcpy(to, record, 8);
    to->pose.frame_id = (char *)record + 8;
    memcpy(to->pose.pose, record + 8 + text_size, sizeof to->pose.pose);
}

static void image_to_record(const sample *from, uint8_t *record, size_t size)
{
    const image *one = &from->image;
    if (one->data.count > size - DATA - 4)
        fail("an image is too large");
    memcpy(record, from, 8);
    put_text(record + 8, one->frame_id, TEXT);
    memcpy(record + 8 + TEXT, &one->height, 8);
    put_text(record + 16 + TEXT, one->encoding, TEXT);
    memset(record + DATA - 8, 0, 4);
    record[DATA - 8] = one->is_bigendian;
    memcpy(record + DATA - 4, &one->step, 4);
    memcpy(record + DATA, &one->data.count, 4);
    memcpy(record + DATA + 4, one->data.bytes, one->data.count);
    memset(record + DATA + 4 + one->data.count, 0, size - DATA - 4 - one->data.count);
}

static void image_from_record(sample *to, uint8_t *record)
{
    image *one = &to->image;
    memcpy(to, record, 8);
    one->frame_id = (char *)record + 8;
    memcpy(&one->height, record + 8 + TEXT, 8);
    one->encoding = (char *)record + 16 + TEXT;
    one->is_bigendian = record[DATA - 8];
    memcpy(&one->step, record + DATA - 4, 4);
    memcpy(&one->data.count, record + DATA, 4);
    one->data.bytes = record + DATA + 4;
}

static const struct kind {
    const char *name;
    const dds_topic_descriptor_t *type;
    void (*to_record)(const sample *, uint8_t *, size_t);
    void (*from_record)(sample *, uint8_t *);
} KINDS[] = {{"pose", &TYPE, pose_to_record, pose_from_record}, {"image", &IMAGE, image_to_record, image_from_record}};
static const struct kind *kind;

static void receive(topic *to)
{
    static sample samples[BATCH]; /* the library fills them again, and keeps their memory */
    static void *places[BATCH];
    static dds_sample_info_t infos[BATCH];
    for (int i = 0; i < BATCH; i++)
        places[i] = &samples[i];
    int count = dds_take(to->entity, places, infos, BATCH, BATCH);
    for (int i = 0; i < count; i++) {
        if (!infos[i].valid_data)
            continue;
        rosplc_slot_header *slot = begin(&to->writer);
        kind->to_record(&samples[i], rosplc_record(slot), to->region.geometry.record_size);
        commit(&to->writer, slot);
    }
}

static void *send_all(void *unused)
{
    sample one = {0};
    uint8_t *record = out_count ? malloc(outs[0].region.geometry.record_size) : NULL;
    for (uint64_t due = now_ns();; due += 1000000) {
        sleep_until(due);
        for (topic *from = outs; from < outs + out_count; from++) {
            while (rosplc_reader_news(&from->reader)
                   && take(&from->reader, rosplc_take_start(ROSPLC_TAKE_NEXT), record,
                           from->region.geometry.record_size)) {
                kind->from_record(&one, record);
                if (dds_write(from->entity, &one))
                    fail("a write failed");
            }
        }
    }
    return unused;
}

static void *end_with_input(void *unused)
{
    char rest[64];
    while (read(0, rest, sizeof rest) > 0)
        continue;
    _exit(0);
    return unused;
}

int main(int argc, char **argv)
{
    static intptr_t ready[MOST];
    pthread_t thread;
    const int16_t representation = 0;
    if (argc < 7 || argc % 3 != 1 || argc / 3 >= MOST)
        fail("usage: dds_node DOMAIN DEPTH pose|image {in|out NAME OBJECT}...");
    kind = &KINDS[!strcmp(argv[3], "image")];
    void *qos = dds_create_qos();
    dds_qset_reliability(qos, 1, 0);
    dds_qset_history(qos, 0, atoi(argv[2]));
    dds_qset_data_representation(qos, 1, &representation);
    dds_entity_t node = made(dds_create_participant((uint32_t)atoi(argv[1]), NULL, NULL), "participant");
    dds_entity_t waitset = made(dds_create_waitset(node), "waitset");
    for (char **word = argv + 4; *word; word += 3) {
        int inward = !strcmp(word[0], "in");
        topic *one = inward ? &ins[in_count] : &outs[out_count++];
        dds_entity_t name = made(dds_create_topic(node, kind->type, word[1], NULL, NULL), "topic");
        one->region = open_object(word[2], 0);
        text_size = one->region.geometry.record_size - 8 - sizeof((pose_stamped *)0)->pose;
        if (inward) {
            claim(&one->writer, &one->region);
            one->entity = made(dds_create_reader(node, name, qos, NULL), "reader");
            dds_entity_t condition = made(dds_create_readcondition(one->entity, ANY_STATE), "condition");
            made(dds_waitset_attach(waitset, condition, (intptr_t)in_count++), "place in the waitset");
        } else {
            rosplc_reader_observe(&one->reader, &one->region, 0);
            if (rosplc_reader_claim(&one->reader, 0, 0, (uint32_t)getpid(), 1000, (uint32_t)getpid()))
                fail("%s has a reader", word[2]);
            one->entity = made(dds_create_writer(node, name, qos, NULL), "writer");
        }
    }
    if (pthread_create(&thread, NULL, send_all, NULL) || pthread_create(&thread, NULL, end_with_input, NULL))
        stop("pthread_create");
    say("{\"ready\": true}");
    if (!in_count) /* an empty waitset would not let it sleep */
        pause();
    for (;;) {
        int count = dds_waitset_wait(waitset, ready, MOST, SECOND);
        for (int i = 0; i < count; i++)
            receive(&ins[ready[i]]);
    }
}
