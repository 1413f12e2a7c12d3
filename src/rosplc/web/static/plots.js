// Plots over time: the fields, the time window, and the pause.

import { announce, el, fill, setAttribute, setText } from "./dom.js";
import { linkTo } from "./channels.js";
import { chart } from "./chart.js";
import { number } from "./format.js";
import { store } from "./store.js";

const KEY = "rosplc.plots";
const MOST = 24;
const WINDOWS = [[10, "10 s"], [30, "30 s"], [60, "1 min"], [300, "5 min"]];
const FRAME_MS = 50;
const CALM_MS = 1000;

/** The chosen fields, in order; kept in the browser. */
export class Plots {
  constructor() {
    this.fields = [];
    try {
      const kept = JSON.parse(localStorage.getItem(KEY) ?? "[]");
      this.fields = kept.filter((each) => typeof each?.id === "string" && typeof each.path === "string").slice(0, MOST);
    } catch {
      // Nothing is stored, or it cannot be read.
    }
  }

  has(id, path) {
    return this.fields.some((each) => each.id === id && each.path === path);
  }

  /** Add or remove a field; returns whether it is plotted now. */
  toggle(id, path) {
    const on = !this.has(id, path);
    if (on && this.fields.length >= MOST) {
      announce(`No more than ${MOST} fields can be plotted`);
      return false;
    }
    this.fields = on ? [...this.fields, { id, path }] : this.fields.filter((each) => each.id !== id || each.path !== path);
    this.changed();
    return on;
  }

  clear() {
    this.fields = [];
    this.changed();
  }

  changed() {
    try {
      localStorage.setItem(KEY, JSON.stringify(this.fields));
    } catch {
      // Without storage, the fields must be chosen again next time.
    }
    store.say("plots");
  }

  /** The paths per channel, in the form for the server. */
  wanted() {
    const paths = {};
    for (const { id, path } of this.fields) (paths[id] ??= []).push(path);
    return paths;
  }
}

let windowSeconds = 30;
let together = false;

/** The view of all plots. */
export function plotsView(plots) {
  const stop = new AbortController();
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  let paused = null;
  let lanes = [];
  let drawn = 0;
  let described = 0;

  const pause = el("button", { type: "button", class: "button primary", "aria-pressed": "false", onclick: () => setPaused(paused === null) }, "Pause");
  const windows = el("select", { class: "input", "aria-label": "Time window", onchange: () => { windowSeconds = Number(windows.value); draw(true); } },
    WINDOWS.map(([seconds, text]) => el("option", { value: seconds, selected: seconds === windowSeconds }, text)));
  const merge = el("button", { type: "button", class: "button", "aria-pressed": together, onclick: () => { together = !together; setAttribute(merge, "aria-pressed", together); build(); } }, "In one plot");
  const clear = el("button", { type: "button", class: "button quiet", onclick: () => plots.clear() }, "Remove all");
  const area = el("div", { class: "lanes" });
  const root = el("section", { class: "panel whole", "aria-labelledby": "plots-title" },
    el("div", { class: "panel-head" }, el("h1", { id: "plots-title" }, "Plots"), el("div", { class: "tools" }, pause, windows, merge, clear)),
    el("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "Plots" }, area));

  function setPaused(on) {
    paused = on ? Date.now() + store.clockOffset : null;
    setText(pause, on ? "Resume" : "Pause");
    setAttribute(pause, "aria-pressed", on);
    draw(true);
  }

  function nameOf(field) {
    return `${store.channels.get(field.id)?.label ?? field.id} ${field.path}`;
  }

  function build() {
    for (const lane of lanes) lane.chart.close();
    const groups = together && plots.fields.length ? [plots.fields] : plots.fields.map((field) => [field]);
    lanes = groups.map((fields) => lane(fields));
    fill(area, lanes.length ? lanes.map((each) => each.root) : el("p", { class: "empty" },
      "Nothing is plotted yet. Open a channel and press “Plot” next to a number; several fields may be plotted at once."));
    for (const button of [pause, merge, clear]) button.disabled = !plots.fields.length;
    draw(true);
  }

  function lane(fields) {
    const made = chart(fields.map((field) => ({ index: plots.fields.indexOf(field) })));
    const legends = fields.map((field) => {
      const now = el("output", { class: "legend-now", "aria-live": "off" });
      const range = el("span", { class: "legend-range" });
      const row = el("div", { class: "legend" },
        el("span", { class: `swatch series-${plots.fields.indexOf(field) % 8}`, "aria-hidden": "true" }),
        el("a", { class: "legend-topic", href: linkTo(field.id) }, store.channels.get(field.id)?.label ?? field.id),
        el("span", { class: "legend-path" }, field.path), now, range,
        el("button", { type: "button", class: "button small quiet", "aria-label": `Remove ${nameOf(field)}`, onclick: () => plots.toggle(field.id, field.path) }, "Remove"));
      return { row, now, range };
    });
    return { fields, chart: made, legends, root: el("figure", { class: "lane" }, el("figcaption", {}, legends.map((each) => each.row)), made.root) };
  }

  function draw(atOnce = false) {
    const now = performance.now();
    if (!atOnce && now - drawn < (calm.matches ? CALM_MS : FRAME_MS)) return;
    drawn = now;
    const end = paused ?? Date.now() + store.clockOffset;
    const start = end - windowSeconds * 1000;
    for (const lane of lanes) {
      const data = lane.fields.map((field) => dataOf(field, start, end));
      lane.chart.draw(data, start, end);
      lane.legends.forEach((legend, index) => {
        const { last, low, high } = data[index];
        setText(legend.now, last === null ? "–" : number(last));
        setText(legend.range, low === null ? "no value in this window" : `${number(low)} … ${number(high)}`);
      });
      if (atOnce || now - described > 1000) lane.chart.describe(lane.fields.map((field, index) => `${nameOf(field)}: ${lane.legends[index].now.textContent}, ${lane.legends[index].range.textContent}`).join("; "));
    }
    if (atOnce || now - described > 1000) described = now;
  }

  function loop() {
    if (stop.signal.aborted) return;
    if (paused === null && !document.hidden && lanes.length) draw();
    requestAnimationFrame(loop);
  }

  store.on("plots", build, stop.signal);
  store.on("hello", build, stop.signal);
  document.addEventListener("themechange", () => draw(true), { signal: stop.signal });
  addEventListener("resize", () => draw(true), { signal: stop.signal });
  build();
  loop();
  return { root, close: () => { stop.abort(); for (const lane of lanes) lane.chart.close(); } };
}

/** The part of a field's samples within a window, and its range. */
function dataOf(field, start, end) {
  const series = store.series.get(field.id);
  const values = series?.values.get(field.path);
  const found = { times: [], values: [], last: null, low: null, high: null };
  if (!values) return found;
  const from = Math.max(0, before(series.times, start) - 1);
  for (let at = from; at < series.times.length && series.times[at] <= end; at += 1) {
    const value = values[at] ?? null;
    found.times.push(series.times[at]);
    found.values.push(value);
    if (value === null || series.times[at] < start) continue;
    found.last = value;
    if (found.low === null || value < found.low) found.low = value;
    if (found.high === null || value > found.high) found.high = value;
  }
  return found;
}

/** The first index whose time is not before `time`. */
function before(times, time) {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] < time) low = middle + 1;
    else high = middle;
  }
  return low;
}
