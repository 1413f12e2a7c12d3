// What a user would write instead of rosplc: a roscpp node that copies PoseStamped between ROS 1 and shared memory.
//
//   ros1_node DEPTH {in|out TOPIC OBJECT}...
//
// `in` topics go from ROS into an object, `out` topics from an object to ROS, as in ROBIN: callbacks copy field by
// field, and a thread looks at the objects every millisecond and publishes. Ends with its standard input.
#include <chrono>
#include <cstring>
#include <iostream>
#include <thread>
#include <vector>

#include <geometry_msgs/PoseStamped.h>
#include <ros/ros.h>

struct object;
extern "C" {
object *object_open(const char *path, int inward);
size_t object_size(const object *);
uint8_t *object_begin(object *);
void object_commit(object *);
int object_next(object *, uint8_t *record);
}

using geometry_msgs::PoseStamped;
static constexpr size_t TEXT = 12, POSE = 56; // where frame_id begins, bytes of the pose at the end

static void receive(object *to, const PoseStamped &from) {
    const size_t size = object_size(to), room = size - POSE - TEXT, length = from.header.frame_id.size();
    const auto &p = from.pose.position;
    const auto &q = from.pose.orientation;
    const double pose[] = {p.x, p.y, p.z, q.x, q.y, q.z, q.w};
    if (length >= room)
        std::exit(3);
    uint8_t *record = object_begin(to);
    std::memcpy(record, &from.header.seq, 4);
    std::memcpy(record + 4, &from.header.stamp.sec, 4);
    std::memcpy(record + 8, &from.header.stamp.nsec, 4);
    std::memcpy(record + TEXT, from.header.frame_id.data(), length);
    std::memset(record + TEXT + length, 0, room - length);
    std::memcpy(record + size - POSE, pose, POSE);
    object_commit(to);
}

static void send(const uint8_t *record, size_t size, ros::Publisher &to) {
    PoseStamped message;
    double pose[7];
    std::memcpy(&message.header.seq, record, 4);
    std::memcpy(&message.header.stamp.sec, record + 4, 4);
    std::memcpy(&message.header.stamp.nsec, record + 8, 4);
    message.header.frame_id = reinterpret_cast<const char *>(record + TEXT);
    std::memcpy(pose, record + size - POSE, POSE);
    message.pose.position.x = pose[0], message.pose.position.y = pose[1], message.pose.position.z = pose[2];
    message.pose.orientation.x = pose[3], message.pose.orientation.y = pose[4];
    message.pose.orientation.z = pose[5], message.pose.orientation.w = pose[6];
    to.publish(message);
}

int main(int argc, char **argv) {
    std::vector<ros::Subscriber> ins;
    std::vector<std::pair<object *, ros::Publisher>> outs;
    ros::init(argc, argv, "ros1_node", ros::init_options::NoSigintHandler);
    ros::NodeHandle node;
    const uint32_t depth = std::stoul(argv[1]);
    for (char **word = argv + 2; *word; word += 3) {
        const bool inward = !std::strcmp(word[0], "in");
        object *one = object_open(word[2], inward);
        if (inward) {
            boost::function<void(const PoseStamped::ConstPtr &)> take =
                [one](const PoseStamped::ConstPtr &message) { receive(one, *message); };
            ins.push_back(node.subscribe<PoseStamped>(word[1], depth, take, ros::VoidConstPtr(),
                                                      ros::TransportHints().tcpNoDelay()));
        } else {
            outs.emplace_back(one, node.advertise<PoseStamped>(word[1], depth));
        }
    }
    std::thread([&outs] {
        std::vector<uint8_t> record(4096);
        for (auto due = std::chrono::steady_clock::now();; due += std::chrono::milliseconds(1)) {
            std::this_thread::sleep_until(due);
            for (auto &[from, to] : outs)
                while (object_next(from, record.data()))
                    send(record.data(), object_size(from), to);
        }
    }).detach();
    std::thread([] {
        std::cin.ignore(std::numeric_limits<std::streamsize>::max());
        std::_Exit(0);
    }).detach();
    std::cout << "{\"ready\": true}" << std::endl;
    ros::spin();
}
