// Copies between the variables of a program compiled by STruC++ and rosplc's records; only for rosplc_blocks.cpp.
//
// A block's resources (mapping, claims, copy of a record) are not in its instance: STruC++ has no destructor, and
// retained variables would restore those of an earlier run. They are in a list, by the address of the instance, and
// are released when the program is unloaded. All symbols are local to this file: a symbol that is shared between
// libraries would keep the program loaded.
#include <atomic>
#include <cstring>
#include <ctime>
#include <new>

#include <rosplc/plc.h>

namespace strucpp {
namespace {

template <class T> void get(IECVar<T> &to, const uint8_t *from)
{
    T value;
    std::memcpy(&value, from, sizeof value);
    to = value;
}

[[maybe_unused]] void get(IECVar<bool> &to, const uint8_t *from)
{
    to = *from != 0;
}

template <size_t Most> void get(IECStringVar<Most> &to, const uint8_t *from, size_t capacity)
{
    const void *end = std::memchr(from, 0, capacity);
    size_t length = end ? static_cast<size_t>(static_cast<const uint8_t *>(end) - from) : capacity;
    to.set(IECString<Most>(reinterpret_cast<const char *>(from), length));
}

template <class T> void put(uint8_t *to, const IECVar<T> &from)
{
    T value = from.get();
    std::memcpy(to, &value, sizeof value);
}

template <size_t Most> void put(uint8_t *to, const IECStringVar<Most> &from, size_t capacity)
{
    const IECString<Most> text = from.get();
    size_t length = text.length() < capacity ? text.length() : capacity;
    std::memcpy(to, text.c_str(), length);
    std::memset(to + length, 0, capacity + 1 - length);
}

// In OpenPLC 4.1.4, TIME() advances only in the fastest task.
uint32_t now_ms()
{
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<uint32_t>(static_cast<uint64_t>(now.tv_sec) * 1000u + static_cast<uint64_t>(now.tv_nsec) / 1000000u);
}

// One attempt to open per scan: the next is allowed when the block that made the last attempt is called again.
struct rosplc_pace {
    int may_open;
    const void *user;
    uint32_t at;
};
thread_local rosplc_pace pace = {1, nullptr, 0};

void before_call(const void *block, uint32_t now)
{
    if (pace.user == block || now - pace.at >= 1000u)
        pace.may_open = 1;
    pace.user = pace.may_open ? nullptr : pace.user;
}

void after_call(const void *block, uint32_t now)
{
    if (!pace.may_open && !pace.user) {
        pace.user = block;
        pace.at = now;
    }
}

template <class Own> class rosplc_list {
    struct node {
        const void *block;
        node *next;
        Own own;
    };
    std::atomic<node *> first{nullptr};

public:
    // The first call of an instance allocates memory. Tasks may add entries at the same time; none are removed.
    Own *of(const void *block)
    {
        node *made;
        for (node *at = first.load(std::memory_order_acquire); at; at = at->next) {
            if (at->block == block)
                return &at->own;
        }
        made = new (std::nothrow) node();
        if (!made)
            return nullptr;
        made->block = block;
        made->next = first.load(std::memory_order_relaxed);
        while (!first.compare_exchange_weak(made->next, made, std::memory_order_release, std::memory_order_relaxed)) {
        }
        return &made->own;
    }

    ~rosplc_list()
    {
        for (node *at = first.load(); at;) {
            node *next = at->next;
            delete at;
            at = next;
        }
    }
};

template <class Layout> struct rosplc_own_reader {
    rosplc::plc_reader reader;
    char topic[256];
    alignas(8) uint8_t record[Layout::SIZE];
};

template <class Layout> struct rosplc_own_writer {
    rosplc::plc_writer writer;
    char topic[256];
};

template <size_t Size, class Text> bool keep(char (&place)[Size], const Text &text)
{
    if (place[0] || text.get().length() == 0 || text.get().length() >= Size)
        return false;
    std::memcpy(place, text.get().c_str(), text.get().length() + 1);
    return true;
}

uint32_t to_ms(int64_t nanoseconds)
{
    return static_cast<uint32_t>((nanoseconds + 999999) / 1000000);
}

template <class Block> void show(Block *block, const rosplc_plc_channel &channel)
{
    block->XATTACHED = channel.attached != 0;
    block->XPEERALIVE = channel.peer_alive != 0;
    block->UDIERROR = channel.error;
    block->XERROR = channel.error != 0;
    block->UDIREENTRIES = channel.reentries;
}

template <class Block> void show_found(Block *block, const rosplc_plc_channel &channel)
{
    show(block, channel);
    block->UDIFOUNDLAYOUTLO = channel.found_layout_lo;
    block->UDIFOUNDLAYOUTHI = channel.found_layout_hi;
}

template <class Layout, class Block> bool rosplc_read(Block *block, bool next)
{
    static rosplc_list<rosplc_own_reader<Layout>> list;
    rosplc_own_reader<Layout> *own = list.of(block);
    const uint32_t now = now_ms();
    if (!own)
        return false;
    rosplc_plc_reader &r = own->reader;
    if (keep(own->topic, block->STOPIC)) {
        rosplc_plc_reader_init(&r, ROSPLC_PREFIX, own->topic, Layout::LAYOUT_LO, Layout::LAYOUT_HI, Layout::SIZE, own->record);
        r.channel.beat_ms = ROSPLC_BEAT_MS;
    }
    r.channel.may_open = &pace.may_open;
    r.stale_after_ms = to_ms(block->TSTALEAFTER.get());
    r.on_stale = block->UIONSTALE.get();
    r.in_order = block->XINORDER.get();
    r.max_per_scan = block->UIMAXPERSCAN.get();
    r.latched = block->XLATCHED.get();
    before_call(block, now);
    const bool got = (next ? rosplc_plc_next(&r, now) : rosplc_plc_read(&r, now)) != 0;
    after_call(block, now);
    if (got)
        Layout::take(block->MSG, own->record);
    show_found(block, r.channel);
    block->XVALID = r.valid != 0;
    block->XNEW = r.is_new != 0;
    block->XSTALE = r.stale != 0;
    block->XFIRST = r.first != 0;
    block->XRECOVERED = r.recovered != 0;
    block->XTRUNCATED = r.truncated != 0;
    block->XSUBSTITUTED = r.substituted != 0;
    block->UDISEQUENCE = r.sequence;
    block->TAGE = static_cast<int64_t>(r.age_ms) * 1000000;
    block->UDILOST = r.lost;
    block->UDIRETRIES = r.retries;
    block->UDIDISCONTINUITIES = r.discontinuities;
    block->UDISOURCES = r.sources;
    block->XSOURCEPRESENT = r.source_present != 0;
    block->UDISTAMPLO = r.stamp_lo;
    block->UDISTAMPHI = r.stamp_hi;
    block->ULISTAMP = static_cast<uint64_t>(r.stamp_hi) << 32 | r.stamp_lo;
    block->UITAKEN = static_cast<uint16_t>(r.taken);
    if (r.stale && r.on_stale == ROSPLC_PLC_SAFE) {
        block->MSG = block->STSAFE;
        block->XSUBSTITUTED = true;
    }
    return next && got;
}

template <class Layout, class Block> void rosplc_write(Block *block)
{
    static rosplc_list<rosplc_own_writer<Layout>> list;
    rosplc_own_writer<Layout> *own = list.of(block);
    const uint32_t now = now_ms();
    if (!own)
        return;
    rosplc_plc_writer &w = own->writer;
    if (keep(own->topic, block->STOPIC)) {
        rosplc_plc_writer_init(&w, ROSPLC_PREFIX, own->topic, Layout::LAYOUT_LO, Layout::LAYOUT_HI, Layout::SIZE);
        w.channel.beat_ms = ROSPLC_BEAT_MS;
    }
    w.channel.may_open = &pace.may_open;
    const uint64_t stamp = block->ULISTAMP.get();
    w.stamp_lo = stamp ? static_cast<uint32_t>(stamp) : block->UDISTAMPLO.get();
    w.stamp_hi = stamp ? static_cast<uint32_t>(stamp >> 32) : block->UDISTAMPHI.get();
    before_call(block, now);
    uint8_t *record = static_cast<uint8_t *>(rosplc_plc_write_begin(&w, now, block->XENABLE.get()));
    after_call(block, now);
    if (record)
        Layout::give(record, block->MSG);
    rosplc_plc_write_end(&w);
    show_found(block, w.channel);
    block->XREADY = w.ready != 0;
    block->XPUBLISHED = w.published != 0;
    block->UDISEQUENCE = w.sequence;
    block->UDIPUBLISHED = w.count;
    block->UDIUNSENT = w.unsent;
    block->TTAKEOVER = static_cast<int64_t>(w.takeover_ms) * 1000000;
    block->UDITAKEN = w.taken;
    block->UDISINKS = w.sinks;
}

// A service has no feedback.
struct rosplc_no_feedback {
    static constexpr uint32_t LAYOUT_LO = 0, LAYOUT_HI = 0, SIZE = 0;
};

template <class Kind, class Request, class Response, class Feedback> struct rosplc_own_use {
    static constexpr bool ACTION = Feedback::SIZE != 0;
    Kind block;
    char name[256], client[33];
    alignas(8) uint8_t request[Request::SIZE];
    alignas(8) uint8_t response[Response::SIZE];
    alignas(8) uint8_t feedback[Feedback::SIZE + 1];
    const rosplc_plc_part parts[3] = {
        {Request::LAYOUT_LO, Request::LAYOUT_HI, Request::SIZE, request},
        {Response::LAYOUT_LO, Response::LAYOUT_HI, Response::SIZE, response},
        {Feedback::LAYOUT_LO, Feedback::LAYOUT_HI, Feedback::SIZE, feedback},
    };
};

template <class Request, class Response, class Feedback, class Block> void rosplc_call_server(Block *block)
{
    static rosplc_list<rosplc_own_use<rosplc::plc_client, Request, Response, Feedback>> list;
    auto *own = list.of(block);
    const uint32_t now = now_ms();
    constexpr bool action = Feedback::SIZE != 0;
    if (!own)
        return;
    rosplc_plc_client &c = own->block;
    if (keep(own->name, block->SNAME)) {
        keep(own->client, block->SCLIENT);
        rosplc_plc_client_init(&c, ROSPLC_PREFIX, own->name, own->client, own->parts, action);
        c.block.beat_ms = ROSPLC_BEAT_MS;
    }
    c.block.may_open = &pace.may_open;
    c.execute = block->XEXECUTE.get();
    c.timeout_ms = to_ms(block->TTIMEOUT.get());
    c.grace_ms = to_ms(block->TBRIDGEGRACE.get());
    if constexpr (action)
        c.stop = block->XCANCEL.get();
    else
        c.stop = block->XABORT.get();
    before_call(block, now);
    if (rosplc_plc_client_begin(&c, now)) {
        if constexpr (action)
            Request::give(own->request, block->GOAL);
        else
            Request::give(own->request, block->REQUEST);
    }
    const int got = rosplc_plc_client_end(&c);
    after_call(block, now);
    show(block, c.block);
    block->XERROR = c.failed != 0;
    block->XBUSY = c.busy != 0;
    block->XDONE = c.done != 0;
    block->XABORTED = c.aborted != 0;
    block->EREASON = c.reason;
    block->XSERVER = c.server != 0;
    block->UDICALLS = c.calls;
    block->UDILATE = c.late;
    if constexpr (action) {
        block->XACTIVE = c.active != 0;
        block->XCANCELREJECTED = c.cancel_rejected != 0;
        block->ESTATUS = c.status;
        block->XNEWFEEDBACK = c.new_feedback != 0;
        if (got & ROSPLC_PLC_FEEDBACK)
            Feedback::take(block->FEEDBACK, own->feedback);
        if (got & ROSPLC_PLC_RESPONSE)
            Response::take(block->RESULT, own->response);
    } else if (got & ROSPLC_PLC_RESPONSE) {
        Response::take(block->RESPONSE, own->response);
    }
}

template <class Request, class Response, class Feedback, class Block> void rosplc_serve(Block *block)
{
    static rosplc_list<rosplc_own_use<rosplc::plc_server, Request, Response, Feedback>> list;
    auto *own = list.of(block);
    const uint32_t now = now_ms();
    constexpr bool action = Feedback::SIZE != 0;
    if (!own)
        return;
    rosplc_plc_server &s = own->block;
    if (keep(own->name, block->SNAME)) {
        rosplc_plc_server_init(&s, ROSPLC_PREFIX, own->name, own->parts, action);
        s.block.beat_ms = ROSPLC_BEAT_MS;
    }
    s.block.may_open = &pace.may_open;
    s.steps = block->XREJECT.get() ? ROSPLC_PLC_REJECT : 0;
    if constexpr (action) {
        s.send_feedback = block->XSENDFEEDBACK.get();
        s.steps |= (block->XACCEPT.get() ? ROSPLC_PLC_ACCEPT : 0u)
                   | (block->XACCEPTCANCEL.get() ? ROSPLC_PLC_ACCEPT_CANCEL : 0u)
                   | (block->XREJECTCANCEL.get() ? ROSPLC_PLC_REJECT_CANCEL : 0u)
                   | (block->XSUCCEED.get() ? ROSPLC_PLC_SUCCEED : 0u) | (block->XABORT.get() ? ROSPLC_PLC_ABORT : 0u)
                   | (block->XCANCELED.get() ? ROSPLC_PLC_CANCELED : 0u);
    } else {
        s.steps |= block->XREPLY.get() ? ROSPLC_PLC_REPLY : 0u;
    }
    before_call(block, now);
    const int wanted = rosplc_plc_server_begin(&s, now);
    if constexpr (action) {
        if (wanted & ROSPLC_PLC_REQUEST)
            Request::take(block->GOAL, own->request);
        if (wanted & ROSPLC_PLC_RESPONSE)
            Response::give(own->response, block->RESULT);
        if (wanted & ROSPLC_PLC_FEEDBACK)
            Feedback::give(own->feedback, block->FEEDBACK);
    } else {
        if (wanted & ROSPLC_PLC_REQUEST)
            Request::take(block->REQUEST, own->request);
        if (wanted & ROSPLC_PLC_RESPONSE)
            Response::give(own->response, block->RESPONSE);
    }
    rosplc_plc_server_end(&s);
    after_call(block, now);
    show(block, s.block);
    block->TAGE = static_cast<int64_t>(s.age_ms) * 1000000;
    block->XCALLERGONE = s.caller_gone != 0;
    block->UDICALLERS = s.callers;
    block->UDICALLS = s.calls;
    block->UDIREFUSED = s.refused;
    if constexpr (action) {
        block->XGOAL = s.request != 0;
        block->XACTIVE = s.active != 0;
        block->XCANCELREQUESTED = s.cancel_requested != 0;
        block->XCANCELING = s.canceling != 0;
        block->XPREEMPT = s.preempt != 0;
    } else {
        block->XREQUEST = s.request != 0;
    }
}

} // namespace
} // namespace strucpp
