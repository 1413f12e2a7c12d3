// Between the variables of a program that STruC++ compiled and the records of rosplc; for rosplc_blocks.cpp alone.
//
// What a block holds (mapping, claims, copy of a record) is not in its instance, where STruC++ has no destructor and
// retained variables would bring an earlier run's back: it is found by the instance's address in a list, which gives
// everything back when the program is unloaded. All is of this file alone: a symbol that is shared between libraries
// would keep the program loaded.
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

// TIME() does not advance in all but the fastest task of OpenPLC 4.1.4.
uint32_t now_ms()
{
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return static_cast<uint32_t>(static_cast<uint64_t>(now.tv_sec) * 1000u + static_cast<uint64_t>(now.tv_nsec) / 1000000u);
}

// One attempt to open in a scan: the next may come when the block that made the last one is called again.
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
    // The first call of an instance allocates. Tasks may add at once; nothing is taken out.
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

template <class Own, class Block> bool first_call(Own *own, const Block *block)
{
    if (own->topic[0] || block->STOPIC.get().length() == 0)
        return false;
    std::memcpy(own->topic, block->STOPIC.get().c_str(), block->STOPIC.get().length() + 1);
    return true;
}

template <class Block> void show(Block *block, const rosplc_plc_channel &channel)
{
    block->XATTACHED = channel.attached != 0;
    block->XPEERALIVE = channel.peer_alive != 0;
    block->UDIERROR = channel.error;
    block->XERROR = channel.error != 0;
    block->UDIREENTRIES = channel.reentries;
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
    if (first_call(own, block)) {
        rosplc_plc_reader_init(&r, ROSPLC_PREFIX, own->topic, Layout::LAYOUT_LO, Layout::LAYOUT_HI, Layout::SIZE, own->record);
        r.channel.beat_ms = ROSPLC_BEAT_MS;
    }
    r.channel.may_open = &pace.may_open;
    r.stale_after_ms = static_cast<uint32_t>((block->TSTALEAFTER.get() + 999999) / 1000000);
    r.on_stale = block->UIONSTALE.get();
    r.in_order = block->XINORDER.get();
    r.max_per_scan = block->UIMAXPERSCAN.get();
    r.latched = block->XLATCHED.get();
    before_call(block, now);
    const bool got = (next ? rosplc_plc_next(&r, now) : rosplc_plc_read(&r, now)) != 0;
    after_call(block, now);
    if (got)
        Layout::take(block->MSG, own->record);
    show(block, r.channel);
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
    if (first_call(own, block)) {
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
    show(block, w.channel);
    block->XREADY = w.ready != 0;
    block->XPUBLISHED = w.published != 0;
    block->UDISEQUENCE = w.sequence;
    block->UDIPUBLISHED = w.count;
    block->UDIUNSENT = w.unsent;
    block->TTAKEOVER = static_cast<int64_t>(w.takeover_ms) * 1000000;
    block->UDITAKEN = w.taken;
    block->UDISINKS = w.sinks;
}

} // namespace
} // namespace strucpp
