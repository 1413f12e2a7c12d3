// The events: a list, newest first, and an announcement for screen readers.

import { announce, el, setAttribute } from "./dom.js";
import { linkTo } from "./channels.js";
import { clock, date } from "./format.js";
import { shape, toneOfLevel } from "./states.js";
import { store } from "./store.js";

const WORDS = {
  appeared: "appeared", vanished: "vanished", replaced: "replaced", unreadable: "unreadable", readable: "readable again",
  stale: "stale", recovered: "recovered", refused: "refused", lost: "lost", truncated: "truncated",
  "bridge-gone": "bridge gone", "bridge-back": "bridge back", "plc-gone": "PLC gone", "plc-back": "PLC back",
  written: "test message", "write-refused": "write refused",
};

/** Make a list of the events that `fits` accepts. */
export function eventList(fits, { limit = 300, topic = true, empty = "No events since this page was opened." } = {}) {
  const items = el("ol", { class: "events", reversed: true });
  const none = el("p", { class: "empty" }, empty);
  const root = el("div", { class: "event-list" }, none, items);
  let newest = 0;

  return {
    root,
    /** Show new events; with `again`, all events from the beginning. */
    update(again = false) {
      const all = store.events;
      if (again || (all.length && all[all.length - 1].number < newest)) {
        items.replaceChildren();
        newest = 0;
      }
      for (const event of all) {
        if (event.number <= newest) continue;
        newest = event.number;
        if (fits(event)) items.prepend(row(event, topic));
      }
      while (items.children.length > limit) items.lastChild.remove();
      none.hidden = items.children.length > 0;
      items.hidden = !none.hidden;
    },
  };
}

function row(event, withTopic) {
  const tone = toneOfLevel(event.level);
  const ms = event.time_ns / 1e6;
  const subject = event.channel
    ? el("a", { class: "topic", href: linkTo(event.channel) }, event.topic)
    : el("span", { class: "topic" }, `prefix ${event.prefix}`);
  return el("li", { class: `event tone-${tone}`, "data-kind": event.kind },
    el("time", { datetime: new Date(ms).toISOString(), title: date(ms) }, clock(ms, true)),
    el("span", { class: "event-kind" }, shape(tone), WORDS[event.kind] ?? event.kind),
    withTopic ? subject : null,
    el("span", { class: "event-words" }, event.words));
}

/** The view of all events. */
export function eventsView() {
  const stop = new AbortController();
  let grave = false;
  let text = "";
  const fits = (event) => (!grave || event.level !== "OK") && (!text || `${event.topic} ${event.words} ${event.kind}`.toLowerCase().includes(text));
  const list = eventList(fits, { limit: 500 });
  const search = el("input", {
    type: "search", class: "input", placeholder: "Find in events", "aria-label": "Find in events",
    oninput: () => { text = search.value.trim().toLowerCase(); list.update(true); },
  });
  const only = el("button", {
    type: "button", class: "button", "aria-pressed": "false",
    onclick: () => { grave = !grave; setAttribute(only, "aria-pressed", grave); list.update(true); },
  }, "Problems only");
  const root = el("section", { class: "panel whole", "aria-labelledby": "events-title" },
    el("div", { class: "panel-head" }, el("h1", { id: "events-title" }, "Events"), el("p", { class: "words" }, "Since the server started, newest first."), el("div", { class: "tools" }, search, only)),
    el("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "List of events" }, list.root));
  store.on("events", () => list.update(), stop.signal);
  store.on("hello", () => list.update(true), stop.signal);
  list.update();
  return { root, close: () => stop.abort() };
}

let waiting = [];
let timer = 0;

/** Announce serious events, several in one sentence, at most once every few seconds. */
export function announceEvents(events) {
  waiting.push(...events.filter((event) => event.level === "ERROR" || event.kind === "stale" || event.kind === "recovered"));
  if (!waiting.length || timer) return;
  timer = setTimeout(() => {
    timer = 0;
    const [first] = waiting;
    const others = waiting.length - 1;
    announce(`${first.topic || first.prefix}: ${first.words}${others ? `, and ${others} more events` : ""}`);
    waiting = [];
  }, 1500);
}
