// A plain roscpp program: typed publishers and subscribers, driven by lines on standard input.
//
// Commands and answers are those of rospy_peer.py. Messages go through roscpp's generated types, both
// ways; cell_msgs/Part is written out here as genmsg would write it.
#include <cstdio>
#include <functional>
#include <iostream>
#include <map>
#include <mutex>
#include <sstream>
#include <string>
#include <vector>

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/Twist.h>
#include <ros/ros.h>
#include <sensor_msgs/JointState.h>
#include <std_msgs/Int32.h>
#include <std_msgs/String.h>

#ifdef PART_MD5
namespace cell_msgs {
struct Part {
    std_msgs::Header header;
    std::string serial;
    geometry_msgs::Pose place;
    std::vector<float> weights;
    uint8_t state = 0;
};
}  // namespace cell_msgs

namespace ros {
namespace message_traits {
template <> struct MD5Sum<cell_msgs::Part> {
    static const char *value() { return PART_MD5; }
    static const char *value(const cell_msgs::Part &) { return PART_MD5; }
};
template <> struct DataType<cell_msgs::Part> {
    static const char *value() { return "cell_msgs/Part"; }
    static const char *value(const cell_msgs::Part &) { return "cell_msgs/Part"; }
};
template <> struct Definition<cell_msgs::Part> {
    static const char *value() { return PART_TEXT; }
    static const char *value(const cell_msgs::Part &) { return PART_TEXT; }
};
template <> struct HasHeader<cell_msgs::Part> : TrueType {};
}  // namespace message_traits
namespace serialization {
template <> struct Serializer<cell_msgs::Part> {
    template <typename Stream, typename T> inline static void allInOne(Stream &stream, T m) {
        stream.next(m.header);
        stream.next(m.serial);
        stream.next(m.place);
        stream.next(m.weights);
        stream.next(m.state);
    }
    ROS_DECLARE_ALLINONE_SERIALIZER
};
}  // namespace serialization
}  // namespace ros
#endif

static std::mutex print_lock;

static void say(const std::string &line) {
    std::lock_guard<std::mutex> guard(print_lock);
    std::cout << line << std::endl;
}

static std::string hex_of(const uint8_t *data, size_t length) {
    if (length == 0)
        return "-";
    std::string text;
    char pair[3];
    for (size_t i = 0; i < length; i++) {
        std::snprintf(pair, sizeof pair, "%02x", data[i]);
        text += pair;
    }
    return text;
}

static std::vector<uint8_t> bytes_of(const std::string &text) {
    std::vector<uint8_t> data;
    if (text != "-")
        for (size_t i = 0; i + 1 < text.size(); i += 2)
            data.push_back(static_cast<uint8_t>(std::stoi(text.substr(i, 2), nullptr, 16)));
    return data;
}

struct Endpoint {
    ros::Subscriber subscriber;
    ros::Publisher publisher;
    std::function<void(const std::string &)> write;
    uint32_t matched() const {
        return publisher ? publisher.getNumSubscribers() : subscriber.getNumPublishers();
    }
};

template <typename T> static void subscribe(Endpoint &end, ros::NodeHandle &node, const std::string &topic, uint32_t queue) {
    boost::function<void(const boost::shared_ptr<T const> &)> receive =
        [topic](const boost::shared_ptr<T const> &message) {
            std::vector<uint8_t> data(ros::serialization::serializationLength(*message));
            ros::serialization::OStream stream(data.data(), data.size());
            ros::serialization::serialize(stream, *message);
            say("message " + topic + " " + hex_of(data.data(), data.size()));
        };
    end.subscriber = node.subscribe<T>(topic, queue, receive, ros::VoidConstPtr(), ros::TransportHints().tcpNoDelay());
}

template <typename T>
static void advertise(Endpoint &end, ros::NodeHandle &node, const std::string &topic, uint32_t queue, bool latch) {
    end.publisher = node.advertise<T>(topic, queue, latch);
    ros::Publisher publisher = end.publisher;
    end.write = [publisher](const std::string &hex) {
        std::vector<uint8_t> data = bytes_of(hex);
        ros::serialization::IStream stream(data.data(), data.size());
        T message;
        ros::serialization::deserialize(stream, message);
        publisher.publish(message);
    };
}

template <typename T>
static void open(bool in, Endpoint &end, ros::NodeHandle &node, const std::string &topic, uint32_t queue, bool latch) {
    if (in)
        subscribe<T>(end, node, topic, queue);
    else
        advertise<T>(end, node, topic, queue, latch);
}

int main(int argc, char **argv) {
    ros::init(argc, argv, argv[1], ros::init_options::NoSigintHandler);
    ros::NodeHandle node;
    ros::AsyncSpinner spinner(1);
    spinner.start();
    std::map<std::string, Endpoint> endpoints;
    say("ready");
    std::string line;
    while (std::getline(std::cin, line)) {
        std::istringstream words(line);
        std::string command, topic, type, hex;
        uint32_t queue = 0;
        int latch = 0;
        words >> command >> topic;
        if (command == "subscribe" || command == "advertise") {
            bool in = command == "subscribe";
            words >> type >> queue >> latch;
            Endpoint &end = endpoints[topic];
            if (type == "std_msgs/String")
                open<std_msgs::String>(in, end, node, topic, queue, latch);
            else if (type == "std_msgs/Int32")
                open<std_msgs::Int32>(in, end, node, topic, queue, latch);
            else if (type == "geometry_msgs/Twist")
                open<geometry_msgs::Twist>(in, end, node, topic, queue, latch);
            else if (type == "geometry_msgs/PoseStamped")
                open<geometry_msgs::PoseStamped>(in, end, node, topic, queue, latch);
            else if (type == "sensor_msgs/JointState")
                open<sensor_msgs::JointState>(in, end, node, topic, queue, latch);
#ifdef PART_MD5
            else if (type == "cell_msgs/Part")
                open<cell_msgs::Part>(in, end, node, topic, queue, latch);
#endif
            else
                return 2;
        } else if (command == "write") {
            words >> hex;
            endpoints[topic].write(hex);
        } else if (command == "unadvertise") {
            endpoints.erase(topic);
        } else if (command == "matched") {
            say("matched " + topic + " " + std::to_string(endpoints[topic].matched()));
            continue;
        }
        say("done " + command + " " + topic);
    }
    return 0;
}
