// Writing one test message: the form, the confirmation, and the result.

import { announce, el, fill, setText } from "./dom.js";
import { way } from "./format.js";
import { input, isFinite, lines } from "./inputs.js";
import { store } from "./store.js";
import { ask, keep, token } from "./token.js";

const SHOWN = 200;

/** Make the form for a channel's test message from the server's description of its type. */
export function writeForm(id, { form, layout, initial }) {
  const inputs = input(form, "", "");
  const initialise = () => inputs.set(initial);
  initialise();
  const result = el("p", { class: "result", role: "status" });
  const key = el("input", { type: "password", class: "input", id: "write-token", autocomplete: "off", value: token() });
  const send = el("button", { type: "submit", class: "button primary" }, "Write the test message …");
  const take = el("button", { type: "button", class: "button", onclick: () => {
    const message = store.messages.get(id);
    if (message?.values) inputs.set(message.values);
    setText(result, message?.values ? "The form contains the newest message." : "There is no message to use.");
  } }, "Use the newest message");
  const reset = el("button", { type: "button", class: "button", onclick: () => { initialise(); setText(result, "The form contains the initial values."); } }, "Initial values");
  const question = dialog((message) => write(message));

  const root = el("details", { class: "write" },
    el("summary", {}, "Write a test message"),
    el("form", { novalidate: true, onsubmit: (event) => { event.preventDefault(); askFirst(); } },
      el("p", { class: "hint" }, "The message is written once, if nothing else writes to this channel. The reader acts on it as on any other message."),
      el("div", { class: "tools" }, take, reset),
      inputs.root,
      el("div", { class: "form-row" }, el("label", { for: "write-token" }, "Token"), key, el("span", { class: "hint" }, "printed by the server when it started, or in its token file")),
      el("div", { class: "tools" }, send),
      result),
    question.root);

  function show(text, tone) {
    result.className = `result tone-${tone}`;
    setText(result, text);
  }

  function askFirst() {
    const faults = inputs.check();
    if (faults.length) {
      show(faults.length === 1 ? "One value does not fit." : `${faults.length} values do not fit.`, "bad");
      faults[0].focus();
      return;
    }
    if (!key.value) {
      show("A token is needed to write.", "bad");
      key.focus();
      return;
    }
    const channel = store.channels.get(id);
    const message = inputs.get();
    question.open(channel?.label ?? id, way(channel?.direction), message, isFinite(form, message));
  }

  async function write(message) {
    keep(key.value.trim());
    send.disabled = true;
    show("Writing …", "quiet");
    try {
      const answer = await ask("/api/write", { channel: id, layout, message, not_finite: !isFinite(form, message) });
      show(`Written as message number ${answer.sequence}.`, "good");
    } catch (error) {
      const field = error.code === "LAY006" ? inputs.at(error.where) : null;
      field?.complain(error.what);
      field?.focus();
      show(`Not written: ${error.what}${error.code ? ` (${error.code})` : ""}. ${error.remedy}`, "bad");
      announce(result.textContent);
    } finally {
      send.disabled = false;
    }
  }

  return root;
}

/** A confirmation dialog, because a machine may move. */
function dialog(yes) {
  const title = el("h2", { id: "write-title" });
  const values = el("pre", { class: "values", tabindex: "0", "aria-label": "The values" });
  const warning = el("p", { class: "tone-bad" }, "The message contains numbers that are not finite (nan, inf). A PLC program calculates with them as with any other number.");
  let message = null;
  const close = el("button", { type: "button", class: "button", onclick: () => root.close() }, "Do not write");
  const root = el("dialog", { class: "dialog", "aria-labelledby": "write-title" },
    title,
    el("p", {}, "The reader of this channel acts on the message: a machine may move. Is everybody at a safe distance?"),
    values, warning,
    el("div", { class: "tools" }, close, el("button", { type: "button", class: "button danger", onclick: () => { root.close(); yes(message); } }, "Write now")));
  return {
    root,
    open(topic, direction, given, finite) {
      message = given;
      const all = lines(given);
      setText(values, [...all.slice(0, SHOWN), ...(all.length > SHOWN ? [`… and ${all.length - SHOWN} more`] : [])].join("\n"));
      warning.hidden = finite;
      fill(title, `Write to ${topic}, ${direction}?`);
      root.showModal();
      close.focus();
    },
  };
}
