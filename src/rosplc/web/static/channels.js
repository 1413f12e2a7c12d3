// The overview: every channel with its state, by bridge.

import { el, fill, setAttribute, setText } from "./dom.js";
import { age, count, rate, typeName, way } from "./format.js";
import { chip, shape, toneOf } from "./states.js";
import { store } from "./store.js";

const TONES = [
  ["bad", "Fault"],
  ["warn", "Warning"],
  ["stale", "Stale"],
  ["quiet", "Looking"],
  ["good", "OK"],
];

/** The address of a channel's details. */
export const linkTo = (id) => `#/channels/${encodeURIComponent(id)}`;

/** Make the list; `selected()` returns the open channel. */
export function channelList(selected) {
  const filter = { text: "", tone: null, worstFirst: false };
  const rows = new Map();
  const groups = new Map();

  const search = el("input", {
    type: "search",
    class: "input",
    placeholder: "Find a topic, service, action or type",
    "aria-label": "Find a topic, service, action or type",
    oninput: () => {
      filter.text = search.value.trim().toLowerCase();
      update();
    },
  });
  const worst = el("button", {
    type: "button",
    class: "button",
    "aria-pressed": "false",
    onclick: () => {
      filter.worstFirst = !filter.worstFirst;
      worst.setAttribute("aria-pressed", filter.worstFirst);
      update();
    },
  }, "Worst first");
  const tiles = new Map(TONES.map(([tone, word]) => [tone, tile(tone, word)]));
  const table = el("table", { class: "channels" },
    el("caption", { class: "hidden-text" }, "Channels of this machine, by bridge"),
    el("thead", {}, el("tr", {},
      el("th", { scope: "col", class: "col-state" }, "State"),
      el("th", { scope: "col" }, "Topic"),
      el("th", { scope: "col", class: "col-way" }, "Direction"),
      el("th", { scope: "col", class: "num col-rate" }, "Rate ", el("small", {}, "1/s")),
      el("th", { scope: "col", class: "num" }, "Age"),
      el("th", { scope: "col", class: "num col-lost", title: "Messages that a reader missed; a reader that takes only the newest misses some by design" }, "Missed"),
      el("th", { scope: "col", class: "num col-refused" }, "Refused"),
    )),
  );
  const empty = el("p", { class: "empty", hidden: true });
  const root = el("section", { class: "panel list", "aria-labelledby": "list-title" },
    el("div", { class: "panel-head" },
      el("h1", { id: "list-title" }, "Channels"),
      el("div", { class: "tiles", role: "group", "aria-label": "Show channels by state" }, [...tiles.values()].map((each) => each.root)),
      el("div", { class: "tools" }, search, worst),
    ),
    el("div", { class: "scroll", tabindex: "0", role: "group", "aria-label": "List of channels" }, table, empty),
  );

  function tile(tone, word) {
    const number = el("span", { class: "tile-number" }, "0");
    const made = el("button", {
      type: "button",
      class: `tile tone-${tone}`,
      "aria-pressed": "false",
      onclick: () => {
        filter.tone = filter.tone === tone ? null : tone;
        for (const [other, each] of tiles) each.root.setAttribute("aria-pressed", filter.tone === other);
        update();
      },
    }, shape(tone), number, " ", el("span", { class: "tile-word" }, word));
    return { root: made, number };
  }

  function groupOf(channel) {
    const key = `${channel.prefix} ${channel.bridge}`;
    let group = groups.get(key);
    if (!group) {
      const name = el("span", { class: "group-name" });
      const facts = el("span", { class: "group-facts" });
      const state = chip();
      const head = el("tr", { class: "group" },
        el("th", { colspan: "7", scope: "rowgroup" }, el("span", { class: "group-line" }, name, state, facts)));
      group = { body: el("tbody", {}, head), name, facts, state, key, prefix: channel.prefix, bridge: channel.bridge };
      groups.set(key, group);
    }
    return group;
  }

  function rowOf(id) {
    let row = rows.get(id);
    if (row) return row;
    const state = chip();
    const topic = el("span", { class: "topic" });
    const type = el("span", { class: "type" });
    const link = el("a", { class: "row-link", href: linkTo(id) }, topic);
    const cells = ["way", "rate", "age", "lost", "refused"].map((name) =>
      el("td", { class: name === "way" ? "col-way" : `num col-${name}` }));
    const root = el("tr", { class: "channel" },
      el("td", { class: "col-state" }, state),
      el("td", { class: "col-topic" }, link, type),
      cells,
    );
    row = { root, state, topic, type, link, cells };
    rows.set(id, row);
    return row;
  }

  function show(row, channel) {
    const tone = toneOf(channel.state);
    row.state.update(channel.state, tone);
    setAttribute(row.state, "title", channel.words || null);
    setText(row.topic, channel.label);
    setText(row.type, typeName(channel.type_name) || channel.words);
    setAttribute(row.root, "data-tone", tone);
    setAttribute(row.link, "aria-current", selected() === channel.id ? "true" : null);
    setAttribute(row.root, "data-selected", selected() === channel.id ? "" : null);
    const texts = [way(channel.direction), rate(channel.rate_hz), age(channel.age_ns), count(channel.lost), count(channel.refused)];
    row.cells.forEach((cell, index) => setText(cell, texts[index]));
    setAttribute(row.cells[4], "data-more", channel.refused > 0 ? "" : null);
  }

  function update() {
    const channels = [...store.channels.values()];
    const numbers = Object.fromEntries(TONES.map(([tone]) => [tone, 0]));
    for (const channel of channels) numbers[toneOf(channel.state)] += 1;
    for (const [tone, each] of tiles) {
      setText(each.number, String(numbers[tone]));
      setAttribute(each.root, "data-none", numbers[tone] === 0 ? "" : null);
    }
    const shown = channels.filter(matches);
    shown.sort(filter.worstFirst ? bySeverity : byName);
    for (const [id, row] of rows) if (!store.channels.has(id)) { row.root.remove(); rows.delete(id); }
    place(shown);
    empty.hidden = shown.length > 0;
    if (!shown.length) setText(empty, nothing(channels.length));
    table.hidden = shown.length === 0;
  }

  function place(shown) {
    const order = new Map();
    for (const channel of shown) {
      const row = rowOf(channel.id);
      show(row, channel);
      const group = groupOf(channel);
      if (!order.has(group)) order.set(group, []);
      order.get(group).push(row.root);
    }
    for (const [key, group] of groups) if (!order.has(group)) { group.body.remove(); groups.delete(key); }
    let last = table.tHead;
    for (const [group, members] of order) {
      showGroup(group, members.length);
      // Moved only if its position differs: a row that moves loses the keyboard focus.
      if (last.nextSibling !== group.body) last.after(group.body);
      last = group.body;
      let at = group.body.firstChild;
      for (const member of members) {
        if (at.nextSibling !== member) at.after(member);
        at = member;
      }
      while (at.nextSibling) at.nextSibling.remove();
    }
  }

  function showGroup(group, members) {
    const bridge = store.bridges.find((each) => each.prefix === group.prefix && each.name === group.bridge);
    setText(group.name, group.bridge ? `Bridge ${group.bridge}` : "Without a bridge");
    const alive = bridge?.alive;
    const [word, tone] = !bridge ? ["unknown", "quiet"] : alive ? ["running", "good"] : alive === null ? ["looking", "quiet"] : bridge.pid ? ["dead", "bad"] : ["ended", "warn"];
    group.state.update(word, tone);
    const parts = [members === 1 ? "1 channel" : `${members} channels`, `prefix ${group.prefix}`];
    if (bridge?.pid) parts.push(`process ${bridge.pid}`);
    setText(group.facts, parts.join(" · "));
  }

  function matches(channel) {
    if (filter.tone && toneOf(channel.state) !== filter.tone) return false;
    return !filter.text || `${channel.label} ${channel.type_name} ${channel.state}`.toLowerCase().includes(filter.text);
  }

  function nothing(total) {
    if (total) return "No channel matches.";
    if (store.link !== "live" || !store.timeMs) return "Loading …";
    return "There are no channels on this machine. Start a bridge (rosplc run rosplc.yaml) or the demonstration (rosplc demo): they appear here automatically.";
  }

  return { root, update };
}

const byName = (a, b) => a.prefix.localeCompare(b.prefix) || a.bridge.localeCompare(b.bridge) || a.label.localeCompare(b.label, "en", { numeric: true });
const bySeverity = (a, b) => b.severity - a.severity || byName(a, b);
