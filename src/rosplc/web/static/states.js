// The words for channel states, each with a tone (its colour) and a shape: colour is never the only sign.

import { el, svg } from "./dom.js";

const TONES = {
  ok: "good",
  looking: "quiet",
  "no PLC": "warn",
  "no server": "warn",
  silent: "stale",
  stale: "stale",
  lost: "warn",
  refused: "warn",
  "no bridge": "warn",
  dead: "bad",
  missing: "bad",
  unreadable: "bad",
};

const OF_LEVEL = { OK: "good", WARN: "warn", ERROR: "bad", STALE: "stale" };

const SHAPES = {
  good: ["M8 1.5a6.5 6.5 0 1 0 0 13 6.5 6.5 0 0 0 0-13z", "M4.9 8.2 7.1 10.4 11.2 5.8"],
  quiet: ["M8 1.5a6.5 6.5 0 1 0 0 13 6.5 6.5 0 0 0 0-13z", "M5 8h6"],
  stale: ["M8 1.5a6.5 6.5 0 1 0 0 13 6.5 6.5 0 0 0 0-13z", "M8 4.5V8l2.5 1.8"],
  warn: ["M8 1.3 15.2 14.2H.8z", "M8 6v4M8 11.9v.4"],
  bad: ["M5.2 1h5.6L15 5.2v5.6L10.8 15H5.2L1 10.8V5.2z", "M5.5 5.5l5 5M10.5 5.5l-5 5"],
};

/** The tone of a state's word. */
export function toneOf(state) {
  return TONES[state] ?? "quiet";
}

/** The tone of an event's level. */
export function toneOfLevel(level) {
  return OF_LEVEL[level] ?? "quiet";
}

/** The shape of a tone. */
export function shape(tone) {
  const [outline, sign] = SHAPES[tone];
  return svg(
    "svg",
    { viewBox: "0 0 16 16", class: "shape", "aria-hidden": "true", focusable: "false" },
    svg("path", { d: outline, class: "shape-body" }),
    svg("path", { d: sign, class: "shape-sign" }),
  );
}

/** A word with its tone's colour and shape; `update(word, tone)` changes it. */
export function chip(word = "", tone = "quiet") {
  const text = el("span", {}, word);
  const made = el("span", { class: `chip tone-${tone}` }, shape(tone), text);
  made.update = (newWord, newTone) => {
    if (text.textContent !== newWord) text.textContent = newWord;
    if (tone !== newTone) {
      tone = newTone;
      made.className = `chip tone-${tone}`;
      made.firstChild.replaceWith(shape(tone));
    }
  };
  return made;
}
