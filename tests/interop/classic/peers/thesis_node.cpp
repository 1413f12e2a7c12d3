// A ROS 1 node that shares messages with a PLC as the shared-memory class of the source thesis does
// (appendix A.2): memory and semaphore are named as the topic; the semaphore is removed and made again
// twice at every start, with O_RDWR where its mode belongs; every wait is without end; the destructor
// removes both.
//
//   thesis_node read  TOPIC   publishes what stands in the memory, 100 times a second
//   thesis_node write TOPIC   writes what comes from ROS into the memory
//
// It says "ready". With HOLD=N in its environment it says "inside" in its N-th access, in the middle of the
// copy and inside the lock, and stays there. It ends when its input ends.
#include <fcntl.h>
#include <poll.h>
#include <semaphore.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include <geometry_msgs/Twist.h>
#include <ros/ros.h>

struct TwistRecord {
  double linear[3];
  double angular[3];
};

template <typename Record, typename Message>
class SharedTopic {
 public:
  enum Way { READ, WRITE };

  SharedTopic(const std::string& topic, Way way) : name_(topic) {
    make_semaphore();
    if (way == READ) publisher_ = node_.advertise<Message>("/" + topic, 1000, true);
    int fd = shm_open(name_.c_str(), O_CREAT | O_RDWR, S_IRWXU | S_IRWXG);
    if (fd < 0 || ftruncate(fd, sizeof(Record)) != 0) fail("memory");
    void* at = mmap(nullptr, sizeof(Record), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (at == MAP_FAILED) fail("mapping");
    record_ = static_cast<Record*>(at);
    close(fd);
    make_semaphore();
    if (way == WRITE) subscriber_ = node_.subscribe("/" + topic, 1000, &SharedTopic::on_message, this);
  }

  virtual ~SharedTopic() {
    munmap(record_, sizeof(Record));
    shm_unlink(name_.c_str());
    sem_close(lock_);
    sem_unlink(name_.c_str());
  }

  void read() {
    sem_wait(lock_);
    to_message();
    sem_post(lock_);
    publisher_.publish(message_);
  }

 protected:
  virtual void to_message() = 0;
  virtual void to_record(const Message& message) = 0;

  void hold() {
    static const char* wanted = getenv("HOLD");
    static int count = 0;
    if (wanted == nullptr || ++count != atoi(wanted)) return;
    printf("inside\n");
    fflush(stdout);
    for (;;) pause();
  }

  Record* record_ = nullptr;
  Message message_;

 private:
  void make_semaphore() {
    sem_unlink(name_.c_str());
    lock_ = sem_open(name_.c_str(), O_CREAT, O_RDWR, 1);
    if (lock_ == SEM_FAILED) fail("semaphore");
  }

  void on_message(const Message& message) {
    sem_wait(lock_);
    to_record(message);
    sem_post(lock_);
  }

  static void fail(const char* what) {
    perror(what);
    exit(1);
  }

  std::string name_;
  ros::NodeHandle node_;
  ros::Publisher publisher_;
  ros::Subscriber subscriber_;
  sem_t* lock_ = SEM_FAILED;
};

class TwistTopic : public SharedTopic<TwistRecord, geometry_msgs::Twist> {
 public:
  using SharedTopic::SharedTopic;

 protected:
  void to_message() override {
    message_.linear.x = record_->linear[0];
    message_.linear.y = record_->linear[1];
    message_.linear.z = record_->linear[2];
    hold();
    message_.angular.x = record_->angular[0];
    message_.angular.y = record_->angular[1];
    message_.angular.z = record_->angular[2];
  }

  void to_record(const geometry_msgs::Twist& message) override {
    record_->linear[0] = message.linear.x;
    record_->linear[1] = message.linear.y;
    record_->linear[2] = message.linear.z;
    hold();
    record_->angular[0] = message.angular.x;
    record_->angular[1] = message.angular.y;
    record_->angular[2] = message.angular.z;
  }
};

static bool input_ended() {
  pollfd input = {0, POLLIN, 0};
  char byte;
  return poll(&input, 1, 0) > 0 && ::read(0, &byte, 1) <= 0;
}

int main(int argc, char** argv) {
  if (argc < 3) return 2;
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // a test run that is killed leaves nobody inside
  const bool reads = std::string(argv[1]) == "read";
  ros::init(argc, argv, std::string("thesis_") + argv[2], ros::init_options::NoSigintHandler);
  TwistTopic topic(argv[2], reads ? TwistTopic::READ : TwistTopic::WRITE);
  printf("ready\n");
  fflush(stdout);
  ros::Rate rate(100);
  while (ros::ok() && !input_ended()) {
    if (reads) topic.read();
    ros::spinOnce();
    rate.sleep();
  }
  return 0;
}
