/* rosplc.ros.rospy._tcp: what follows the headers on connections of ROS 1, messages behind their length, without
 * Python work for each of them (_core/sink.h).
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <errno.h>
#include <stddef.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <unistd.h>

#include "py_sink.h"

enum { EVENTS = 64, READ = 65536, TURN = 64 };
static const uint32_t GONE = EPOLLRDHUP | EPOLLHUP | EPOLLERR;

typedef struct Frame { /* a message that waits, for one subscriber or several */
    size_t refs, size;
    uint8_t bytes[];
} Frame;

typedef struct Waiting {
    struct Waiting *next;
    Frame *frame;
} Waiting;

typedef struct Out { /* the connection to a subscriber */
    struct Out *next;
    int fd, failed;
    uint32_t number; /* as its entry's */
    size_t depth, count; /* most messages that wait, and how many do */
    Waiting *first, *last;
    Frame *begun; /* partly sent: it cannot give way */
    size_t sent;
} Out;

typedef struct Sender Sender;

typedef struct {
    PyObject *owner; /* NULL: a free entry */
    Sender *sender;  /* NULL: messages are received */
    PyObject *capsule;
    rosplc_sink *sink;
    uint8_t *bytes;           /* received, and not passed on */
    size_t used, room, whole; /* of `used`, those of whole messages */
    int ended, error;
    uint32_t number; /* tells connections apart that have had the same descriptor */
    uint32_t announced; /* a length that cannot be */
} Entry;

/* Nobody waits for the GIL while holding a mutex, so one may wait for a mutex while holding the GIL. */
typedef struct {
    PyObject_HEAD
    pthread_mutex_t mutex; /* guards the table */
    int ready, epoll, waker;
    uint32_t last; /* number given to an entry */
    uint32_t most; /* bytes of a message: a length beyond this is none but a stream out of step */
    Entry *entries; /* by file descriptor */
    size_t room;
    int news[EVENTS]; /* descriptors with something for Python */
    int news_count, waits; /* waits: whether a thread is in wait(); belongs to the GIL, as news does outside of serve() */
    uint8_t scratch[READ];
} LoopObject;

struct Sender {
    PyObject_HEAD
    pthread_mutex_t mutex; /* taken after a loop's or a sink's */
    int ready, closed;
    LoopObject *loop;
    Out *outs;
    Frame *latched;
};

static PyTypeObject *loop_type, *sender_type;

static int watch(LoopObject *loop, int operation, int fd, uint32_t number, uint32_t events)
{
    struct epoll_event event = {.events = events, .data.u64 = (uint64_t)number << 32 | (uint32_t)fd};
    return epoll_ctl(loop->epoll, operation, fd, &event);
}

/* ---------------------------------------------------------------- to subscribers; the sender's mutex is held */

static Frame *frame_of(const uint8_t *payload, size_t size)
{
    Frame *frame = malloc(sizeof *frame + 4 + size);
    if (frame) {
        uint32_t length = (uint32_t)size;
        *frame = (Frame){1, 4 + size};
        for (int i = 0; i < 4; i++)
            frame->bytes[i] = (uint8_t)(length >> 8 * i);
        memcpy(frame->bytes + 4, payload, size);
    }
    return frame;
}

static void let_go(Frame *frame)
{
    if (frame && !--frame->refs)
        free(frame);
}

static Frame *first_of(Out *out)
{
    Waiting *first = out->first;
    Frame *frame = first->frame;
    out->first = first->next;
    out->count--;
    free(first);
    return frame;
}

static void empty(Out *out)
{
    while (out->first)
        let_go(first_of(out));
    let_go(out->begun);
    out->begun = NULL;
}

/* Bytes that went out, 0 where the subscriber has gone, too. */
static size_t send_some(Out *out, const struct iovec *parts, int count)
{
    struct msghdr message = {.msg_iov = (struct iovec *)parts, .msg_iovlen = (size_t)count};
    ssize_t sent = sendmsg(out->fd, &message, MSG_DONTWAIT | MSG_NOSIGNAL);
    if (sent < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR) {
        out->failed = 1; /* which the loop notices, too */
        empty(out);
    }
    return sent < 0 ? 0 : (size_t)sent;
}

/* Sends or queues a message; `*frame` is made when it is needed. Returns how many messages had to give way. */
static int out_put(Sender *self, Out *out, const uint8_t *payload, size_t size, Frame **frame)
{
    const uint8_t length[4] = {(uint8_t)size, (uint8_t)(size >> 8), (uint8_t)(size >> 16), (uint8_t)(size >> 24)};
    const struct iovec parts[2] = {{(void *)(uintptr_t)length, 4}, {(void *)(uintptr_t)payload, size}};
    int idle = !out->first && !out->begun, lost = 0;
    size_t sent = 0;
    Waiting *one;
    if (idle && ((sent = send_some(out, parts, 2)) == 4 + size || out->failed))
        return 0;
    if (!*frame)
        *frame = frame_of(payload, size);
    one = *frame && !sent ? malloc(sizeof *one) : NULL;
    if (!*frame || (!sent && !one)) {
        if (sent) { /* the stream is out of step */
            out->failed = 1;
            shutdown(out->fd, SHUT_RDWR);
        }
        return 1;
    }
    (*frame)->refs++;
    if (sent) {
        out->begun = *frame;
        out->sent = sent;
    } else {
        if (out->count >= out->depth && out->first) {
            let_go(first_of(out));
            lost = 1;
        }
        *one = (Waiting){NULL, *frame};
        if (out->first)
            out->last->next = one;
        else
            out->first = one;
        out->last = one;
        out->count++;
    }
    if (idle)
        watch(self->loop, EPOLL_CTL_MOD, out->fd, out->number, EPOLLRDHUP | EPOLLOUT);
    return lost;
}

static int send_all(Sender *self, const uint8_t *payload, size_t size, int latch)
{
    Frame *frame = latch ? frame_of(payload, size) : NULL;
    int lost = 0;
    if (frame) {
        let_go(self->latched);
        self->latched = frame;
        frame->refs++;
    }
    for (Out *out = self->outs; out; out = out->next)
        lost += out->failed ? 0 : out_put(self, out, payload, size, &frame);
    let_go(frame);
    return lost;
}

static void drain(Sender *self, Out *out)
{
    for (int i = 0; i < TURN && !out->failed && (out->begun || out->first); i++) {
        if (!out->begun) {
            out->begun = first_of(out);
            out->sent = 0;
        }
        out->sent += send_some(out, &(struct iovec){out->begun->bytes + out->sent, out->begun->size - out->sent}, 1);
        if (out->failed || out->sent < out->begun->size)
            break;
        let_go(out->begun);
        out->begun = NULL;
    }
    if (!out->begun && !out->first)
        watch(self->loop, EPOLL_CTL_MOD, out->fd, out->number, EPOLLRDHUP);
}

/* ---------------------------------------------------------------- the loop */

static PyObject *loop_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"most", NULL};
    LoopObject *self;
    unsigned int most;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "I:Loop", names, &most)
        || !(self = py_allocate(type)))
        return NULL;
    self->most = most;
    self->waker = -1;
    self->epoll = epoll_create1(EPOLL_CLOEXEC);
    if (self->epoll < 0 || (self->waker = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) < 0) {
        PyErr_SetFromErrno(PyExc_OSError);
        Py_DECREF((PyObject *)self);
        return NULL;
    }
    if (pthread_mutex_init(&self->mutex, NULL)) {
        Py_DECREF((PyObject *)self);
        return PyErr_NoMemory();
    }
    self->ready = 1;
    if (watch(self, EPOLL_CTL_ADD, self->waker, 0, EPOLLIN)) {
        PyErr_SetFromErrno(PyExc_OSError);
        Py_CLEAR(self);
    }
    return (PyObject *)self;
}

static void sender_forget(Sender *self, int fd)
{
    pthread_mutex_lock(&self->mutex);
    for (Out **place = &self->outs; *place; place = &(*place)->next) {
        Out *out = *place;
        if (out->fd == fd) {
            *place = out->next;
            empty(out);
            free(out);
            break;
        }
    }
    pthread_mutex_unlock(&self->mutex);
}

/* Gives up what a former entry had. */
static void discard(Entry *entry, int fd)
{
    if (entry->sender)
        sender_forget(entry->sender, fd);
    free(entry->bytes);
    Py_XDECREF(entry->owner);
    Py_XDECREF((PyObject *)entry->sender);
    Py_XDECREF(entry->capsule);
}

static void loop_shut(LoopObject *self)
{
    if (self->epoll >= 0)
        close(self->epoll);
    if (self->waker >= 0)
        close(self->waker);
    self->epoll = self->waker = -1;
}

static void loop_dealloc(LoopObject *self)
{
    for (size_t fd = 0; fd < self->room; fd++)
        discard(&self->entries[fd], (int)fd);
    free(self->entries);
    if (self->ready)
        pthread_mutex_destroy(&self->mutex);
    loop_shut(self);
    py_release(self);
}

/* Enters a connection and returns its number; 0 with an exception. */
static uint32_t loop_enter(LoopObject *self, int fd, Entry entry, uint32_t events)
{
    if (fd < 0) {
        PyErr_SetString(PyExc_ValueError, "the connection is closed");
        return 0;
    }
    pthread_mutex_lock(&self->mutex);
    entry.number = ++self->last ? self->last : ++self->last; /* 0 is the waker's */
    if (((size_t)fd < self->room && self->entries[fd].owner)
        || watch(self, EPOLL_CTL_ADD, fd, entry.number, events)) {
        pthread_mutex_unlock(&self->mutex);
        PyErr_Format(PyExc_OSError, "the connection %d cannot be watched", fd);
        return 0;
    }
    if ((size_t)fd >= self->room) { /* it is open: no number that somebody made up */
        size_t room = 2 * (size_t)fd + 16;
        Entry *grown = realloc(self->entries, room * sizeof *grown);
        if (!grown) {
            watch(self, EPOLL_CTL_DEL, fd, 0, 0);
            pthread_mutex_unlock(&self->mutex);
            PyErr_NoMemory();
            return 0;
        }
        memset(grown + self->room, 0, (room - self->room) * sizeof *grown);
        self->entries = grown;
        self->room = room;
    }
    Py_INCREF(entry.owner);
    Py_XINCREF((PyObject *)entry.sender);
    Py_XINCREF(entry.capsule);
    self->entries[fd] = entry;
    pthread_mutex_unlock(&self->mutex);
    return entry.number;
}

/* What a capsule (None: nothing) has; -1 with an exception. */
static int sink_of(PyObject **capsule, rosplc_sink **sink)
{
    if (*capsule == Py_None)
        *capsule = NULL;
    *sink = *capsule ? PyCapsule_GetPointer(*capsule, ROSPLC_SINK) : NULL;
    return *capsule && !*sink ? -1 : 0;
}

static PyObject *loop_receive(LoopObject *self, PyObject *args)
{
    int fd;
    Entry entry = {0};
    if (!PyArg_ParseTuple(args, "iOO:receive", &fd, &entry.owner, &entry.capsule)
        || sink_of(&entry.capsule, &entry.sink) || !loop_enter(self, fd, entry, EPOLLIN | EPOLLRDHUP))
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *loop_divert(LoopObject *self, PyObject *args)
{
    int fd;
    PyObject *capsule, *before;
    rosplc_sink *sink;
    if (!PyArg_ParseTuple(args, "iO:divert", &fd, &capsule) || sink_of(&capsule, &sink))
        return NULL;
    Py_XINCREF(capsule);
    pthread_mutex_lock(&self->mutex);
    before = capsule; /* where there is no such connection any more */
    if (fd >= 0 && (size_t)fd < self->room && self->entries[fd].owner) {
        before = self->entries[fd].capsule;
        self->entries[fd].capsule = capsule;
        self->entries[fd].sink = sink;
    }
    pthread_mutex_unlock(&self->mutex);
    Py_XDECREF(before);
    Py_RETURN_NONE;
}

static PyObject *loop_remove(LoopObject *self, PyObject *args)
{
    int fd;
    Entry before = {0};
    if (!PyArg_ParseTuple(args, "i:remove", &fd))
        return NULL;
    pthread_mutex_lock(&self->mutex);
    if (fd >= 0 && (size_t)fd < self->room && self->entries[fd].owner) {
        before = self->entries[fd];
        self->entries[fd] = (Entry){0};
        if (!before.ended)
            watch(self, EPOLL_CTL_DEL, fd, 0, 0);
    }
    pthread_mutex_unlock(&self->mutex);
    discard(&before, fd);
    Py_RETURN_NONE;
}

static void ends(LoopObject *self, Entry *entry, int fd, int error)
{
    entry->ended = 1;
    entry->error = error;
    watch(self, EPOLL_CTL_DEL, fd, 0, 0);
}

/* Keeps the bytes at `from`, of which there are `size`; they may be within what is kept already. */
static int keep(Entry *entry, const uint8_t *from, size_t size)
{
    if (size > entry->room) {
        uint8_t *grown = realloc(entry->bytes, size);
        if (!grown)
            return -1;
        entry->bytes = grown;
        entry->room = size;
    }
    if (size)
        memmove(entry->bytes, from, size);
    entry->used = size;
    if (!size) {
        free(entry->bytes);
        entry->bytes = NULL;
        entry->room = 0;
    }
    return 0;
}

/* Reads once from a publisher, and passes on what came; for Python remains what no sink takes, and an end. */
static void receive(LoopObject *self, Entry *entry, int fd)
{
    uint8_t *bytes = self->scratch;
    size_t room = READ, end, passed = 0, at = 0;
    int closed = !entry->sink;
    struct timespec now;
    ssize_t got;
    if (entry->used) { /* grows with what came, never with what is announced */
        room = entry->used + (entry->used > READ ? entry->used : READ);
        if (room > entry->room) {
            bytes = realloc(entry->bytes, room);
            if (!bytes) {
                ends(self, entry, fd, ENOMEM);
                return;
            }
            entry->bytes = bytes;
            entry->room = room;
        }
        bytes = entry->bytes;
        room = entry->room;
    }
    got = recv(fd, bytes + entry->used, room - entry->used, MSG_DONTWAIT);
    if (got < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR))
        return;
    if (got <= 0) {
        ends(self, entry, fd, got ? errno : 0);
        return;
    }
    clock_gettime(CLOCK_REALTIME, &now);
    end = entry->used + (size_t)got;
    while (end - at >= 4) {
        const uint8_t *one = bytes + at;
        uint32_t length = one[0] | (uint32_t)one[1] << 8 | (uint32_t)one[2] << 16 | (uint32_t)one[3] << 24;
        if (length > self->most) {
            entry->announced = length;
            ends(self, entry, fd, EPROTO);
            break;
        }
        if (end - at - 4 < length)
            break;
        at += 4 + length;
        closed = closed || rosplc_sink_put(entry->sink, one + 4, length,
                                           (int64_t)now.tv_sec * 1000000000 + now.tv_nsec);
        if (!closed) /* or this one and, to keep their order, those behind it remain */
            passed = at;
    }
    entry->whole = at - passed;
    if (keep(entry, bytes + passed, end - passed))
        ends(self, entry, fd, ENOMEM);
}

static void serve(LoopObject *self, const struct epoll_event *event)
{
    int fd = (int)(uint32_t)event->data.u64;
    Entry *entry;
    pthread_mutex_lock(&self->mutex);
    entry = (size_t)fd < self->room ? &self->entries[fd] : NULL;
    if (entry && entry->owner && !entry->ended && entry->number == event->data.u64 >> 32) {
        if (!entry->sender) {
            receive(self, entry, fd);
        } else if (event->events & GONE) { /* nothing is read from a subscriber */
            ends(self, entry, fd, 0);
        } else {
            pthread_mutex_lock(&entry->sender->mutex);
            for (Out *out = entry->sender->outs; out; out = out->next) {
                if (out->fd == fd)
                    drain(entry->sender, out);
            }
            pthread_mutex_unlock(&entry->sender->mutex);
        }
        if (entry->whole || entry->ended)
            self->news[self->news_count++] = fd;
    }
    pthread_mutex_unlock(&self->mutex);
}

/* What is new at a connection, as a tuple; None if it was removed meanwhile. */
static PyObject *news_of(LoopObject *self, int fd)
{
    PyObject *owner = NULL, *messages = NULL, *found = NULL;
    uint8_t *bytes = NULL;
    size_t whole = 0;
    int ended = 0, error = 0;
    uint32_t announced = 0;
    pthread_mutex_lock(&self->mutex);
    if (self->entries[fd].owner && (self->entries[fd].whole || self->entries[fd].ended)) {
        Entry *entry = &self->entries[fd], rest = *entry;
        rest.bytes = NULL;
        rest.used = rest.room = rest.whole = 0;
        if (!keep(&rest, entry->bytes + entry->whole, entry->used - entry->whole)) {
            bytes = entry->bytes;
            whole = entry->whole;
            *entry = rest;
        } else if (!entry->ended) {
            ends(self, entry, fd, ENOMEM);
        }
        owner = entry->owner;
        Py_INCREF(owner);
        ended = entry->ended;
        error = entry->error;
        announced = entry->announced;
    }
    pthread_mutex_unlock(&self->mutex);
    if (!owner)
        return Py_BuildValue("");
    messages = PyList_New(0);
    for (size_t at = 0; messages && at < whole;) {
        size_t length = bytes[at] | (size_t)bytes[at + 1] << 8 | (size_t)bytes[at + 2] << 16 | (size_t)bytes[at + 3] << 24;
        PyObject *one = sink_bytes(bytes + at + 4, length);
        if (!one || PyList_Append(messages, one))
            Py_CLEAR(messages);
        Py_XDECREF(one);
        at += 4 + length;
    }
    free(bytes);
    if (!messages) { /* no room for them: this connection ends, and the others go on */
        PyErr_Clear();
        messages = PyList_New(0);
        ended = 1;
        error = ENOMEM;
    }
    if (messages && announced)
        found = Py_BuildValue("(ONN)", owner, messages,
                              PyUnicode_FromFormat("a message of %lu bytes was announced", (unsigned long)announced));
    else if (messages && ended)
        found = Py_BuildValue("(ONs)", owner, messages, error ? strerror(error) : "it was closed");
    else if (messages)
        found = Py_BuildValue("(ONO)", owner, messages, Py_None);
    Py_DECREF(owner);
    return found;
}

static PyObject *loop_wait(LoopObject *self, PyObject *unused)
{
    struct epoll_event events[EVENTS];
    PyObject *list;
    int woken = 0;
    (void)unused;
    if (self->waits)
        return PyErr_Format(PyExc_RuntimeError, "another thread is already waiting");
    self->waits = 1;
    self->news_count = 0;
    Py_BEGIN_ALLOW_THREADS;
    while (!self->news_count && !woken && self->epoll >= 0) {
        int count = epoll_wait(self->epoll, events, EVENTS, -1);
        for (int i = 0; i < count; i++) {
            uint64_t number;
            if (events[i].data.u64 >> 32)
                serve(self, &events[i]);
            else if (read(self->waker, &number, sizeof number) > 0)
                woken = 1;
        }
    }
    Py_END_ALLOW_THREADS;
    list = PyList_New(0);
    for (int i = 0; list && i < self->news_count; i++) {
        PyObject *news = news_of(self, self->news[i]);
        if (!news || (news != Py_None && PyList_Append(list, news)))
            Py_CLEAR(list);
        Py_XDECREF(news);
    }
    self->waits = 0;
    return list;
}

static PyObject *loop_wake(LoopObject *self, PyObject *unused)
{
    uint64_t one = 1;
    (void)unused;
    if (self->waker >= 0 && write(self->waker, &one, sizeof one) < 0 && errno != EAGAIN)
        return PyErr_SetFromErrno(PyExc_OSError);
    Py_RETURN_NONE;
}

static PyObject *loop_close(LoopObject *self, PyObject *unused)
{
    (void)unused;
    pthread_mutex_lock(&self->mutex);
    loop_shut(self);
    pthread_mutex_unlock(&self->mutex);
    Py_RETURN_NONE;
}

static PyMethodDef loop_methods[] = {
    {"receive", (PyCFunction)loop_receive, METH_VARARGS,
     "receive(fd, owner, capsule): receive from a publisher, into a sink or (None) for wait()."},
    {"divert", (PyCFunction)loop_divert, METH_VARARGS, "divert(fd, capsule): send received data to another sink, or none."},
    {"remove", (PyCFunction)loop_remove, METH_VARARGS, "remove(fd): stop serving a connection, before it is closed."},
    {"wait", (PyCFunction)loop_wait, METH_NOARGS,
     "wait() -> [(owner, messages, why it ended or None)], what no sink accepted; empty after wake()."},
    {"close", (PyCFunction)loop_close, METH_NOARGS, "Free everything, once no thread waits."},
    {"wake", (PyCFunction)loop_wake, METH_NOARGS, "Make this or the next wait() return."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot loop_slots[] = {
    {Py_tp_doc, "Loop(most): the connections that one thread serves, in wait(); a message has at most `most` bytes."},
    {Py_tp_new, (void *)loop_new},
    {Py_tp_dealloc, (void *)loop_dealloc},
    {Py_tp_methods, loop_methods},
    {0, NULL},
};

static PyType_Spec loop_spec = {"rosplc.ros.rospy._tcp.Loop", sizeof(LoopObject), 0, Py_TPFLAGS_DEFAULT, loop_slots};

/* ---------------------------------------------------------------- a topic's subscribers */

static PyObject *sender_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"loop", NULL};
    PyObject *loop;
    Sender *self;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!:Sender", names, loop_type, &loop)
        || !(self = py_allocate(type)))
        return NULL;
    if (pthread_mutex_init(&self->mutex, NULL)) {
        Py_DECREF((PyObject *)self);
        return PyErr_NoMemory();
    }
    self->ready = 1;
    Py_INCREF(loop);
    self->loop = (LoopObject *)loop;
    return (PyObject *)self;
}

static void sender_dealloc(Sender *self)
{
    let_go(self->latched); /* connections hold references: there are none */
    if (self->ready)
        pthread_mutex_destroy(&self->mutex);
    Py_XDECREF((PyObject *)self->loop);
    py_release(self);
}

static PyObject *sender_add(Sender *self, PyObject *args)
{
    int fd, latching;
    Py_ssize_t depth;
    Entry entry = {.sender = self};
    Out *out;
    if (!PyArg_ParseTuple(args, "iOnp:add", &fd, &entry.owner, &depth, &latching))
        return NULL;
    out = calloc(1, sizeof *out);
    if (!out)
        return PyErr_NoMemory();
    out->number = loop_enter(self->loop, fd, entry, EPOLLRDHUP);
    if (!out->number) {
        free(out);
        return NULL;
    }
    out->fd = fd;
    out->depth = depth < 1 ? 1 : (size_t)depth;
    pthread_mutex_lock(&self->mutex);
    if (self->latched && latching)
        out_put(self, out, self->latched->bytes + 4, self->latched->size - 4, &self->latched);
    out->next = self->outs;
    self->outs = out;
    pthread_mutex_unlock(&self->mutex);
    Py_RETURN_NONE;
}

static PyObject *sender_write(Sender *self, PyObject *args)
{
    const char *payload;
    Py_ssize_t size;
    int latch, lost;
    if (!PyArg_ParseTuple(args, "y#p:write", &payload, &size, &latch))
        return NULL;
    if ((size_t)size > self->loop->most)
        return PyErr_Format(PyExc_OverflowError, "the message exceeds %lu bytes", (unsigned long)self->loop->most);
    Py_BEGIN_ALLOW_THREADS;
    pthread_mutex_lock(&self->mutex);
    lost = send_all(self, (const uint8_t *)payload, (size_t)size, latch);
    pthread_mutex_unlock(&self->mutex);
    Py_END_ALLOW_THREADS;
    return PyLong_FromLong(lost);
}

static PyObject *sender_close(Sender *self, PyObject *unused)
{
    (void)unused;
    pthread_mutex_lock(&self->mutex);
    self->closed = 1;
    pthread_mutex_unlock(&self->mutex);
    Py_RETURN_NONE;
}

static PyObject *sender_waiting(Sender *self, void *unused)
{
    size_t count = 0;
    (void)unused;
    pthread_mutex_lock(&self->mutex);
    for (Out *out = self->outs; out; out = out->next)
        count += out->count + (out->begun != NULL);
    pthread_mutex_unlock(&self->mutex);
    return PyLong_FromSize_t(count);
}

static PyMethodDef sender_methods[] = {
    {"add", (PyCFunction)sender_add, METH_VARARGS,
     "add(fd, owner, depth, latching): send to a subscriber too, what is latched first; `depth` messages may wait."},
    {"write", (PyCFunction)sender_write, METH_VARARGS,
     "write(payload, latch) -> how many messages had to give way in full queues. Never blocks."},
    {"close", (PyCFunction)sender_close, METH_NOARGS, "Stop all outlets from sending."},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef sender_attributes[] = {
    {"waiting", (getter)sender_waiting, NULL, "How many messages wait for all subscribers.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot sender_slots[] = {
    {Py_tp_doc, "Sender(loop): the subscribers of a topic; the loop sends what has to wait."},
    {Py_tp_new, (void *)sender_new},
    {Py_tp_dealloc, (void *)sender_dealloc},
    {Py_tp_methods, sender_methods},
    {Py_tp_getset, sender_attributes},
    {0, NULL},
};

static PyType_Spec sender_spec = {"rosplc.ros.rospy._tcp.Sender", sizeof(Sender), 0, Py_TPFLAGS_DEFAULT, sender_slots};

typedef struct {
    SinkObject head;
    Sender *sender;
    int latch;
} OutletObject;

static int outlet_pass(rosplc_sink *base, const uint8_t *wire, size_t size, int64_t stamp_ns)
{
    OutletObject *self = sink_object(base);
    int refused;
    (void)stamp_ns; /* ROS 1 carries none */
    pthread_mutex_lock(&self->sender->mutex);
    refused = self->sender->closed || size > self->sender->loop->most;
    for (Out *out = self->sender->outs; out; out = out->next) /* Python counts what gives way */
        refused = refused || out->count >= out->depth;
    if (!refused)
        send_all(self->sender, wire, size, self->latch);
    pthread_mutex_unlock(&self->sender->mutex);
    return refused;
}

static PyObject *outlet_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"sender", "latch", NULL};
    PyObject *sender;
    int latch;
    OutletObject *self;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!p:Outlet", names, sender_type, &sender, &latch)
        || !(self = sink_new(type, outlet_pass)))
        return NULL;
    Py_INCREF(sender);
    self->sender = (Sender *)sender;
    self->latch = latch;
    return (PyObject *)self;
}

static void outlet_dealloc(OutletObject *self)
{
    Py_DECREF((PyObject *)self->sender);
    sink_dealloc(&self->head);
}

static PyObject *outlet_open(OutletObject *self, PyObject *args)
{
    long long limit_ns;
    if (!PyArg_ParseTuple(args, "L:open", &limit_ns))
        return NULL;
    sink_close(&self->head);
    sink_open(&self->head, limit_ns);
    Py_RETURN_NONE;
}

static PyMethodDef outlet_methods[] = {
    {"open", (PyCFunction)outlet_open, METH_VARARGS,
     "open(limit_ns): send messages, until a queue is full or one comes after a longer silence."},
    SINK_CLOSE,
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef outlet_attributes[] = {SINK_ATTRIBUTES, {NULL, NULL, NULL, NULL, NULL}};

static PyType_Slot outlet_slots[] = SINK_SLOTS("Outlet(sender, latch): a publisher's sink.", outlet_new, outlet_dealloc,
                                               outlet_methods, outlet_attributes);

static PyType_Spec outlet_spec = {"rosplc.ros.rospy._tcp.Outlet", sizeof(OutletObject), 0, Py_TPFLAGS_DEFAULT,
                                  outlet_slots};

static int exec_module(PyObject *module)
{
    return py_only_interpreter() || py_add_type(module, "Loop", &loop_spec, &loop_type)
                   || py_add_type(module, "Sender", &sender_spec, &sender_type)
                   || py_add_type(module, "Outlet", &outlet_spec, NULL)
               ? -1
               : 0;
}

static PyModuleDef_Slot module_slots[] = {{Py_mod_exec, (void *)exec_module}, {0, NULL}};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "rosplc.ros.rospy._tcp", "Messages on connections of ROS 1.", 0, NULL, module_slots,
    NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__tcp(void)
{
    return PyModuleDef_Init(&definition);
}
