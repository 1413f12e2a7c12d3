// A peer on Fast DDS's C++ interface. See README.md for its arguments and its output.
#include <cinttypes>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <memory>
#include <mutex>
#include <string>

#include <poll.h>
#include <unistd.h>

#include <fastdds/dds/core/status/SubscriptionMatchedStatus.hpp>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include "ros_typesPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::types::ReturnCode_t;
using std_msgs::msg::dds_::String_;
using geometry_msgs::msg::dds_::Twist_;
using sensor_msgs::msg::dds_::JointState_;
using rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_;

static void print_text(const std::string &text) { printf(" \"%s\"", text.c_str()); }
static void print_numbers(const std::vector<double> &numbers) {
    printf(" [");
    for (size_t i = 0; i < numbers.size(); i++) printf("%s%.17g", i ? " " : "", numbers[i]);
    printf("]");
}
template <typename Bytes> static void print_hex(const Bytes &bytes) {
    for (auto byte : bytes) printf("%02x", static_cast<unsigned>(byte));
}

static void fill(String_ &m, int i) { m.data("message " + std::to_string(i)); }
static void print(const String_ &m) { print_text(m.data()); }

static void fill(Twist_ &m, int i) {
    m.linear().x(i + 0.5); m.linear().y(-i); m.linear().z(1e-300);
#ifdef OTHER_DEFINITION
    m.mode(i);
#else
    m.angular().x(0.1); m.angular().y(1e300); m.angular().z(i * 0.25);
#endif
}
static void print(const Twist_ &m) {
    printf(" %.17g %.17g %.17g", m.linear().x(), m.linear().y(), m.linear().z());
#ifdef OTHER_DEFINITION
    printf(" %d", m.mode());
#else
    printf(" %.17g %.17g %.17g", m.angular().x(), m.angular().y(), m.angular().z());
#endif
}

static void fill(JointState_ &m, int i) {
    m.header().stamp().sec(-i); m.header().stamp().nanosec(4000000000u);
    m.header().frame_id("base");
    m.name().clear(); m.position().clear();
    for (int k = 0; k < i % 8; k++) {
        m.name().push_back("joint" + std::to_string(k));
        m.position().push_back(k + i / 4.0);
    }
    m.velocity({2.5});
    m.effort(std::vector<double>());
}
static void print(const JointState_ &m) {
    printf(" %d %u", m.header().stamp().sec(), m.header().stamp().nanosec());
    print_text(m.header().frame_id());
    printf(" [");
    for (size_t k = 0; k < m.name().size(); k++) printf("%s%s", k ? " " : "", m.name()[k].c_str());
    printf("]");
    print_numbers(m.position()); print_numbers(m.velocity()); print_numbers(m.effort());
}

static void fill(ParticipantEntitiesInfo_ &, int) {}
static void print(const ParticipantEntitiesInfo_ &m) {
    auto gids = [](const std::vector<rmw_dds_common::msg::dds_::Gid_> &list) {
        printf(" [");
        for (size_t i = 0; i < list.size(); i++) { if (i) printf(" "); print_hex(list[i].data()); }
        printf("]");
    };
    printf(" ");
    print_hex(m.gid().data());
    for (const auto &node : m.node_entities_info_seq()) {
        print_text(std::string(node.node_namespace().c_str())); print_text(std::string(node.node_name().c_str()));
        gids(node.reader_gid_seq()); gids(node.writer_gid_seq());
    }
}

struct Kind {
    TypeSupport type;
    std::function<void(DataWriter *, int)> write;
    std::function<bool(DataReader *)> take;
};
template <typename T, typename Support> static Kind make_kind() {
    auto data = std::make_shared<T>();
    return {TypeSupport(new Support()),
            [data](DataWriter *writer, int i) { fill(*data, i); writer->write(data.get()); },
            [data](DataReader *reader) {
                SampleInfo info;
                if (reader->take_next_sample(data.get(), &info) != ReturnCode_t::RETCODE_OK) return false;
                if (info.valid_data) { printf("message"); print(*data); puts(""); }
                return true;
            }};
}

static bool stdin_closed(int timeout_ms) {
    pollfd p{0, POLLIN, 0};
    char c;
    return poll(&p, 1, timeout_ms) > 0 && read(0, &c, 1) <= 0;
}

// Everything that discovery shows: what `ros2 topic info -v` stands on.
class Discovery : public DomainParticipantListener {
    std::mutex mutex_;
    template <typename Info> void endpoint(const char *kind, const Info &info) {
        std::lock_guard<std::mutex> lock(mutex_);
        printf("%s %s %s ", kind, info.topicName().c_str(), info.typeName().c_str());
        print_hex(info.guid().guidPrefix.value); print_hex(info.guid().entityId.value);
        std::string user(info.m_qos.m_userData.begin(), info.m_qos.m_userData.end());
        printf(" %s\n", user.c_str());
        fflush(stdout);
    }
    void on_participant_discovery(DomainParticipant *, eprosima::fastrtps::rtps::ParticipantDiscoveryInfo &&found) override {
        if (found.status != found.DISCOVERED_PARTICIPANT) return;
        std::lock_guard<std::mutex> lock(mutex_);
        printf("participant ");
        print_hex(found.info.m_guid.guidPrefix.value); print_hex(found.info.m_guid.entityId.value);
        std::string user(found.info.m_userData.begin(), found.info.m_userData.end());
        printf(" %s\n", user.c_str());
        fflush(stdout);
    }
    void on_publisher_discovery(DomainParticipant *, eprosima::fastrtps::rtps::WriterDiscoveryInfo &&found) override {
        if (found.status == found.DISCOVERED_WRITER) endpoint("publisher", found.info);
    }
    void on_subscriber_discovery(DomainParticipant *, eprosima::fastrtps::rtps::ReaderDiscoveryInfo &&found) override {
        if (found.status == found.DISCOVERED_READER) endpoint("subscription", found.info);
    }
};

int main(int argc, char **argv) {
    if (argc < 3) return 2;
    DomainParticipantQos participant_qos = PARTICIPANT_QOS_DEFAULT;
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->maxInitialPeersRange = 33;
    participant_qos.transport().use_builtin_transports = false;
    participant_qos.transport().user_transports.push_back(udp);
    eprosima::fastrtps::rtps::Locator_t local;
    eprosima::fastrtps::rtps::IPLocator::setIPv4(local, 127, 0, 0, 1);
    local.port = 0;  // every participant's
    participant_qos.wire_protocol().builtin.initialPeersList.push_back(local);
    participant_qos.wire_protocol().builtin.avoid_builtin_multicast = true;
    bool discover = argc == 3 && !strcmp(argv[2], "discover");
    Discovery discovery;
    auto factory = DomainParticipantFactory::get_instance();
    auto participant = factory->create_participant(
        static_cast<uint32_t>(atoi(argv[1])), participant_qos, discover ? &discovery : nullptr, StatusMask::none());
    if (!participant) return 1;
    if (discover) {
        puts("ready");
        fflush(stdout);
        while (!stdin_closed(100)) {}
        factory->delete_participant(participant);
        return 0;
    }
    if (argc < 9) return 2;
    bool publish = !strcmp(argv[2], "pub"), reliable = !strcmp(argv[5], "reliable");
    bool latched = !strcmp(argv[6], "transient_local");
    int depth = atoi(argv[7]), count = atoi(argv[8]);
    std::string name = argv[3];
    Kind kind;
    if (name == "String") kind = make_kind<String_, std_msgs::msg::dds_::String_PubSubType>();
    else if (name == "Twist") kind = make_kind<Twist_, geometry_msgs::msg::dds_::Twist_PubSubType>();
    else if (name == "JointState") kind = make_kind<JointState_, sensor_msgs::msg::dds_::JointState_PubSubType>();
    else if (name == "Nodes") kind = make_kind<ParticipantEntitiesInfo_, rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_PubSubType>();
    else return 2;
    kind.type.register_type(participant);
    auto topic = participant->create_topic(argv[4], kind.type.get_type_name(), TOPIC_QOS_DEFAULT);
    auto set = [&](auto &qos) {
        qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
        qos.durability().kind = latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
        qos.history().kind = KEEP_LAST_HISTORY_QOS;
        qos.history().depth = depth;
        qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
        if (argc > 9) qos.user_data().setValue(std::vector<uint8_t>(argv[9], argv[9] + strlen(argv[9])));
    };
    if (publish) {
        DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
        set(qos);
        qos.publish_mode().kind = SYNCHRONOUS_PUBLISH_MODE;
        auto writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, qos);
        if (!writer) return 1;
        puts("ready");
        fflush(stdout);
        PublicationMatchedStatus status;
        status.current_count = 0;
        while (!latched && status.current_count == 0) {
            if (stdin_closed(5)) return 0;
            writer->get_publication_matched_status(status);
        }
        for (int i = 0; i < count; i++) {
            kind.write(writer, i);
            usleep(2000);
        }
        printf("sent %d\n", count);
        fflush(stdout);
        while (!stdin_closed(100)) {}
    } else {
        DataReaderQos qos = DATAREADER_QOS_DEFAULT;
        set(qos);
        auto reader = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic, qos);
        if (!reader) return 1;
        puts("ready");
        fflush(stdout);
        do {
            while (kind.take(reader)) {}
            fflush(stdout);
        } while (!stdin_closed(2));
    }
    participant->delete_contained_entities();
    factory->delete_participant(participant);
    return 0;
}
