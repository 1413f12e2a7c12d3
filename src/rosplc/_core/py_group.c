/* _native.Group: one tick over all channels of a bridge in one call.
 *
 * wait() looks at the heads of all readers on an absolute-time grid, without the GIL, and with `predict` when news is
 * expected, or while all is quiet when the PLC's tasks are expected to scan; take() converts everything new to wire
 * bytes, straight out of the slots; beat() beats all lines.
 *
 * The table of channels is guarded by `mutex`, which wait() holds without the GIL for the length of one
 * look. Nobody waits for the GIL while holding it.
 */
#include "py_channel.h"
#include "predict.h"
#include "sink.h"

#include <errno.h>
#include <pthread.h>
#include <sched.h>
#include <time.h>

/* A head that its slot does not confirm is no news until it changes, or for this many looks. */
#define REJECTED_LOOKS 16u
/* Messages of a channel after which other threads, which beat, may have the GIL. */
#define OTHERS_TURN 64u
/* Heads that are on their way from memory while one is compared. */
#define AHEAD 16
#define LONGEST_TICK 60000000000

/* What a look needs of an entry, in a table of its own: the line is in another page for each, and these loads must not
 * wait for each other. */
typedef struct {
    const rosplc_writer_line *line; /* of the entry's reader, whose mapping is pinned; else NO_LINE */
    uint32_t quiet;                 /* a value of head under which there is nothing to take */
} Watch;

static const rosplc_writer_line NO_LINE;

typedef struct {
    ReaderObject *reader; /* NULL: a free entry */
    PyObject *plan_object;
    const rp_plan *plan;
    PyObject *capsule; /* NULL, or what holds the sink that messages go into */
    rosplc_sink *sink;
    int mode;
    uint32_t limit;
    uint32_t rejected, looks; /* the head that take() could not take, 0 none; looks to ignore it for */
    int broken;               /* reported as unusable: quiet until it is removed */
} Entry;

typedef struct {
    PyObject_HEAD
    pthread_mutex_t mutex;
    int mutex_ready;
    Entry *entries;
    Watch *watches; /* one for each entry */
    int predicts, scans;    /* scans: it is told beats instead of heads */
    rp_predictor predictor; /* its streams: one for each entry */
    Py_ssize_t count, room;
    uint8_t *wire; /* scratch for one message */
    size_t wire_size;
    int64_t next_tick; /* CLOCK_MONOTONIC, ns; 0 before the first wait */
    int woken;
    ch_gate gate; /* closed while take() converts without the GIL */
} GroupObject;

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static PyObject *group_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    GroupObject *self;
    static char *names[] = {"predict", NULL};
    int predicts = 0;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "|p:Group", names, &predicts))
        return NULL;
    self = py_allocate(type);
    if (!self)
        return NULL;
    if (pthread_mutex_init(&self->mutex, NULL)) {
        Py_DECREF((PyObject *)self);
        return PyErr_NoMemory();
    }
    self->mutex_ready = 1;
    self->predicts = predicts;
    return (PyObject *)self;
}

/* Takes an entry out of the table; what it held is let go outside the lock. */
static void group_drop(GroupObject *self, Py_ssize_t index)
{
    Entry entry;
    pthread_mutex_lock(&self->mutex);
    entry = self->entries[index];
    self->entries[index] = (Entry){0};
    self->watches[index] = (Watch){&NO_LINE, 0};
    rp_leave(&self->predictor, &self->predictor.streams[index]);
    pthread_mutex_unlock(&self->mutex);
    if (entry.reader)
        ch_region_unpin(entry.reader->owner);
    Py_XDECREF((PyObject *)entry.reader);
    Py_XDECREF(entry.plan_object);
    Py_XDECREF(entry.capsule);
}

static void group_dealloc(GroupObject *self)
{
    for (Py_ssize_t i = 0; i < self->count; i++)
        group_drop(self, i);
    PyMem_Free(self->entries);
    PyMem_Free(self->watches);
    PyMem_Free(self->predictor.streams);
    PyMem_Free(self->wire);
    if (self->mutex_ready)
        pthread_mutex_destroy(&self->mutex);
    py_release(self);
}

/* Puts an entry into the table, whose references pass to it; its index, or NULL. */
static PyObject *group_add(GroupObject *self, Entry entry)
{
    Py_ssize_t index = 0;
    while (index < self->count && self->entries[index].reader)
        index++;
    if (index == self->room) {
        Py_ssize_t room = self->room ? 2 * self->room : 16;
        Entry *grown = PyMem_Calloc((size_t)room, sizeof *grown), *old = self->entries;
        Watch *more = PyMem_Calloc((size_t)room, sizeof *more), *before = self->watches;
        rp_stream *streams = PyMem_Calloc((size_t)room, sizeof *streams), *known = self->predictor.streams;
        if (!grown || !more || !streams) {
            PyMem_Free(grown);
            PyMem_Free(more);
            PyMem_Free(streams);
            return PyErr_NoMemory();
        }
        pthread_mutex_lock(&self->mutex);
        if (old) {
            memcpy(grown, old, (size_t)self->count * sizeof *grown);
            memcpy(more, before, (size_t)self->count * sizeof *more);
            memcpy(streams, known, (size_t)self->count * sizeof *streams);
        }
        self->entries = grown;
        self->watches = more;
        self->predictor.streams = streams;
        self->room = room;
        pthread_mutex_unlock(&self->mutex);
        PyMem_Free(old);
        PyMem_Free(before);
        PyMem_Free(known);
    }
    Py_INCREF((PyObject *)entry.reader);
    Py_XINCREF(entry.plan_object);
    ch_region_pin(entry.reader->owner);
    pthread_mutex_lock(&self->mutex);
    self->entries[index] = entry;
    self->watches[index].line = &entry.reader->owner->region.header->writer;
    self->watches[index].quiet = 0;
    if (index == self->count)
        self->predictor.count = (uint32_t)++self->count;
    pthread_mutex_unlock(&self->mutex);
    return PyLong_FromSsize_t(index);
}

/* take() may run without the GIL for a moment; the table must not change under it. */
static int group_settled(GroupObject *self)
{
    while (self->gate.busy) {
        if (ch_gate_wait(&self->gate))
            return -1;
    }
    return 0;
}

static PyObject *group_add_reader(GroupObject *self, PyObject *args)
{
    ReaderObject *reader;
    PyObject *plan_object;
    const rp_plan *plan;
    static const int modes[] = {ROSPLC_TAKE_NEWEST, ROSPLC_TAKE_NEXT, ROSPLC_TAKE_PEEK};
    int mode = 0;
    unsigned int limit = 64;
    size_t bound;
    if (!PyArg_ParseTuple(args, "O!O|iI:add_reader", ch_reader_type, &reader, &plan_object, &mode, &limit)
        || !(plan = rp_plan_from_object(plan_object)) || group_settled(self) || ch_region_usable(reader->owner))
        return NULL;
    if (mode < 0 || mode > 2 || limit == 0)
        return PyErr_Format(PyExc_ValueError,
                            "mode must be 0 (newest), 1 (in order) or 2 (only report), and limit at least 1");
    if (plan->record_size != reader->owner->region.geometry.record_size)
        return PyErr_Format(PyExc_ValueError, "the plan's records have %lu bytes, those of %U have %lu",
                            (unsigned long)plan->record_size, reader->owner->path,
                            (unsigned long)reader->owner->region.geometry.record_size);
    bound = rp_encoded_bound(plan) + ROSPLC_SINK_ROOM;
    if (bound > self->wire_size) {
        uint8_t *wire = PyMem_Realloc(self->wire, bound);
        if (!wire)
            return PyErr_NoMemory();
        self->wire = wire;
        self->wire_size = bound;
    }
    return group_add(self, (Entry){.reader = reader,
                                   .plan_object = plan_object,
                                   .plan = plan,
                                   .mode = modes[mode],
                                   .limit = mode == 1 ? limit : 1});
}

static int group_has(GroupObject *self, Py_ssize_t index)
{
    if (index >= 0 && index < self->count && self->entries[index].reader)
        return 1;
    PyErr_Format(PyExc_IndexError, "the group has no channel %zd", index);
    return 0;
}

static PyObject *group_remove(GroupObject *self, PyObject *args)
{
    Py_ssize_t index;
    if (!PyArg_ParseTuple(args, "n:remove", &index) || group_settled(self) || !group_has(self, index))
        return NULL;
    group_drop(self, index);
    Py_RETURN_NONE;
}

static PyObject *group_divert(GroupObject *self, PyObject *args)
{
    Py_ssize_t index;
    PyObject *capsule, *before;
    rosplc_sink *sink;
    if (!PyArg_ParseTuple(args, "nO:divert", &index, &capsule) || !(sink = PyCapsule_GetPointer(capsule, ROSPLC_SINK))
        || group_settled(self) || !group_has(self, index))
        return NULL;
    before = self->entries[index].capsule;
    Py_INCREF(capsule);
    self->entries[index].capsule = capsule;
    self->entries[index].sink = sink;
    Py_XDECREF(before);
    Py_RETURN_NONE;
}

/* Whether a channel whose head has changed has news. */
static int entry_news(Entry *entry, Watch *watch)
{
    uint32_t head = rosplc_load(&watch->line->head);
    if (entry->broken || entry->reader->owner->closed) {
        watch->quiet = head;
        return 0;
    }
    if (!rosplc_is_new(&entry->reader->reader, head)) {
        /* Holds while only this group takes: with mode 2 the reader's owner does. */
        watch->quiet = entry->mode == ROSPLC_TAKE_PEEK ? 0 : head;
        return 0;
    }
    if (head == entry->rejected && entry->looks) {
        entry->looks--;
        return 0;
    }
    return 1;
}

/* One look at all heads, which was to be at `planned`; sets when the next one is due, `longest` after it at most. */
static Py_ssize_t group_look(GroupObject *self, int64_t planned, int64_t tick, int64_t longest)
{
    Py_ssize_t news = 0;
    int predicts = self->predicts && tick, scans = predicts && longest > tick;
    self->next_tick = planned + tick;
    pthread_mutex_lock(&self->mutex);
    if (scans != self->scans)
        rp_forget(&self->predictor);
    self->scans = scans;
    if (predicts)
        rp_look(&self->predictor, planned, now_ns(), tick);
    for (Py_ssize_t i = 0; i < self->count; i++) {
        Watch *watch = &self->watches[i];
        if (i + AHEAD < self->count)
            __builtin_prefetch(watch[AHEAD].line);
        if (scans)
            rp_news(&self->predictor, (uint32_t)i, rosplc_load(&watch->line->writer_beat));
        if (rosplc_load(&watch->line->head) == watch->quiet || !entry_news(&self->entries[i], watch))
            continue;
        news++;
        if (predicts && !scans)
            rp_news(&self->predictor, (uint32_t)i, rosplc_load(&watch->line->head));
    }
    if (predicts)
        self->next_tick = rp_next(&self->predictor, scans ? longest : 0);
    pthread_mutex_unlock(&self->mutex);
    return news;
}

static PyObject *group_wait(GroupObject *self, PyObject *args)
{
    long long tick, timeout = -1, longest = 0;
    int64_t now, deadline;
    unsigned int looks = 0;
    Py_ssize_t news = 0;
    if (!PyArg_ParseTuple(args, "L|LL:wait", &tick, &timeout, &longest))
        return NULL;
    if (tick < 0 || tick > LONGEST_TICK || longest > LONGEST_TICK)
        return PyErr_Format(PyExc_ValueError, "a tick must be between 0 and 60 000 000 000 ns");
    if (longest < tick)
        longest = tick;
    now = now_ns();
    deadline = timeout < 0 || timeout > INT64_MAX - now ? INT64_MAX : now + timeout;
    for (;;) {
        int interrupted = 0, done = 0;
        Py_BEGIN_ALLOW_THREADS;
        while (!interrupted && !done) {
            now = now_ns();
            if (tick) {
                /* The grid stays where it is while we keep up, and starts again where we fell behind. */
                int64_t target = self->next_tick;
                struct timespec until;
                if (target <= now - tick || target > now + longest + tick / RP_SLACK)
                    target = now + tick;
                if (target > deadline)
                    target = deadline;
                until = (struct timespec){target / 1000000000, target % 1000000000};
                interrupted = clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR;
                if (interrupted)
                    break;
                now = target;
            } else {
                sched_yield();
                interrupted = ++looks % 4096 == 0; /* no call that a signal could interrupt: look for one */
            }
            news = group_look(self, now, tick, longest);
            done = news || __atomic_exchange_n(&self->woken, 0, __ATOMIC_ACQ_REL) || now >= deadline;
        }
        Py_END_ALLOW_THREADS;
        if (PyErr_CheckSignals())
            return NULL;
        if (done)
            return PyLong_FromSsize_t(news);
    }
}

static PyObject *group_wake(GroupObject *self, PyObject *unused)
{
    (void)unused;
    __atomic_store_n(&self->woken, 1, __ATOMIC_RELEASE);
    Py_RETURN_NONE;
}

/* Appends (index, item), whose reference passes. */
static int append_pair(PyObject *list, Py_ssize_t index, PyObject *item)
{
    PyObject *pair = item ? Py_BuildValue("(nN)", index, item) : NULL;
    int failed = !pair || PyList_Append(list, pair);
    Py_XDECREF(pair);
    return failed ? -1 : 0;
}

/* The exception just raised, as an object. */
static PyObject *caught(void)
{
    PyObject *type, *value, *trace;
    PyErr_Fetch(&type, &value, &trace);
    PyErr_NormalizeException(&type, &value, &trace);
    Py_XDECREF(type);
    Py_XDECREF(trace);
    return value;
}

/* Puts the message that was just encoded into the entry's sink; 0 if it took it. */
static int put_one(GroupObject *self, Entry *entry, const rosplc_take *take, size_t used)
{
    int64_t stamp = (int64_t)((uint64_t)take->stamp_hi << 32 | take->stamp_lo);
    struct timespec now;
    if (!entry->sink)
        return -1;
    if (take->stamp_clock != ROSPLC_STAMP_SYSTEM || stamp <= 0 || stamp == INT64_MAX) {
        clock_gettime(CLOCK_REALTIME, &now);
        stamp = (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
    }
    /* Python counts what was shortened, and finds that another bridge has taken the topic over. */
    if (take->flags & ROSPLC_FLAG_TRUNCATED || !rosplc_reader_owned(&entry->reader->reader))
        stamp = 0;
    memset(self->wire + used, 0, ROSPLC_SINK_ROOM);
    return rosplc_sink_put(entry->sink, self->wire, used, stamp);
}

/* One message, if there is one: 1 taken, 0 nothing, -1 an exception. */
static int take_one(GroupObject *self, Py_ssize_t index, PyObject *messages, PyObject *faults)
{
    Entry *entry = &self->entries[index];
    rosplc_reader *reader = &entry->reader->reader;
    rosplc_take take = rosplc_take_start(entry->mode);
    rp_fault fault = {0, 0, 0, 0};
    size_t used = 0;
    int accepted = entry->mode == ROSPLC_TAKE_PEEK, failed = 0, passed = 0;
    PyThreadState *unlocked = NULL;
    PyObject *message;
    if (!accepted && entry->plan->record_size >= CH_LONG_COPY) {
        self->gate.busy = 1;
        unlocked = ch_gate_enter(&entry->reader->gate, entry->reader->owner);
    }
    if (accepted) /* only reported: the owner of the reader takes it */
        take.sequence = rosplc_load(&reader->region->header->writer.head);
    while (!accepted && rosplc_take_begin(reader, &take)) {
        int result = rp_encode(entry->plan, rosplc_record(take.slot), self->wire, self->wire_size - ROSPLC_SINK_ROOM,
                               &used, &fault);
        if (rosplc_take_check(reader, &take)) {
            rosplc_take_accept(reader, &take); /* stores `taken`: before anybody sends (M15) */
            accepted = 1;
            failed = result;
            passed = !failed && !put_one(self, entry, &take, used);
        }
    }
    if (unlocked) {
        /* The wire bytes and the entry are still ours: the group's gate opens when they are used up. */
        ch_gate_leave(&entry->reader->gate, entry->reader->owner, unlocked);
        self->gate.busy = 0;
    }
    if (!accepted) {
        entry->rejected = take.head;
        entry->looks = REJECTED_LOOKS;
        return 0;
    }
    entry->rejected = 0;
    if (failed) {
        rp_raise_fault(&fault);
        return append_pair(faults, index, caught()) ? -1 : 1;
    }
    if (passed)
        return 1;
    /* First: making a tuple may run a finalizer, which may add a channel and so take the buffer away. */
    message = PyBytes_FromStringAndSize((const char *)self->wire, (Py_ssize_t)used);
    if (message)
        message = Py_BuildValue("(nNkkKk)", index, message, (unsigned long)take.sequence, (unsigned long)take.flags,
                                (unsigned long long)take.stamp_hi << 32 | take.stamp_lo, (unsigned long)take.stamp_clock);
    failed = !message || PyList_Append(messages, message);
    Py_XDECREF(message);
    return failed ? -1 : 1;
}

static int take_channel(GroupObject *self, Py_ssize_t index, PyObject *messages, PyObject *faults)
{
    Entry *entry = &self->entries[index];
    Watch *watch = &self->watches[index];
    ReaderObject *reader;
    uint32_t limit;
    int error, taken = 1;
    if (rosplc_load(&watch->line->head) == watch->quiet) /* as most are, and free entries */
        return 0;
    if (entry->broken || entry->reader->owner->closed || !rosplc_reader_news(&entry->reader->reader))
        return 0;
    reader = entry->reader;
    Py_INCREF((PyObject *)reader);
    error = rosplc_region_check(&reader->owner->region);
    if (error) {
        entry->broken = 1;
        ch_raise_channel(error, reader->owner->path);
        taken = append_pair(faults, index, caught());
        Py_DECREF((PyObject *)reader);
        return taken;
    }
    limit = entry->limit;
    watch->quiet = 0; /* what was no news may be some once another message is the last one taken */
    for (uint32_t i = 0; i < limit && taken == 1; i++) {
        if (i && i % OTHERS_TURN == 0) { /* a long queue goes into a sink without any Python in between */
            Py_BEGIN_ALLOW_THREADS;
            Py_END_ALLOW_THREADS;
        }
        if (reader->gate.busy && ch_gate_wait(&reader->gate)) {
            taken = -1;
            break;
        }
        /* Making Python objects may run a finalizer, which may remove this very channel. */
        if (self->entries[index].reader != reader || reader->owner->closed)
            break;
        taken = i && !rosplc_reader_news(&reader->reader) ? 0 : take_one(self, index, messages, faults);
    }
    Py_DECREF((PyObject *)reader);
    return taken < 0 ? -1 : 0;
}

static PyObject *group_take(GroupObject *self, PyObject *unused)
{
    PyObject *messages, *faults;
    (void)unused;
    if (group_settled(self))
        return NULL;
    messages = PyList_New(0);
    faults = PyList_New(0);
    for (Py_ssize_t i = 0; messages && faults && i < self->count; i++) {
        if (take_channel(self, i, messages, faults)) {
            Py_DECREF(messages);
            Py_DECREF(faults);
            return NULL;
        }
    }
    if (!messages || !faults) {
        Py_XDECREF(messages);
        Py_XDECREF(faults);
        return NULL;
    }
    return Py_BuildValue("(NN)", messages, faults);
}

/* Beats for a Reader or a Writer that still can, or for a tuple of them. -1 with TypeError for another object. */
static int beat_one(PyObject *user)
{
    int failed = 0;
    if (Py_TYPE(user) == ch_writer_type) {
        WriterObject *writer = (WriterObject *)user;
        if (!writer->owner->closed && !writer->released)
            rosplc_writer_beat(&writer->writer);
    } else if (Py_TYPE(user) == ch_reader_type) {
        if (!((ReaderObject *)user)->owner->closed)
            rosplc_reader_beat(&((ReaderObject *)user)->reader);
    } else if (PyTuple_Check(user)) {
        if (Py_EnterRecursiveCall(" in beat()"))
            return -1;
        for (Py_ssize_t i = 0; !failed && i < PyTuple_Size(user); i++)
            failed = beat_one(PyTuple_GetItem(user, i));
        Py_LeaveRecursiveCall();
    } else if (user != Py_None) {
        PyErr_SetString(PyExc_TypeError, "beat() takes readers and writers");
        return -1;
    }
    return failed;
}

static PyObject *beat_all(PyObject *module, PyObject *users)
{
    (void)module;
    if (!PyList_Check(users))
        return PyErr_Format(PyExc_TypeError, "beat() takes a list");
    for (Py_ssize_t i = 0; i < PyList_Size(users); i++) {
        PyObject *user = PyList_GetItem(users, i), *later;
        if (i + AHEAD < PyList_Size(users)) {
            later = PyList_GetItem(users, i + AHEAD);
            if (Py_TYPE(later) == ch_writer_type && !((WriterObject *)later)->owner->closed)
                __builtin_prefetch(&((WriterObject *)later)->owner->region.header->writer, 1);
            else if (Py_TYPE(later) == ch_reader_type && !((ReaderObject *)later)->owner->closed)
                __builtin_prefetch(((ReaderObject *)later)->owner->region.header->reader, 1);
        }
        if (beat_one(user))
            return NULL;
    }
    Py_RETURN_NONE;
}

static PyMethodDef functions[] = {
    {"beat", beat_all, METH_O, "beat(users): let all readers and writers of a list beat; None and closed ones are left out."},
    {NULL, NULL, 0, NULL},
};

static PyMethodDef methods[] = {
    {"add_reader", (PyCFunction)group_add_reader, METH_VARARGS,
     "add_reader(reader, plan, mode=0, limit=64) -> index; mode 0 newest, 1 in order, 2 only report;"
     " at most limit per take()."},
    {"remove", (PyCFunction)group_remove, METH_VARARGS, "remove(index): let go of a channel."},
    {"divert", (PyCFunction)group_divert, METH_VARARGS,
     "divert(index, capsule): take() puts messages into this sink, and returns those that it does not take."},
    {"wait", (PyCFunction)group_wait, METH_VARARGS,
     "wait(tick_ns, timeout_ns=-1, longest_ns=0) -> number of channels with news; 0 after wake() or the timeout.\n\n"
     "With predict=True, a look may wait up to longest_ns for the scans of writers that beat steadily."},
    {"wake", (PyCFunction)group_wake, METH_NOARGS, "Make wait() return at its next tick; from any thread."},
    {"take", (PyCFunction)group_take, METH_NOARGS,
     "take() -> ([(index, wire, sequence, flags, stamp_ns, stamp_clock)], [(index, exception)])."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_doc, "Group(predict=False): the channels of one bridge, served in one call per tick."},
    {Py_tp_new, (void *)group_new},
    {Py_tp_dealloc, (void *)group_dealloc},
    {Py_tp_methods, methods},
    {0, NULL},
};

static PyType_Spec spec = {"rosplc._core._native.Group", sizeof(GroupObject), 0, Py_TPFLAGS_DEFAULT, slots};

int rosplc_add_group(PyObject *module)
{
    return py_add_type(module, "Group", &spec, NULL) || PyModule_AddFunctions(module, functions) ? -1 : 0;
}
