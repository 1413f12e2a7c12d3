// The ROS end of a load over ROS 1, as `benchmarks.peers ros` is over others: numbered messages, all of them checked.
//
//   ros1_load TOPICS COUNT RATE DEPTH
//
// Messages are bytes, neither made nor taken apart, so that the peer is not what is measured. What follows `seq`,
// which roscpp sets by itself, is compared. Orders and answers are those of benchmarks/peers.py.
#include <atomic>
#include <chrono>
#include <cstring>
#include <iostream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <geometry_msgs/PoseStamped.h>
#include <ros/ros.h>

static constexpr int TEXT = 119, NUMBER = 4, HEAD = 16, SIZE = HEAD + TEXT + 56;

struct Bytes {
    uint8_t data[SIZE];
    uint32_t size = SIZE;
};

namespace ros {
namespace message_traits {
using Like = geometry_msgs::PoseStamped;
template <> struct MD5Sum<Bytes> {
    static const char *value() { return MD5Sum<Like>::value(); }
    static const char *value(const Bytes &) { return value(); }
};
template <> struct DataType<Bytes> {
    static const char *value() { return DataType<Like>::value(); }
    static const char *value(const Bytes &) { return value(); }
};
template <> struct Definition<Bytes> {
    static const char *value() { return Definition<Like>::value(); }
    static const char *value(const Bytes &) { return value(); }
};
}  // namespace message_traits
namespace serialization {
template <> struct Serializer<Bytes> {
    template <typename Stream> static void write(Stream &stream, const Bytes &message) {
        std::memcpy(stream.advance(SIZE), message.data, SIZE);
    }
    template <typename Stream> static void read(Stream &stream, Bytes &message) {
        message.size = stream.getLength();
        std::memcpy(message.data, stream.getData(), std::min<uint32_t>(message.size, SIZE));
    }
    static uint32_t serializedLength(const Bytes &) { return SIZE; }
};
}  // namespace serialization
}  // namespace ros

static void fill(Bytes &message, int topic, int number) {
    const double half = number / 2.0;
    const double pose[] = {double(number), double(topic), half, double(-number), double(number + topic), 0.5, half};
    const uint32_t length = TEXT;
    std::memset(message.data, 0, HEAD - 4);
    std::memcpy(message.data + NUMBER, &number, 4);
    std::memcpy(message.data + HEAD - 4, &length, 4);
    std::memset(message.data + HEAD, 'f', TEXT);
    std::memcpy(message.data + HEAD + TEXT, pose, sizeof pose);
}

struct Tally {
    int received = 0, missing = 0, wrong = 0;
    std::atomic<int> last{0};

    void add(const Bytes &message, int topic) {
        Bytes expected;
        int number;
        std::memcpy(&number, message.data + NUMBER, 4);
        fill(expected, topic, number);
        if (number <= last || message.size != SIZE || std::memcmp(message.data + 4, expected.data + 4, SIZE - 4)) {
            wrong++;
            return;
        }
        received++;
        missing += number - last - 1;
        last = number;
    }
};

static std::atomic<bool> go, more, ended;

int main(int argc, char **argv) {
    ros::init(argc, argv, "load", ros::init_options::NoSigintHandler);
    ros::NodeHandle node;
    ros::AsyncSpinner spinner(1);
    const int topics = std::stoi(argv[1]), count = std::stoi(argv[2]);
    const auto period = std::chrono::nanoseconds(1000000000 / std::stoi(argv[3]));
    const uint32_t depth = std::stoul(argv[4]);
    std::vector<std::unique_ptr<Tally>> tallies;
    std::vector<ros::Subscriber> ins;
    std::vector<ros::Publisher> outs;
    for (int i = 0; i < topics; i++) {
        Tally *tally = tallies.emplace_back(std::make_unique<Tally>()).get();
        boost::function<void(const boost::shared_ptr<Bytes const> &)> take =
            [tally, i](const boost::shared_ptr<Bytes const> &message) { tally->add(*message, i); };
        ins.push_back(node.subscribe<Bytes>("/load/out_" + std::to_string(i), depth, take, ros::VoidConstPtr(),
                                            ros::TransportHints().tcpNoDelay()));
        outs.push_back(node.advertise<Bytes>("/load/in_" + std::to_string(i), depth));
    }
    std::thread([] {
        for (std::string line; std::getline(std::cin, line);)
            (line == "go" ? go : line == "more" ? more : ended) = true;
        std::_Exit(0);
    }).detach();
    spinner.start();
    for (bool matched = false; !matched; std::this_thread::sleep_for(std::chrono::milliseconds(20))) {
        matched = true;
        for (int i = 0; i < topics; i++)
            matched = matched && ins[i].getNumPublishers() && outs[i].getNumSubscribers();
    }
    std::cout << "{\"ready\": true}" << std::endl;
    bool heard = false;
    Bytes message;
    int number = 0;
    for (auto due = std::chrono::steady_clock::now(); !ended; due += period) {
        std::this_thread::sleep_until(due);
        if (!heard) {
            heard = true;
            for (auto &tally : tallies)
                heard = heard && tally->last;
            if (heard)
                std::cout << "{\"heard\": true}" << std::endl;
        }
        if (number < count && (number ? more : go)) {
            number++;
            for (int i = 0; i < topics; i++) {
                fill(message, i, number);
                outs[i].publish(message);
            }
            if (number == count)
                std::cout << "{\"sent\": " << number << "}" << std::endl;
        }
    }
    spinner.stop();
    std::cout << "{\"sent\": " << number << ", \"seen\": {";
    for (int i = 0; i < topics; i++)
        std::cout << (i ? ", " : "") << "\"/load/out_" << i << "\": {\"received\": " << tallies[i]->received
                  << ", \"missing\": " << tallies[i]->missing << ", \"wrong\": " << tallies[i]->wrong << "}";
    std::cout << "}}" << std::endl;
    pause();
}
