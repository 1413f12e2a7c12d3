// The inputs for a test message: made from the type, and checked against its limits before sending.

import { el, fill, setText } from "./dom.js";

const MANY = 24;
const WHOLE = /^[+-]?\d+$/;
const DECIMAL = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;
const SPECIAL = /^[+-]?(nan|inf|infinity)$/i;
const LARGEST = { float32: 3.4028235677973366e38, float64: Number.MAX_VALUE };
const encoder = new TextEncoder();
let numbers = 0;

/** What is wrong with a text for a field; null if nothing. */
function wrong(form, text) {
  if (form.kind === "string") {
    const size = encoder.encode(text).length;
    if (size > form.capacity) return `${size} bytes; at most ${form.capacity} fit`;
    return text.includes("\0") ? "a string cannot contain a NUL character" : null;
  }
  const trimmed = text.trim();
  if (form.kind === "float") {
    if (!DECIMAL.test(trimmed) && !SPECIAL.test(trimmed)) return "a number is expected, such as 0.25 or 1e-3";
    return DECIMAL.test(trimmed) && Math.abs(Number(trimmed)) > LARGEST[form.type] ? `too large for ${form.type}` : null;
  }
  if (!WHOLE.test(trimmed)) return "a whole number is expected";
  const value = BigInt(trimmed.replace("+", ""));
  return value < BigInt(form.low) || value > BigInt(form.high) ? `must be from ${form.low} to ${form.high}` : null;
}

/** Whether a message has a NaN or infinity, which must be intended. */
export function isFinite(form, value) {
  if (form.kind === "struct") return form.members.every((member) => isFinite(member, value[member.name]));
  if (form.kind === "list") return value.every((item) => isFinite(form.element, item));
  return form.kind !== "float" || !SPECIAL.test(value);
}

/** A message's values as lines of text, `path = value`. */
export function lines(value, path = "") {
  if (Array.isArray(value)) return value.length ? value.flatMap((item, index) => lines(item, `${path}[${index}]`)) : [`${path} is empty`];
  if (typeof value !== "object") return [`${path} = ${value === "" ? '""' : value}`];
  return Object.entries(value).flatMap(([name, item]) => lines(item, path ? `${path}.${name}` : name));
}

/** Make the input of a field: `{root, get(), set(value), check(), at(path)}`. */
export function input(form, label, path) {
  if (form.kind === "struct") return structInput(form, label, path);
  if (form.kind === "list") {
    const plain = ["integer", "float"].includes(form.element.kind);
    return plain && form.capacity > MANY ? textList(form, label, path) : listInput(form, label, path);
  }
  return form.kind === "bool" ? boolInput(label, path) : textInput(form, label, path);
}

function structInput(form, label, path) {
  const members = form.members.map((member) => [member.name, input(member, member.name, path ? `${path}.${member.name}` : member.name)]);
  const constants = form.constants.length
    ? el("p", { class: "hint" }, "Constants: ", form.constants.map((each) => `${each.name} = ${each.value}`).join(", "))
    : null;
  const inside = [constants, ...members.map(([, each]) => each.root)];
  return {
    root: label ? el("fieldset", {}, el("legend", {}, label), inside) : el("div", { class: "form-top" }, inside),
    get: () => Object.fromEntries(members.map(([name, each]) => [name, each.get()])),
    set: (value) => members.forEach(([name, each]) => value?.[name] !== undefined && each.set(value[name])),
    check: () => members.flatMap(([, each]) => each.check()),
    at: (wanted) => members.map(([, each]) => each.at(wanted)).find(Boolean) ?? null,
  };
}

/** The line for one value, with a place for its error. */
function line(control, label, path, hint, check) {
  numbers += 1;
  const id = `field-${numbers}`;
  control.id = id;
  control.setAttribute("aria-describedby", `${id}-hint ${id}-error`);
  const error = el("span", { class: "field-error", id: `${id}-error` });
  const root = el("div", { class: "form-row" },
    el("label", { for: id }, label), control,
    el("span", { class: "hint", id: `${id}-hint` }, hint), error);
  const complain = (text) => {
    setText(error, text ?? "");
    if (text) control.setAttribute("aria-invalid", "true");
    else control.removeAttribute("aria-invalid");
  };
  const self = { path, focus: () => control.focus(), complain };
  control.addEventListener("input", () => complain(check()));
  return {
    root,
    check: () => {
      const text = check();
      complain(text);
      return text ? [self] : [];
    },
    at: (wanted) => (wanted === path ? self : null),
  };
}

function textInput(form, label, path) {
  const control = el("input", { type: "text", class: "input", autocomplete: "off", spellcheck: "false", inputmode: form.kind === "string" ? "text" : form.kind === "float" ? "decimal" : "numeric" });
  const hint = form.kind === "string" ? `text, ${form.capacity} bytes` : form.type;
  const numeric = form.kind !== "string";
  if (numeric) control.classList.add("numeric");
  return {
    ...line(control, label, path, hint, () => wrong(form, control.value)),
    // As text: JavaScript cannot represent every number of a PLC.
    get: () => (numeric ? control.value.trim() : control.value),
    set: (value) => { control.value = String(value); },
  };
}

function boolInput(label, path) {
  const control = el("input", { type: "checkbox", class: "check" });
  return {
    ...line(control, label, path, "bool", () => null),
    get: () => control.checked,
    set: (value) => { control.checked = Boolean(value); },
  };
}

/** An input for many numbers in one text. */
function textList(form, label, path) {
  const control = el("textarea", { class: "input numeric", rows: "3", spellcheck: "false" });
  const items = () => control.value.split(/[\s,;]+/).filter(Boolean);
  const check = () => {
    const given = items();
    if (form.fixed ? given.length !== form.capacity : given.length > form.capacity) {
      return form.fixed ? `${given.length} numbers; there must be ${form.capacity}` : `${given.length} numbers; at most ${form.capacity} fit`;
    }
    const bad = given.findIndex((item) => wrong(form.element, item));
    return bad < 0 ? null : `number ${bad + 1}, ${given[bad].slice(0, 20)}: ${wrong(form.element, given[bad])}`;
  };
  const hint = `${form.element.type}, ${form.fixed ? `${form.capacity} numbers` : `at most ${form.capacity}`}`;
  const made = line(control, label, path, hint, check);
  return {
    ...made,
    at: (wanted) => (wanted === path || wanted.startsWith(`${path}[`) ? made.at(path) : null),
    get: items,
    set: (value) => { control.value = (Array.isArray(value) ? value : value.first ?? []).join(", "); },
  };
}

/** Inputs for a few elements, or for elements other than numbers: each has its own inputs. */
function listInput(form, label, path) {
  let items = [];
  const place = el("div", { class: "form-items" });
  const number = el("span", { class: "hint" });
  const add = el("button", { type: "button", class: "button small", onclick: () => { push(); items[items.length - 1].focus?.(); } }, `Add to ${label}`);
  const drop = el("button", { type: "button", class: "button small", onclick: () => { items.pop(); show(); } }, "Remove the last");

  function push() {
    items.push(input(form.element, `${label}[${items.length}]`, `${path}[${items.length}]`));
    show();
  }

  function show() {
    fill(place, items.map((item) => item.root));
    setText(number, form.fixed ? `${form.capacity} elements` : `${items.length} of at most ${form.capacity} elements`);
    add.disabled = items.length >= form.capacity;
    drop.disabled = !items.length;
  }

  if (form.fixed) for (let at = 0; at < form.capacity; at += 1) push();
  show();
  return {
    root: el("fieldset", {}, el("legend", {}, label), number, place, form.fixed ? null : el("div", { class: "tools" }, add, drop)),
    get: () => items.map((item) => item.get()),
    set: (value) => {
      const given = Array.isArray(value) ? value : value.first ?? [];
      while (!form.fixed && items.length > given.length) items.pop();
      while (items.length < Math.min(given.length, form.capacity)) push();
      show();
      items.forEach((item, index) => given[index] !== undefined && item.set(given[index]));
    },
    check: () => items.flatMap((item) => item.check()),
    at: (wanted) => (wanted === path ? { path, focus: () => add.focus(), complain: (text) => setText(number, text) } : items.map((item) => item.at(wanted)).find(Boolean) ?? null),
  };
}
