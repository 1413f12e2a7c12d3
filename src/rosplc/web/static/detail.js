// One channel: its state, the stations on its path, its message, and the form for a test message.

import { el, fill, setAttribute, setText } from "./dom.js";
import { eventList } from "./events.js";
import { age, bytes, clock, count, rate, span, typeName, way } from "./format.js";
import { sparkline } from "./sparkline.js";
import { chip, toneOf } from "./states.js";
import { store } from "./store.js";
import { ask } from "./token.js";
import { messageTree } from "./tree.js";
import { writeForm } from "./write.js";

/** Make the view of a channel; `plots` is the page's choice of plotted fields. */
export function channelDetail(id, plots) {
  const stop = new AbortController();
  const state = chip();
  const title = el("h2", { id: "detail-title", tabindex: "-1" });
  const words = el("p", { class: "words" });
  const type = el("p", { class: "detail-type" });
  const stations = new Map();
  const path = el("ol", { class: "path", "aria-label": "Path of a message" });
  const curve = sparkline("Messages per second over the last minutes");
  const facts = new Map();
  const factList = el("dl", { class: "facts" });
  const body = el("div", { class: "message-body" }, el("p", { class: "empty" }, "Loading …"));
  const about = el("p", { class: "message-about" });
  const writing = el("div", { class: "writing" });
  const own = eventList((event) => event.channel === id, { limit: 8, topic: false, empty: "No events here since this page was opened." });
  const root = el("section", { class: "panel detail", "aria-labelledby": "detail-title" },
    el("div", { class: "panel-head" },
      el("a", { class: "button back", href: "#/channels" }, "‹ All channels"),
      el("div", { class: "title-line" }, title, state),
      type, words),
    el("div", { class: "scroll", tabindex: "0", role: "group", "aria-labelledby": "detail-title" },
      path,
      el("div", { class: "figures" }, factList, el("div", { class: "figure-curve" }, el("span", { class: "fact-name" }, "Rate, last 2 minutes"), curve.root)),
      el("h3", {}, "Message"), about, body,
      writing,
      el("h3", {}, "Events"), own.root));
  let tree = null;
  let layout = "";
  let asked = "";

  function showFact(name, text, tone = null) {
    let cell = facts.get(name);
    if (!cell) {
      cell = el("dd");
      facts.set(name, cell);
      factList.append(el("div", {}, el("dt", {}, name), cell));
    }
    setText(cell, text);
    setAttribute(cell, "data-tone", tone);
  }

  function showStation(key, name, text, alive) {
    let station = stations.get(key);
    if (!station) {
      station = { mark: chip(), text: el("span", { class: "station-text" }), root: null };
      station.root = el("li", { class: "station" }, el("span", { class: "station-name" }, name), station.mark, station.text);
      stations.set(key, station);
    }
    const [word, tone] = alive === true ? ["alive", "good"] : alive === false ? ["absent", "bad"] : ["unknown", "quiet"];
    station.mark.update(word, tone);
    setText(station.text, text);
    return station.root;
  }

  function showPath(channel) {
    const toPlc = channel.direction === "to_plc";
    const peers = channel.ros_peers;
    const noun = channel.call ? (channel.call.server === "plc" ? "client" : "server") : toPlc ? "publisher" : "subscriber";
    const ros = showStation("ros", "ROS", peers === null ? "not counted" : peers === 1 ? `1 ${noun}` : `${peers} ${noun}s`, peers === null ? null : peers > 0);
    const bridge = showStation("bridge", "Bridge", channel.bridge ? `${channel.bridge}${channel.bridge_pid ? `, process ${channel.bridge_pid}` : ""}` : "none", channel.bridge_alive);
    const tasks = channel.readers.filter((reader) => reader.alive !== false && (toPlc || reader.index > 0)).map((reader) => reader.task || `process ${reader.pid}`);
    const plc = showStation("plc", "PLC", toPlc ? (tasks.length ? `read by ${tasks.join(", ")}` : "no reader") : channel.plc_alive ? "writes" : "no writer", channel.plc_alive);
    const order = toPlc ? [ros, bridge, plc] : [plc, bridge, ros];
    if (order.some((station, index) => path.children[index] !== station)) fill(path, order);
  }

  function showChannel() {
    const channel = store.channels.get(id);
    if (!channel) {
      setText(title, store.link === "live" && store.timeMs ? "This channel is gone" : "Loading …");
      setText(words, store.link === "live" && store.timeMs ? "No object has this name at present. A new one will be shown here." : "");
      setAttribute(root, "data-gone", "");
      state.update("gone", "quiet");
      return;
    }
    setAttribute(root, "data-gone", null);
    setText(title, channel.label);
    setText(type, [typeName(channel.type_name), way(channel.direction), channel.classic ? "classic" : `prefix ${channel.prefix}`].filter(Boolean).join(" · "));
    setText(words, channel.words ? sentence(channel.words) : "");
    state.update(channel.state, toneOf(channel.state));
    showPath(channel);
    showFact("Rate", `${rate(channel.rate_hz)} /s`);
    showFact("Age", age(channel.age_ns), channel.stale ? "stale" : null);
    showFact("Messages", count(channel.received));
    showFact("Missed by readers", count(channel.lost));
    showFact("Refused", count(channel.refused), channel.refused ? "warn" : null);
    showFact("Truncated", count(channel.truncated), channel.truncated ? "warn" : null);
    showFact("Stale after", channel.stale_after_ns ? span(channel.stale_after_ns) : "never");
    if (channel.call) {
      showFact("Newest call", channel.call.number ? `${count(channel.call.number)}, ${channel.call.status}` : "none", channel.call.open ? "warn" : null);
      showFact("Ended calls", Object.entries(channel.call.ended).map(([words, number]) => `${count(number)} ${words}`).join(", ") || "none");
    }
    showFact("Record", bytes(channel.record_size));
    showFact("Slots", count(channel.slots));
    showFact("Layout", channel.layout_id || "–");
    curve.draw(store.rates.get(id) ?? []);
    const key = `${channel.layout_id} ${channel.generation}`;
    if (asked !== key && !channel.code) {
      asked = key;
      askForm(key);
    }
  }

  async function askForm(key) {
    let answer;
    try {
      answer = await ask(`/api/form?channel=${encodeURIComponent(id)}`);
    } catch (error) {
      if (asked === key) fill(body, el("p", { class: "empty" }, error.what));
      return;
    }
    if (asked !== key || stop.signal.aborted) return;
    if (layout !== answer.layout) {
      layout = answer.layout;
      tree = messageTree(answer.form, { has: (path) => plots.has(id, path), toggle: (path) => plots.toggle(id, path) });
      fill(writing, store.hello?.write && !store.channels.get(id)?.call ? writeForm(id, answer) : null);
    }
    showMessage();
  }

  function showMessage() {
    const message = store.messages.get(id);
    if (!tree || !message) return;
    if (message.error || message.none) {
      const text = message.none ? "No message yet." : `${sentence(message.error.what)} ${message.error.code}`;
      if (body.textContent !== text) fill(body, el("p", { class: "empty" }, text));
      setText(about, "");
      return;
    }
    if (body.firstChild !== tree.root) fill(body, tree.root);
    tree.update(message.values);
    const parts = [`Message number ${count(message.sequence)}`];
    if (message.stamp_ms && message.clock !== "plc") parts.push(`stamped ${clock(message.stamp_ms, true)}`);
    parts.push(...message.marks);
    setText(about, parts.join(" · "));
  }

  store.on("channels", showChannel, stop.signal);
  store.on("link", showChannel, stop.signal);
  store.on("message", (which) => which === id && showMessage(), stop.signal);
  store.on("events", () => own.update(), stop.signal);
  store.on("plots", () => tree?.showPlots(), stop.signal);
  showChannel();
  own.update();
  return { root, title, close: () => stop.abort() };
}

function sentence(text) {
  const first = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(first) ? first : `${first}.`;
}
