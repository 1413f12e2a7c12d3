// One plot on a canvas: grid, axes, and curves with gaps where no data arrived.

import { el, setAttribute } from "./dom.js";
import { clock, number } from "./format.js";

const LEFT = 64;
const RIGHT = 12;
const TOP = 10;
const BOTTOM = 24;
const GAP_MS = 1500; // or a few times the usual interval, if that is longer
const DASHES = [[], [7, 4], [2, 3], [10, 3, 2, 3]];

/** Make a plot of several curves; `draw(data, start, end)` paints times in ms since 1970. */
export function chart(series) {
  const canvas = el("canvas", { class: "chart", role: "img" });
  const root = el("div", { class: "chart-box" }, canvas);
  let pointer = null;
  let last = null;
  const follow = (event) => {
    pointer = event.type === "pointerleave" ? null : event.offsetX;
    if (last) paint(...last);
  };
  for (const kind of ["pointermove", "pointerdown", "pointerleave"]) canvas.addEventListener(kind, follow);

  function paint(data, start, end) {
    last = [data, start, end];
    const width = root.clientWidth;
    const height = root.clientHeight;
    if (!width || !height) return;
    const ratio = devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const context = canvas.getContext("2d");
    const style = getComputedStyle(root);
    const colour = (name) => style.getPropertyValue(name).trim();
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const [low, high] = bounds(data);
    const area = { left: LEFT, right: width - RIGHT, top: TOP, bottom: height - BOTTOM };
    const x = (time) => area.left + ((time - start) / (end - start)) * (area.right - area.left);
    const y = (value) => area.bottom - ((value - low) / (high - low)) * (area.bottom - area.top);
    context.font = `12px ${style.fontFamily}`;
    grid(context, area, x, y, low, high, start, end, colour);
    context.save();
    context.beginPath();
    context.rect(area.left, area.top - 2, area.right - area.left, area.bottom - area.top + 4);
    context.clip();
    data.forEach((each, index) => curve(context, each, x, y, series[index].index, series.length, colour));
    context.restore();
    if (pointer !== null && pointer > area.left && pointer < area.right) {
      cross(context, data, area, x, y, start + ((pointer - area.left) / (area.right - area.left)) * (end - start), series, colour);
    }
  }

  return { root, draw: paint, describe: (text) => setAttribute(canvas, "aria-label", text), close() { last = null; } };
}

function bounds(data) {
  let low = Infinity;
  let high = -Infinity;
  for (const each of data) {
    if (each.low === null) continue;
    low = Math.min(low, each.low);
    high = Math.max(high, each.high);
  }
  if (low > high) return [0, 1];
  if (low === high) {
    const room = Math.abs(low) * 0.1 || 1;
    return [low - room, high + room];
  }
  const room = (high - low) * 0.08;
  return [low - room, high + room];
}

/** Round steps: 1, 2 or 5 times a power of ten. */
function stepOf(range, most) {
  const rough = range / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((each) => each * power).find((each) => each >= rough) ?? 10 * power;
}

function grid(context, area, x, y, low, high, start, end, colour) {
  context.lineWidth = 1;
  context.strokeStyle = colour("--grid");
  context.fillStyle = colour("--muted");
  context.textAlign = "right";
  context.textBaseline = "middle";
  const step = stepOf(high - low, Math.max(2, Math.floor((area.bottom - area.top) / 34)));
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
    const at = Math.round(y(value)) + 0.5;
    line(context, area.left, at, area.right, at);
    context.fillText(number(Math.abs(value) < step / 1e6 ? 0 : Number(value.toPrecision(10))), area.left - 8, at);
  }
  context.textAlign = "center";
  context.textBaseline = "top";
  const seconds = (end - start) / 1000;
  const every = [1, 2, 5, 10, 15, 30, 60, 120].find((each) => seconds / each <= Math.max(2, (area.right - area.left) / 90)) ?? 300;
  for (let time = Math.ceil(start / (every * 1000)) * every * 1000; time <= end; time += every * 1000) {
    const at = Math.round(x(time)) + 0.5;
    line(context, at, area.top, at, area.bottom);
    if (at > area.left + 20 && at < area.right - 20) context.fillText(clock(time), at, area.bottom + 7);
  }
  context.strokeStyle = colour("--axis");
  line(context, area.left + 0.5, area.top, area.left + 0.5, area.bottom);
  line(context, area.left, area.bottom + 0.5, area.right, area.bottom + 0.5);
}

function gapOf(times) {
  return Math.max(GAP_MS, times.length > 2 ? (4 * (times[times.length - 1] - times[0])) / times.length : 0);
}

function line(context, fromX, fromY, toX, toY) {
  context.beginPath();
  context.moveTo(fromX, fromY);
  context.lineTo(toX, toY);
  context.stroke();
}

function curve(context, data, x, y, index, curves, colour) {
  context.strokeStyle = colour(`--series-${index % 8}`);
  context.lineWidth = 2;
  context.lineJoin = "round";
  // In a plot with several curves, dashes also distinguish them.
  context.setLineDash(curves > 1 ? DASHES[Math.floor(index) % DASHES.length] : []);
  context.beginPath();
  const gap = gapOf(data.times);
  let open = false;
  let before = 0;
  data.times.forEach((time, at) => {
    const value = data.values[at];
    if (value === null || time - before > gap) open = false;
    before = time;
    if (value === null) return;
    if (open) context.lineTo(x(time), y(value));
    else context.moveTo(x(time), y(value));
    open = true;
  });
  context.stroke();
  context.setLineDash([]);
}

function cross(context, data, area, x, y, time, series, colour) {
  context.strokeStyle = colour("--axis");
  const at = Math.round(x(time)) + 0.5;
  line(context, at, area.top, at, area.bottom);
  const texts = [clock(time, true)];
  data.forEach((each, index) => {
    let near = -1;
    for (let point = 0; point < each.times.length; point += 1) {
      if (each.values[point] !== null && (near < 0 || Math.abs(each.times[point] - time) < Math.abs(each.times[near] - time))) near = point;
    }
    if (near < 0 || Math.abs(each.times[near] - time) > gapOf(each.times)) return;
    context.fillStyle = colour(`--series-${series[index].index % 8}`);
    context.beginPath();
    context.arc(x(each.times[near]), y(each.values[near]), 4, 0, 7);
    context.fill();
    texts.push(number(each.values[near]));
  });
  context.font = `600 12px ${context.font.replace(/^.*?px /, "")}`;
  const text = texts.join("   ");
  const width = context.measureText(text).width + 16;
  const left = Math.min(Math.max(area.left + 2, at + 8), area.right - width - 2);
  context.fillStyle = colour("--raised");
  context.strokeStyle = colour("--line");
  context.beginPath();
  context.roundRect(left, area.top + 2, width, 22, 5);
  context.fill();
  context.stroke();
  context.fillStyle = colour("--text");
  context.textAlign = "left";
  context.textBaseline = "middle";
  context.fillText(text, left + 8, area.top + 13.5);
}
