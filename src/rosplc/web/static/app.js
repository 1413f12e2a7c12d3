// The page: the open view, the data requested for it, and the state of the connection to the server.

import { channelList } from "./channels.js";
import { connect, reconnect, want } from "./connection.js";
import { channelDetail } from "./detail.js";
import { el, fill, setAttribute, setText } from "./dom.js";
import { announceEvents, eventList, eventsView } from "./events.js";
import { Plots, plotsView } from "./plots.js";
import { store } from "./store.js";
import { startTheme } from "./theme.js";
import { keep, takeFromAddress, token } from "./token.js";

const byId = (id) => document.getElementById(id);
const main = byId("main");
const plots = new Plots();
let view = null; // {name, id, close()}
let unread = 0;

function route() {
  const [, name, id] = /^#\/(\w+)(?:\/(.+))?$/.exec(location.hash) ?? [null, "channels", undefined];
  return { name: ["channels", "plots", "events"].includes(name) ? name : "channels", id: id ? decoded(id) : null };
}

function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

function show() {
  const next = route();
  const moved = view !== null;
  if (view?.name !== next.name) {
    view?.close();
    view = { name: next.name, id: null, close: () => {} };
    if (next.name === "channels") openChannels();
    else open(next.name === "plots" ? plotsView(plots) : eventsView());
  }
  if (next.name === "channels") view.select(next.id, moved);
  if (next.name === "events") unread = 0;
  for (const link of document.querySelectorAll(".views a")) {
    setAttribute(link, "aria-current", link.dataset.view === next.name ? "page" : null);
  }
  showCounts();
  say();
}

function open(made) {
  fill(main, made.root);
  view.close = made.close;
}

function openChannels() {
  const stop = new AbortController();
  let detail = null;
  let selected = null;
  const list = channelList(() => selected);
  const latest = eventList(() => true, { limit: 60 });
  const side = el("section", { class: "panel side", "aria-labelledby": "latest-title" },
    el("div", { class: "panel-head" }, el("h2", { id: "latest-title" }, "Latest events")),
    el("div", { class: "scroll", tabindex: "0", role: "group", "aria-labelledby": "latest-title" }, latest.root));
  const root = el("div", { class: "split" }, list.root, side);
  fill(main, root);
  store.on("channels", list.update, stop.signal);
  store.on("link", list.update, stop.signal);
  store.on("hello", () => { list.update(); latest.update(true); }, stop.signal);
  store.on("events", () => latest.update(), stop.signal);
  latest.update();
  list.update();
  view.close = () => { stop.abort(); detail?.close(); };
  view.select = (id, moved) => {
    view.id = id;
    if (selected === id) return;
    const left = selected;
    selected = id;
    detail?.close();
    detail = id === null ? null : channelDetail(id, plots);
    root.lastChild.replaceWith(detail?.root ?? side);
    setAttribute(root, "data-open", id === null ? null : "");
    list.update();
    if (moved && detail) detail.title.focus({ preventScroll: true });
    else if (left !== null) root.querySelector(`a[href="${CSS.escape(`#/channels/${encodeURIComponent(left)}`)}"]`)?.focus();
  };
}

function say() {
  want(view?.id ? [view.id] : [], plots.wanted());
}

function showCounts() {
  const fields = byId("plot-count");
  fields.hidden = !plots.fields.length;
  setText(fields, String(plots.fields.length));
  const events = byId("event-count");
  events.hidden = !unread;
  setText(events, unread > 99 ? "99+" : String(unread));
  setAttribute(events, "aria-label", unread ? `${unread} new problems` : null);
}

const LINKS = {
  connecting: "Connecting …",
  live: "Live",
  lost: "No connection",
  locked: "Token needed",
};

function showLink() {
  setText(byId("link-text"), LINKS[store.link]);
  document.documentElement.dataset.link = store.link;
  document.title = store.hello ? `rosplc ${store.hello.machine}` : "rosplc";
  setText(byId("machine"), store.hello?.machine ?? "");
  showBanner();
}

function showBanner() {
  const banner = byId("banner");
  const texts = [];
  if (store.link === "lost") texts.push("The server is not responding. The page shows the last values and reconnects automatically.");
  if (store.failure) texts.push(store.failure);
  texts.push(...store.notes);
  banner.hidden = !texts.length;
  setText(banner, texts.join(" "));
}

function refused(error) {
  if (error.code !== "WEB005") {
    store.failure = `${error.what}. ${error.remedy}`;
    showBanner();
    return;
  }
  store.setLink("locked");
  const field = el("input", { type: "password", class: "input", id: "view-token", autocomplete: "off" });
  const form = el("form", { class: "panel unlock", onsubmit: (event) => {
    event.preventDefault();
    keep(field.value.trim());
    view = null;
    store.setLink("connecting");
    show();
    reconnect();
  } },
  el("h1", {}, "A token is needed"),
  // The heading already shows that a token is needed, but not why a given token was refused.
  el("p", {}, token() ? `${error.what}. ${error.remedy}` : error.remedy),
  el("div", { class: "form-row" }, el("label", { for: "view-token" }, "Token"), field, el("button", { class: "button primary", type: "submit" }, "Open")));
  view?.close();
  view = null;
  fill(main, form);
  field.focus();
}

takeFromAddress();
startTheme(byId("theme"));
byId("skip").addEventListener("click", (event) => {
  event.preventDefault();
  main.focus();
});
store.on("link", showLink);
store.on("hello", showLink);
store.on("notes", showBanner);
store.on("refused", refused);
store.on("plots", () => { showCounts(); say(); });
store.on("events", (events) => {
  if (view?.name !== "events") unread += events.filter((event) => event.level === "ERROR" || event.level === "STALE" || event.level === "WARN").length;
  showCounts();
  announceEvents(events);
});
addEventListener("hashchange", show);
show();
showLink();
connect();
