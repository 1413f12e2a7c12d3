// The display formats of numbers, times and directions.

const WHOLE = new Intl.NumberFormat("en");
const DASH = "–";

/** A count, with separators between thousands. */
export function count(value) {
  return value === null || value === undefined ? DASH : WHOLE.format(value);
}

/** Messages per second. */
export function rate(hz) {
  if (hz === null || hz === undefined) return DASH;
  if (hz === 0) return "0";
  if (hz < 9.95) return hz.toFixed(hz < 0.095 ? 2 : 1);
  return WHOLE.format(Math.round(hz));
}

const LOOK_NS = 5e8;

/** The time since a message arrived, in nanoseconds, as precise as the server's looks. */
export function age(ns) {
  return ns !== null && ns !== undefined && ns < LOOK_NS ? "< 0.5 s" : span(ns);
}

/** A type's short name, without the folder that all types have. */
export function typeName(name) {
  return name.replace("/msg/", "/");
}

/** A time span given in nanoseconds. */
export function span(ns) {
  if (ns === null || ns === undefined) return DASH;
  const seconds = ns / 1e9;
  if (seconds < 0.9995) return `${Math.max(0, Math.round(seconds * 1000))} ms`;
  if (seconds < 59.95) return `${seconds.toFixed(1)} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ${Math.floor(seconds % 60)} s`;
  if (seconds < 86400) return `${Math.floor(seconds / 3600)} h ${Math.floor((seconds % 3600) / 60)} min`;
  return `${Math.floor(seconds / 86400)} d ${Math.floor((seconds % 86400) / 3600)} h`;
}

const pad = (number, digits = 2) => String(number).padStart(digits, "0");

/** The local time of day for a time in ms since 1970. */
export function clock(ms, fraction = false) {
  const time = new Date(ms);
  const text = `${pad(time.getHours())}:${pad(time.getMinutes())}:${pad(time.getSeconds())}`;
  return fraction ? `${text}.${pad(time.getMilliseconds(), 3)}` : text;
}

/** The local date for a time in ms since 1970. */
export function date(ms) {
  const time = new Date(ms);
  return `${time.getFullYear()}-${pad(time.getMonth() + 1)}-${pad(time.getDate())}`;
}

/** Bytes, with a fitting unit. */
export function bytes(value) {
  if (value < 1024) return `${value} bytes`;
  if (value < 1024 * 1024) return `${(value / 1024).toFixed(1)} KiB`;
  return `${(value / 1048576).toFixed(1)} MiB`;
}

/** The direction of a channel. */
export function way(direction) {
  if (direction === "to_plc") return "ROS → PLC";
  if (direction === "to_ros") return "PLC → ROS";
  return DASH;
}

/** A message's value as shown in a row. */
export function value(item, type = "") {
  if (item === null || item === undefined) return DASH;
  if (typeof item === "number") return number(item, type);
  if (typeof item === "boolean") return item ? "true" : "false";
  return String(item);
}

/** A number: integers in full, others with six significant digits. */
export function number(item, type = "") {
  if (Number.isInteger(item) && (!type.startsWith("float") || Math.abs(item) < 1e6)) {
    return type.startsWith("float") ? item.toFixed(1) : String(item);
  }
  const size = Math.abs(item);
  if (size >= 1e7 || size < 1e-4) return item.toExponential(4);
  return String(Number(item.toPrecision(7)));
}
