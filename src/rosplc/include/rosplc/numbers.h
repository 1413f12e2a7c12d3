/* Numbers of spec/shm-format.md, generated from spec/format.toml by tools/generate_format.py. */
#ifndef ROSPLC_NUMBERS_H
#define ROSPLC_NUMBERS_H

#include <stddef.h>
#include <stdint.h>

#define ROSPLC_MAGIC 0x434C5052u /* the bytes RPLC */
#define ROSPLC_VERSION 0x00010000u /* major * 65536 + minor */
#define ROSPLC_LINE_SIZE 64u /* bytes of a cache line */
#define ROSPLC_HEADER_SIZE 512u /* bytes before the self-description */
#define ROSPLC_SLOT_HEADER_SIZE 64u /* bytes before each record */
#define ROSPLC_READER_LINES 4u /* reader lines of an object */
#define ROSPLC_FEATURES_KNOWN 0u /* bits of features_required that this version knows */
#define ROSPLC_STATE_LIVE 1u /* state: in use */
#define ROSPLC_STATE_RETIRED 2u /* state: replaced or removed; open the name again */
#define ROSPLC_KIND_TOPIC 1u /* kind: a topic's channel */
#define ROSPLC_KIND_REQUEST 0x0102u /* kind: a service's requests */
#define ROSPLC_KIND_RESPONSE 0x0202u /* kind: a service's responses */
#define ROSPLC_KIND_GOAL 0x0103u /* kind: an action's goals */
#define ROSPLC_KIND_RESULT 0x0203u /* kind: an action's results */
#define ROSPLC_KIND_FEEDBACK 0x0303u /* kind: an action's feedback */
#define ROSPLC_TO_PLC 1u /* direction: towards the PLC */
#define ROSPLC_TO_ROS 2u /* direction: towards ROS */
#define ROSPLC_MIN_SLOTS 4u /* smallest slot_count */
#define ROSPLC_MAX_SLOTS 65536u /* largest slot_count */
#define ROSPLC_MAX_RECORD_SIZE 0x40000000u /* largest record_size in bytes */
#define ROSPLC_MAX_DESCRIPTION_SIZE 0x00100000u /* largest description_size in bytes */
#define ROSPLC_MAX_OBJECT_SIZE 0x7FFFFFFFu /* largest object_size in bytes */
#define ROSPLC_RULE_FENCES 1u /* writer_rule: the fences of section 7.2 are in force */
#define ROSPLC_RULE_DELAYED 2u /* writer_rule: the delayed rule of section 7.4 */
#define ROSPLC_WINDOW_FENCES 2u /* M12: the largest distance behind head is slot_count minus this */
#define ROSPLC_WINDOW_DELAYED 3u /* M23: the same under the delayed rule */
#define ROSPLC_FLAG_FIRST 1u /* flags: first message after the writer started or its source was silent */
#define ROSPLC_FLAG_TRUNCATED 2u /* flags: contents were truncated */
#define ROSPLC_FLAG_SUBSTITUTED 4u /* flags: not a message from the source */
#define ROSPLC_ASK_CALL 1u /* status of a request or goal: always set */
#define ROSPLC_ASK_CANCEL 2u /* status of a goal: the caller asks for it to be canceled */
#define ROSPLC_ASK_PREEMPT 4u /* status of a goal: another goal waits for this one to end */
#define ROSPLC_ASK_WITHDRAWN 8u /* status of a request or goal: the caller no longer waits for an answer */
#define ROSPLC_ASK_ACCEPTED 16u /* status of a goal: the goal was accepted, and no request is pending */
#define ROSPLC_ANSWER_MASK 0x000000FFu /* status of an answer: the bits that contain one of the next eight values */
#define ROSPLC_ANSWER_DONE 1u /* status of an answer: the record is the response */
#define ROSPLC_ANSWER_NOT_EXECUTED 2u /* status of an answer: the call did not begin, and it is safe to call again */
#define ROSPLC_ANSWER_FATE_UNKNOWN 3u /* status of an answer: the call may have been executed; no answer will come */
#define ROSPLC_ANSWER_UNREADABLE 4u /* status of an answer: executed, but the answer does not fit the record */
#define ROSPLC_ANSWER_ACCEPTED 5u /* status of an answer: the goal is being executed */
#define ROSPLC_ANSWER_SUCCEEDED 6u /* status of an answer: the record is the result */
#define ROSPLC_ANSWER_CANCELED 7u /* status of an answer: the record is the result of a canceled goal */
#define ROSPLC_ANSWER_ABORTED 8u /* status of an answer: the record is the result of an aborted goal */
#define ROSPLC_ANSWER_CANCEL_ACCEPTED 256u /* status of an answer, added: the goal will be canceled */
#define ROSPLC_ANSWER_CANCEL_REJECTED 512u /* status of an answer, added: the goal will not be canceled */
#define ROSPLC_ANSWER_NO_RESULT 1024u /* status of an answer, added: the result does not fit the record */
#define ROSPLC_GOAL_ID_END 0x504C5052u /* the last word of the UUID of a goal that a PLC sends */
#define ROSPLC_GOAL_NOTES 2u /* entries of the table after the slots of a goal object that the bridge writes */
#define ROSPLC_GOAL_NOTE_BYTES 1024u /* maximum bytes of a note in this table */
#define ROSPLC_GOAL_NOTES_SIZE 2112u /* bytes of this table */
#define ROSPLC_STAMP_NONE 0u /* stamp_clock: no time stamp */
#define ROSPLC_STAMP_SYSTEM 1u /* stamp_clock: system clock (UTC) */
#define ROSPLC_STAMP_ROS 2u /* stamp_clock: ROS time */
#define ROSPLC_STAMP_PLC 3u /* stamp_clock: the PLC's clock */
#define ROSPLC_UNKNOWN 0xFFFFFFFFu /* sources, sinks: not counted */
#define ROSPLC_DISCONTINUITY 0x80000000u /* two sequences this far apart or more do not belong to the same stream */
#define ROSPLC_MAX_RETRIES 3u /* M12: maximum repeated attempts per call */
#define ROSPLC_MAX_BEAT_MS 10000u /* a longer promised beat counts as this many ms */
#define ROSPLC_SILENT_BEATS 3u /* M6, M21: promised beat times after which a peer is silent */
#define ROSPLC_MIN_SILENT_MS 100u /* M6: shortest silence that frees a claim, in ms */
#define ROSPLC_SILENT_MS 1000u /* M6: the same if no beat is promised, in ms */
#define ROSPLC_MAX_NAME 80u /* characters of an object's name */
#define ROSPLC_NAME_KEPT 71u /* characters kept of a longer name, before ~ and its hash */
#define ROSPLC_FNV_OFFSET 0x811C9DC5u /* FNV-1a, 32 bits: start */
#define ROSPLC_FNV_PRIME 0x01000193u /* FNV-1a, 32 bits: factor */
#define ROSPLC_CRC_POLYNOMIAL 0xEDB88320u /* CRC-32 (ISO-HDLC), reflected */

/* Section 9: the return values of functions that can fail. */
typedef enum {
    ROSPLC_OK = 0,
    ROSPLC_ERROR_NO_OBJECT = 101, /* object does not exist */
    ROSPLC_ERROR_NO_PERMISSION = 102, /* no permission to open the object */
    ROSPLC_ERROR_TOO_SMALL = 103, /* object is smaller than a header */
    ROSPLC_ERROR_NOT_ROSPLC = 104, /* not a rosplc object */
    ROSPLC_ERROR_VERSION = 105, /* format version is not supported */
    ROSPLC_ERROR_FEATURES = 106, /* object requires features that this side lacks */
    ROSPLC_ERROR_IDENTITY = 107, /* identity is damaged */
    ROSPLC_ERROR_GEOMETRY = 108, /* geometry is not consistent */
    ROSPLC_ERROR_TRUNCATED = 109, /* object is smaller than its header states */
    ROSPLC_ERROR_DIRECTION = 110, /* wrong kind or direction */
    ROSPLC_ERROR_RETIRED = 111, /* object is retired */
    ROSPLC_ERROR_LAYOUT = 112, /* layout differs */
    ROSPLC_ERROR_DESCRIPTION = 113, /* self-description cannot be read */
    ROSPLC_ERROR_CLAIMED = 114, /* another writer holds the claim */
    ROSPLC_ERROR_CLAIM_LOST = 115, /* writer's claim was taken over */
    ROSPLC_ERROR_OTHER_BRIDGE = 116, /* another bridge uses this name */
    ROSPLC_ERROR_NO_ROOM = 117, /* not enough room in shared memory */
    ROSPLC_ERROR_NAME = 118, /* name is not valid */
    ROSPLC_ERROR_OTHER_USER = 119, /* object belongs to another user */
    ROSPLC_ERROR_REPLACED = 120, /* name refers to another object */
    ROSPLC_ERROR_NOT_PLAIN_FILE = 121, /* not a plain file */
    ROSPLC_ERROR_READ_ONLY = 122, /* this side maps the object read-only */
    ROSPLC_ERROR_DIRECTORY = 123, /* shared memory directory cannot be used */
    ROSPLC_ERROR_REENTERED = 124, /* function block was called by two tasks at once */
    ROSPLC_ERROR_PEER_SILENT = 125, /* peer is silent */
    ROSPLC_ERROR_HANDSHAKE_TIMEOUT = 126, /* handshake took too long */
    ROSPLC_ERROR_LOCK_TIMEOUT = 127, /* lock was not free in time */
    ROSPLC_ERROR_SEMAPHORE = 128, /* semaphore cannot be opened */
    ROSPLC_ERROR_MEMORY_TOO_SMALL = 129, /* classic memory is smaller than the record */
    ROSPLC_ERROR_MEMORY_SIZE = 130, /* classic memory has an unexpected size */
    ROSPLC_ERROR_LOCK_FREED = 131, /* lock of a dead process was freed */
    ROSPLC_ERROR_SEMAPHORE_COUNT = 132, /* semaphore admitted more than one process */
    ROSPLC_ERROR_SEMAPHORE_WORD_SIZE = 133, /* semaphore belongs to programs of another word size */
    ROSPLC_ERROR_NOT_EXECUTED = 140, /* call was not executed */
    ROSPLC_ERROR_FATE_UNKNOWN = 141, /* fate of the call is unknown */
    ROSPLC_ERROR_UNREADABLE = 142, /* call was executed, but its answer cannot be shown */
    ROSPLC_ERROR_GOAL_ABORTED = 143, /* goal was aborted */
    ROSPLC_ERROR_GOAL_CANCELED = 144, /* goal was canceled */
    ROSPLC_ERROR_ILLEGAL_STEP = 145, /* step is not allowed in this state */
} rosplc_error;

/* Section 11.2: why a call ended. */
typedef enum {
    ROSPLC_REASON_NONE = 0,
    ROSPLC_REASON_NO_SERVER = 1,
    ROSPLC_REASON_TIME_OUT = 2,
    ROSPLC_REASON_REJECTED = 3,
    ROSPLC_REASON_QUEUE_FULL = 4,
    ROSPLC_REASON_EXPIRED = 5,
    ROSPLC_REASON_CALLER_GONE = 6,
    ROSPLC_REASON_PLC_DOWN = 7,
    ROSPLC_REASON_BRIDGE_RESTARTED = 8,
    ROSPLC_REASON_TOO_LARGE = 9,
    ROSPLC_REASON_SERVER_GONE = 10,
    ROSPLC_REASON_SERVER_FAILED = 11,
} rosplc_reason;

typedef struct {
    uint32_t magic;
    uint32_t version;
    uint32_t header_size;
    uint32_t state;
    uint32_t features_required;
    uint32_t features_optional;
    uint32_t kind;
    uint32_t direction;
    uint32_t slot_count;
    uint32_t slot_stride;
    uint32_t slot_header_size;
    uint32_t record_size;
    uint32_t slots_offset;
    uint32_t object_size;
    uint32_t description_offset;
    uint32_t description_size;
    uint32_t layout_id_lo;
    uint32_t layout_id_hi;
    uint32_t generation;
    uint32_t bridge_id[4];
    uint32_t creator_pid;
    uint32_t created_lo;
    uint32_t created_hi;
    uint32_t reader_lines;
    uint32_t identity_crc;
    uint32_t reserved[4];
} rosplc_identity;

typedef struct {
    uint32_t head;
    uint32_t writer_epoch;
    uint32_t writer_beat;
    uint32_t writer_beat_ms;
    uint32_t refused;
    uint32_t truncated;
    uint32_t writer_rule;
    uint32_t sources;
    uint32_t writer_pid;
    uint32_t writer_error;
    uint32_t reserved[6];
} rosplc_writer_line;

typedef struct {
    uint32_t claim;
    uint32_t beat;
    uint32_t beat_ms;
    uint32_t taken;
    uint32_t layout_lo;
    uint32_t layout_hi;
    uint32_t lost;
    uint32_t retries;
    uint32_t generation;
    uint32_t error;
    uint32_t sinks;
    uint32_t pid;
    uint8_t task[16];
} rosplc_reader_line;

typedef struct {
    uint32_t sequence;
    uint32_t length;
    uint32_t flags;
    uint32_t status;
    uint32_t stamp_lo;
    uint32_t stamp_hi;
    uint32_t stamp_clock;
    uint32_t checksum;
    uint32_t correlation_lo;
    uint32_t correlation_hi;
    uint32_t client[4];
    uint32_t reason;
    uint32_t reserved;
} rosplc_slot_header;

typedef struct {
    uint32_t number;
    uint32_t size;
    uint32_t crc;
    uint32_t reserved;
    uint32_t uuid[4];
} rosplc_goal_note;

typedef struct {
    rosplc_identity identity;
    rosplc_writer_line writer;
    rosplc_reader_line reader[ROSPLC_READER_LINES];
    uint32_t reserved[16];
} rosplc_header;

#ifdef __cplusplus
#define ROSPLC_STATIC_ASSERT static_assert
#else
#define ROSPLC_STATIC_ASSERT _Static_assert
#endif
#define ROSPLC_AT(type, member, offset) \
    ROSPLC_STATIC_ASSERT(offsetof(type, member) == (offset), #type "." #member " has moved")
ROSPLC_AT(rosplc_identity, magic, 0);
ROSPLC_AT(rosplc_identity, version, 4);
ROSPLC_AT(rosplc_identity, header_size, 8);
ROSPLC_AT(rosplc_identity, state, 12);
ROSPLC_AT(rosplc_identity, features_required, 16);
ROSPLC_AT(rosplc_identity, features_optional, 20);
ROSPLC_AT(rosplc_identity, kind, 24);
ROSPLC_AT(rosplc_identity, direction, 28);
ROSPLC_AT(rosplc_identity, slot_count, 32);
ROSPLC_AT(rosplc_identity, slot_stride, 36);
ROSPLC_AT(rosplc_identity, slot_header_size, 40);
ROSPLC_AT(rosplc_identity, record_size, 44);
ROSPLC_AT(rosplc_identity, slots_offset, 48);
ROSPLC_AT(rosplc_identity, object_size, 52);
ROSPLC_AT(rosplc_identity, description_offset, 56);
ROSPLC_AT(rosplc_identity, description_size, 60);
ROSPLC_AT(rosplc_identity, layout_id_lo, 64);
ROSPLC_AT(rosplc_identity, layout_id_hi, 68);
ROSPLC_AT(rosplc_identity, generation, 72);
ROSPLC_AT(rosplc_identity, bridge_id, 76);
ROSPLC_AT(rosplc_identity, creator_pid, 92);
ROSPLC_AT(rosplc_identity, created_lo, 96);
ROSPLC_AT(rosplc_identity, created_hi, 100);
ROSPLC_AT(rosplc_identity, reader_lines, 104);
ROSPLC_AT(rosplc_identity, identity_crc, 108);
ROSPLC_AT(rosplc_identity, reserved, 112);
ROSPLC_STATIC_ASSERT(sizeof(rosplc_identity) == 128, "rosplc_identity has 128 bytes");
ROSPLC_AT(rosplc_writer_line, head, 0);
ROSPLC_AT(rosplc_writer_line, writer_epoch, 4);
ROSPLC_AT(rosplc_writer_line, writer_beat, 8);
ROSPLC_AT(rosplc_writer_line, writer_beat_ms, 12);
ROSPLC_AT(rosplc_writer_line, refused, 16);
ROSPLC_AT(rosplc_writer_line, truncated, 20);
ROSPLC_AT(rosplc_writer_line, writer_rule, 24);
ROSPLC_AT(rosplc_writer_line, sources, 28);
ROSPLC_AT(rosplc_writer_line, writer_pid, 32);
ROSPLC_AT(rosplc_writer_line, writer_error, 36);
ROSPLC_AT(rosplc_writer_line, reserved, 40);
ROSPLC_STATIC_ASSERT(sizeof(rosplc_writer_line) == 64, "rosplc_writer_line has 64 bytes");
ROSPLC_AT(rosplc_reader_line, claim, 0);
ROSPLC_AT(rosplc_reader_line, beat, 4);
ROSPLC_AT(rosplc_reader_line, beat_ms, 8);
ROSPLC_AT(rosplc_reader_line, taken, 12);
ROSPLC_AT(rosplc_reader_line, layout_lo, 16);
ROSPLC_AT(rosplc_reader_line, layout_hi, 20);
ROSPLC_AT(rosplc_reader_line, lost, 24);
ROSPLC_AT(rosplc_reader_line, retries, 28);
ROSPLC_AT(rosplc_reader_line, generation, 32);
ROSPLC_AT(rosplc_reader_line, error, 36);
ROSPLC_AT(rosplc_reader_line, sinks, 40);
ROSPLC_AT(rosplc_reader_line, pid, 44);
ROSPLC_AT(rosplc_reader_line, task, 48);
ROSPLC_STATIC_ASSERT(sizeof(rosplc_reader_line) == 64, "rosplc_reader_line has 64 bytes");
ROSPLC_AT(rosplc_slot_header, sequence, 0);
ROSPLC_AT(rosplc_slot_header, length, 4);
ROSPLC_AT(rosplc_slot_header, flags, 8);
ROSPLC_AT(rosplc_slot_header, status, 12);
ROSPLC_AT(rosplc_slot_header, stamp_lo, 16);
ROSPLC_AT(rosplc_slot_header, stamp_hi, 20);
ROSPLC_AT(rosplc_slot_header, stamp_clock, 24);
ROSPLC_AT(rosplc_slot_header, checksum, 28);
ROSPLC_AT(rosplc_slot_header, correlation_lo, 32);
ROSPLC_AT(rosplc_slot_header, correlation_hi, 36);
ROSPLC_AT(rosplc_slot_header, client, 40);
ROSPLC_AT(rosplc_slot_header, reason, 56);
ROSPLC_AT(rosplc_slot_header, reserved, 60);
ROSPLC_STATIC_ASSERT(sizeof(rosplc_slot_header) == 64, "rosplc_slot_header has 64 bytes");
ROSPLC_AT(rosplc_goal_note, number, 0);
ROSPLC_AT(rosplc_goal_note, size, 4);
ROSPLC_AT(rosplc_goal_note, crc, 8);
ROSPLC_AT(rosplc_goal_note, reserved, 12);
ROSPLC_AT(rosplc_goal_note, uuid, 16);
ROSPLC_STATIC_ASSERT(sizeof(rosplc_goal_note) == 32, "rosplc_goal_note has 32 bytes");
ROSPLC_AT(rosplc_header, writer, 128);
ROSPLC_AT(rosplc_header, reader, 192);
ROSPLC_AT(rosplc_header, reserved, 448);
ROSPLC_STATIC_ASSERT(sizeof(rosplc_header) == ROSPLC_HEADER_SIZE, "the header has eight lines");

#endif
