// A host with two tasks, each a thread of its own as in OpenPLC, whose blocks are of the same types: each passes on what
// it reads until it was told the number of messages, and calls one more block in every scan that finds no object.
#include "generated.hpp"
#include <cstdlib>
#include <thread>
#include <unistd.h>

using namespace strucpp;

static void task(const char *from, const char *to, unsigned messages)
{
    static constexpr size_t MORE = 512;
    KINDS_ALL_READ *there = new KINDS_ALL_READ, *more = new KINDS_ALL_READ[MORE];
    KINDS_ALL_WRITE *back = new KINDS_ALL_WRITE;
    there->STOPIC = from;
    there->XINORDER = true;
    back->STOPIC = to;
    for (size_t scan = 0; back->UDIPUBLISHED.get() < messages; scan++) {
        (*there)();
        for (bool got = there->XNEW.get(); got; got = there->NEXT().get()) {
            back->MSG = there->MSG;
            back->XENABLE = true;
            (*back)();
        }
        back->XENABLE = false;
        (*back)();
        more[scan % MORE].STOPIC = "/nowhere";
        more[scan % MORE]();
        usleep(1000);
    }
}

int main(int, char **arguments)
{
    const unsigned messages = static_cast<unsigned>(std::atoi(arguments[1]));
    std::thread fast(task, "/there", "/back", messages), slow(task, "/slow_there", "/slow_back", messages);
    fast.join();
    slow.join();
}
