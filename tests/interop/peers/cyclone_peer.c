/* A peer on Cyclone DDS's C interface. See README.md for its arguments and its output. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <poll.h>
#include <unistd.h>
#include "dds/dds.h"
#include "ros_types.h"

#define CHECK(x) check((x), #x)
static dds_entity_t check(dds_entity_t code, const char *what) {
    if (code < 0) {
        fprintf(stderr, "%s: %s\n", what, dds_strretcode(-code));
        exit(1);
    }
    return code;
}

typedef struct { const char *name; const dds_topic_descriptor_t *desc; void (*fill)(void *, int); void (*print)(const void *); } kind;

static void print_text(const char *text) { printf(" \"%s\"", text); }
static void print_numbers(const dds_sequence_double *s) {
    printf(" [");
    for (uint32_t i = 0; i < s->_length; i++) printf("%s%.17g", i ? " " : "", s->_buffer[i]);
    printf("]");
}

static void fill_string(void *data, int i) {
    static char text[32];
    snprintf(text, sizeof text, "message %d", i);
    ((std_msgs_msg_dds__String_ *)data)->data = text;
}
static void print_string(const void *data) { print_text(((const std_msgs_msg_dds__String_ *)data)->data); }

static void fill_twist(void *data, int i) {
    geometry_msgs_msg_dds__Twist_ *t = data;
    t->linear.x = i + 0.5; t->linear.y = -i; t->linear.z = 1e-300;
#ifdef OTHER_DEFINITION
    t->mode = i;
#else
    t->angular.x = 0.1; t->angular.y = 1e300; t->angular.z = i * 0.25;
#endif
}
static void print_twist(const void *data) {
    const geometry_msgs_msg_dds__Twist_ *t = data;
    printf(" %.17g %.17g %.17g", t->linear.x, t->linear.y, t->linear.z);
#ifdef OTHER_DEFINITION
    printf(" %d", t->mode);
#else
    printf(" %.17g %.17g %.17g", t->angular.x, t->angular.y, t->angular.z);
#endif
}

static void fill_joints(void *data, int i) {
    static char names[8][16];
    static char *pointers[8];
    static double position[8], velocity[1];
    sensor_msgs_msg_dds__JointState_ *j = data;
    uint32_t n = (uint32_t)(i % 8);
    j->header.stamp.sec = -i; j->header.stamp.nanosec = 4000000000u;
    j->header.frame_id = "base";
    for (uint32_t k = 0; k < n; k++) {
        snprintf(names[k], sizeof names[k], "joint%u", k);
        pointers[k] = names[k];
        position[k] = k + i / 4.0;
    }
    j->name._length = j->name._maximum = n; j->name._buffer = pointers;
    j->position._length = j->position._maximum = n; j->position._buffer = position;
    velocity[0] = 2.5;
    j->velocity._length = j->velocity._maximum = 1; j->velocity._buffer = velocity;
    j->effort._length = j->effort._maximum = 0; j->effort._buffer = NULL;
}
static void print_joints(const void *data) {
    const sensor_msgs_msg_dds__JointState_ *j = data;
    printf(" %d %u", j->header.stamp.sec, j->header.stamp.nanosec);
    print_text(j->header.frame_id);
    printf(" [");
    for (uint32_t k = 0; k < j->name._length; k++) printf("%s%s", k ? " " : "", j->name._buffer[k]);
    printf("]");
    print_numbers(&j->position); print_numbers(&j->velocity); print_numbers(&j->effort);
}

static void print_hex(const uint8_t *bytes, size_t n) { for (size_t i = 0; i < n; i++) printf("%02x", bytes[i]); }
static void print_gids(const rmw_dds_common_msg_dds__Gid_ *gids, uint32_t n) {
    printf(" [");
    for (uint32_t i = 0; i < n; i++) { if (i) printf(" "); print_hex(gids[i].data, sizeof gids[i].data); }
    printf("]");
}
static void print_nodes(const void *data) {
    const rmw_dds_common_msg_dds__ParticipantEntitiesInfo_ *p = data;
    printf(" ");
    print_hex(p->gid.data, sizeof p->gid.data);
    for (uint32_t i = 0; i < p->node_entities_info_seq._length; i++) {
        const rmw_dds_common_msg_dds__NodeEntitiesInfo_ *n = &p->node_entities_info_seq._buffer[i];
        print_text(n->node_namespace); print_text(n->node_name);
        print_gids(n->reader_gid_seq._buffer, n->reader_gid_seq._length);
        print_gids(n->writer_gid_seq._buffer, n->writer_gid_seq._length);
    }
}

static const kind kinds[] = {
    {"String", &std_msgs_msg_dds__String__desc, fill_string, print_string},
    {"Twist", &geometry_msgs_msg_dds__Twist__desc, fill_twist, print_twist},
    {"JointState", &sensor_msgs_msg_dds__JointState__desc, fill_joints, print_joints},
    {"Nodes", &rmw_dds_common_msg_dds__ParticipantEntitiesInfo__desc, NULL, print_nodes},
};

static int stdin_closed(int timeout_ms) {
    struct pollfd p = {.fd = 0, .events = POLLIN};
    char c;
    return poll(&p, 1, timeout_ms) > 0 && read(0, &c, 1) <= 0;
}

/* Everything that discovery shows: what `ros2 topic info -v` stands on. */
static void discover(dds_entity_t participant) {
    static const struct { dds_entity_t topic; const char *name; } builtin[] = {
        {DDS_BUILTIN_TOPIC_DCPSPUBLICATION, "publisher"}, {DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION, "subscription"}};
    dds_entity_t readers[3];
    for (int i = 0; i < 2; i++) readers[i] = CHECK(dds_create_reader(participant, builtin[i].topic, NULL, NULL));
    readers[2] = CHECK(dds_create_reader(participant, DDS_BUILTIN_TOPIC_DCPSPARTICIPANT, NULL, NULL));
    puts("ready");
    fflush(stdout);
    do {
        for (int i = 0; i < 3; i++) {
            void *sample[1] = {NULL};
            dds_sample_info_t info;
            while (dds_take(readers[i], sample, &info, 1, 1) > 0) {
                void *user = NULL;
                size_t size = 0;
                if (info.valid_data && i < 2) {
                    const dds_builtintopic_endpoint_t *e = sample[0];
                    dds_qget_userdata(e->qos, &user, &size);
                    printf("%s %s %s ", builtin[i].name, e->topic_name, e->type_name);
                    print_hex(e->key.v, 16);
                    printf(" %.*s\n", (int)size, (char *)user);
                } else if (info.valid_data) {
                    const dds_builtintopic_participant_t *p = sample[0];
                    dds_qget_userdata(p->qos, &user, &size);
                    printf("participant ");
                    print_hex(p->key.v, 16);
                    printf(" %.*s\n", (int)size, (char *)user);
                }
                dds_free(user);
                dds_return_loan(readers[i], sample, 1);
            }
        }
        fflush(stdout);
    } while (!stdin_closed(10));
}

int main(int argc, char **argv) {
    if (argc == 3 && !strcmp(argv[2], "discover")) {
        discover(CHECK(dds_create_participant((dds_domainid_t)atoi(argv[1]), NULL, NULL)));
        return 0;
    }
    if (argc < 9) return 2;
    int publish = !strcmp(argv[2], "pub"), reliable = !strcmp(argv[5], "reliable");
    int latched = !strcmp(argv[6], "transient_local"), depth = atoi(argv[7]), count = atoi(argv[8]);
    const kind *k = NULL;
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) if (!strcmp(kinds[i].name, argv[3])) k = &kinds[i];
    if (!k) return 2;
    dds_entity_t participant = CHECK(dds_create_participant((dds_domainid_t)atoi(argv[1]), NULL, NULL));
    dds_entity_t topic = CHECK(dds_create_topic(participant, k->desc, argv[4], NULL, NULL));
    dds_qos_t *qos = dds_create_qos();
    dds_qset_reliability(qos, reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT, DDS_INFINITY);
    dds_qset_durability(qos, latched ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, depth);
    if (latched) dds_qset_durability_service(qos, 0, DDS_HISTORY_KEEP_LAST, depth, -1, -1, -1);
    if (argc > 9) dds_qset_userdata(qos, argv[9], strlen(argv[9]));
    if (publish) {
        dds_entity_t writer = CHECK(dds_create_writer(participant, topic, qos, NULL));
        void *data = calloc(1, k->desc->m_size);
        puts("ready");
        fflush(stdout);
        dds_publication_matched_status_t status = {0};
        while (!latched && status.current_count == 0) {
            if (stdin_closed(5)) return 0;
            CHECK(dds_get_publication_matched_status(writer, &status));
        }
        for (int i = 0; i < count; i++) {
            k->fill(data, i);
            CHECK(dds_write(writer, data));
            dds_sleepfor(DDS_MSECS(2));
        }
        printf("sent %d\n", count);
        fflush(stdout);
        while (!stdin_closed(100)) {}
    } else {
        dds_entity_t reader = CHECK(dds_create_reader(participant, topic, qos, NULL));
        puts("ready");
        fflush(stdout);
        do {
            void *sample[1] = {NULL};
            dds_sample_info_t info;
            while (dds_take(reader, sample, &info, 1, 1) > 0) {
                if (info.valid_data) {
                    printf("message");
                    k->print(sample[0]);
                    puts("");
                }
                dds_return_loan(reader, sample, 1);
            }
            fflush(stdout);
        } while (!stdin_closed(2));
    }
    dds_delete_qos(qos);
    dds_delete(participant);
    return 0;
}
