// The page's data; views subscribe to the parts that they show.

const EVENTS = 500;
const SAMPLES = 12000; // ten minutes at twenty samples a second
const RATES = 240;

/** A plotted channel's samples: times in ms since 1970, and values by path. */
class Series {
  constructor() {
    this.times = [];
    this.values = new Map();
  }

  add(block) {
    const before = this.times.length;
    const fresh = block.t.length;
    for (const time of block.t) this.times.push(time);
    for (const [name, values] of Object.entries(block)) {
      if (!name.startsWith("v:")) continue;
      const path = name.slice(2);
      let known = this.values.get(path);
      if (!known) this.values.set(path, (known = new Array(before).fill(null)));
      for (const value of values) known.push(value);
    }
    for (const known of this.values.values()) while (known.length < before + fresh) known.push(null);
    const extra = this.times.length - SAMPLES;
    if (extra > 400) {
      this.times.splice(0, extra);
      for (const known of this.values.values()) known.splice(0, extra);
    }
  }
}

class Store extends EventTarget {
  constructor() {
    super();
    this.channels = new Map();
    this.bridges = [];
    this.notes = [];
    this.events = []; // oldest first
    this.messages = new Map();
    this.series = new Map();
    this.rates = new Map(); // the last minutes of each channel's rate, for its small curve
    this.hello = null;
    this.link = "connecting";
    this.failure = "";
    this.timeMs = 0;
    this.clockOffset = 0; // the server's clock minus this one's
  }

  say(what, detail = null) {
    this.dispatchEvent(new CustomEvent(what, { detail }));
  }

  on(what, listener, signal) {
    this.addEventListener(what, (event) => listener(event.detail), { signal });
  }

  setLink(state) {
    if (this.link === state) return;
    this.link = state;
    this.say("link");
  }

  /** Forget the data of an earlier server: a new server counts from zero. */
  begin(hello) {
    this.hello = hello;
    this.channels.clear();
    this.events = [];
    this.messages.clear();
    this.say("hello");
  }

  take(frame) {
    if (frame.time_ms) {
      this.timeMs = frame.time_ms;
      this.clockOffset = frame.time_ms - Date.now();
    }
    if (frame.notes) this.notes = frame.notes;
    if (frame.bridges) this.bridges = frame.bridges;
    if (frame.failure !== undefined) this.failure = frame.failure;
    if (frame.notes || frame.failure !== undefined) this.say("notes");
    if (frame.time_ms) this.takeChannels(frame);
    if (frame.events) {
      this.events.push(...frame.events);
      if (this.events.length > EVENTS) this.events.splice(0, this.events.length - EVENTS);
      this.say("events", frame.events.filter((event) => event.time_ns / 1e6 > this.hello.time_ms));
    }
    for (const [id, message] of Object.entries(frame.messages ?? {})) {
      this.messages.set(id, message);
      this.say("message", id);
    }
    if (frame.samples) {
      for (const [id, block] of Object.entries(frame.samples)) {
        if (!this.series.has(id)) this.series.set(id, new Series());
        this.series.get(id).add(block);
      }
      this.say("samples");
    }
  }

  takeChannels(frame) {
    for (const [id, members] of Object.entries(frame.channels ?? {})) {
      const known = this.channels.get(id);
      if (known) Object.assign(known, members);
      else this.channels.set(id, members);
    }
    for (const id of frame.gone ?? []) this.channels.delete(id);
    for (const [id, channel] of this.channels) {
      let rates = this.rates.get(id);
      if (!rates) this.rates.set(id, (rates = []));
      rates.push(channel.rate_hz);
      if (rates.length > RATES) rates.shift();
    }
    for (const id of this.rates.keys()) if (!this.channels.has(id)) this.rates.delete(id);
    this.say("channels");
  }
}

export const store = new Store();
