// A message as a tree: built once from the type; then only texts change, so focus and position stay.

import { announce, el, setAttribute, setText } from "./dom.js";
import { typeName, value as text } from "./format.js";
import { profile } from "./profile.js";

const FIRST = 16;
const MORE = 256;
const STEADY_MS = 1500; // a value that changes more often is not highlighted
const NUMBERS = new Set(["integer", "float", "bool"]);

/** Make the tree of a type. `plots` manages the plotted fields: `has(path)`, `toggle(path)`. */
export function messageTree(form, plots) {
  const rows = [];
  const root = el("div", { class: "tree" }, members(form, "", 0, rows, plots));
  return {
    root,
    update(values) {
      for (const row of rows) row.update(values);
    },
    showPlots() {
      for (const row of rows) row.showPlot?.();
    },
  };
}

function members(form, path, depth, rows, plots) {
  if (!form.members.length) return el("p", { class: "tree-note" }, "This type has no fields.");
  return el("ul", { class: "tree-list", "data-depth": depth }, form.members.map((member) =>
    el("li", {}, node(member, member.name, path ? `${path}.${member.name}` : member.name, depth, rows, plots, (values) => values?.[member.name]))));
}

function node(form, label, path, depth, rows, plots, read) {
  if (form.kind === "struct") return struct(form, label, path, depth, rows, plots, read);
  if (form.kind === "list") return list(form, label, path, depth, rows, plots, read);
  return leaf(form, label, path, rows, plots, read);
}

function struct(form, label, path, depth, rows, plots, read) {
  const inside = [];
  const body = members(form, path, depth + 1, inside, plots);
  rows.push({
    update: (values) => { const own = read(values); for (const row of inside) row.update(own); },
    showPlot: () => { for (const row of inside) row.showPlot?.(); },
  });
  return el("details", { open: depth < 3 },
    el("summary", { class: "tree-row" }, el("span", { class: "field" }, label), el("span", { class: "field-type" }, typeName(form.type))),
    body);
}

function leaf(form, label, path, rows, plots, read) {
  const shown = el("span", { class: `field-value kind-${form.kind}` });
  const row = el("div", { class: "tree-row leaf" },
    el("span", { class: "field" }, label),
    el("span", { class: "field-type" }, form.type),
    shown);
  const button = NUMBERS.has(form.kind) ? plotButton(path, plots) : null;
  row.append(button ?? el("span"));
  let before;
  let changedMs = 0;
  rows.push({
    update(values) {
      const item = read(values);
      if (item === before) return;
      setText(shown, form.kind === "string" && item !== undefined ? `“${item}”` : text(item, form.type));
      const now = performance.now();
      if (before !== undefined && now - changedMs > STEADY_MS) flash(shown);
      before = item;
      changedMs = now;
    },
    showPlot: button?.show,
  });
  return row;
}

function flash(element) {
  element.classList.toggle("changed-a", !element.classList.contains("changed-a"));
  element.classList.toggle("changed-b", !element.classList.contains("changed-a"));
}

function plotButton(path, plots) {
  const button = el("button", {
    type: "button",
    class: "plot-toggle",
    onclick: () => {
      const on = plots.toggle(path);
      announce(on ? `${path} is plotted` : `${path} is no longer plotted`);
      button.show();
    },
  }, "Plot");
  button.show = () => {
    setAttribute(button, "aria-pressed", plots.has(path));
    setAttribute(button, "aria-label", `Plot ${path}`);
  };
  button.show();
  return button;
}

function list(form, label, path, depth, rows, plots, read) {
  const size = el("span", { class: "field-value" });
  const body = el("ul", { class: "tree-list", "data-depth": depth + 1 });
  const numeric = form.element.kind === "integer" || form.element.kind === "float";
  const curve = numeric && form.capacity > 3 ? profile(`Values of ${label}, in order`) : null;
  const more = el("button", { type: "button", class: "button small", hidden: true, onclick: () => { limit = MORE; refresh(); } });
  const details = el("details", { open: form.capacity <= 6, ontoggle: () => refresh() },
    el("summary", { class: "tree-row" },
      el("span", { class: "field" }, label), el("span", { class: "field-type" }, typeName(form.type)), size, curve?.root ?? null),
    body, more);
  const inside = [];
  let limit = FIRST;
  let items = [];
  let total = 0;

  function refresh() {
    curve?.draw(items);
    if (!details.open) return;
    const wanted = Math.min(items.length, limit);
    while (inside.length > wanted) { inside.pop(); body.lastChild.remove(); }
    while (inside.length < wanted) {
      const index = inside.length;
      const own = [];
      body.append(el("li", {}, node(form.element, `[${index}]`, `${path}[${index}]`, depth + 1, own, plots, (values) => values?.[index])));
      inside.push(own);
    }
    for (const own of inside) for (const row of own) row.update(items);
    more.hidden = total <= wanted;
    setText(more, items.length > wanted ? `Show ${Math.min(items.length, MORE)} of ${total}` : `${total - wanted} more are not shown`);
    more.disabled = items.length <= wanted;
  }

  rows.push({
    update(values) {
      const given = read(values);
      items = Array.isArray(given) ? given : given?.first ?? [];
      total = Array.isArray(given) ? given.length : given?.count ?? 0;
      setText(size, form.fixed ? `${total} values` : `${total} of at most ${form.capacity}`);
      refresh();
    },
    showPlot: () => { for (const own of inside) for (const row of own) row.showPlot?.(); },
  });
  return details;
}
