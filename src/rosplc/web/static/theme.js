// The theme: light, dark, or the system's setting.

import { announce, fill, svg } from "./dom.js";

const KEY = "rosplc.theme";
const WORDS = { system: "Auto", light: "Light", dark: "Dark" };
const MEDIA = { system: "(prefers-color-scheme: dark)", light: "not all", dark: "all" };
const ORDER = ["system", "light", "dark"];

let chosen = "system";
try {
  chosen = localStorage.getItem(KEY) ?? "system";
} catch {
  // Without storage, it must be chosen again each time.
}
if (!ORDER.includes(chosen)) chosen = "system";

function apply() {
  document.getElementById("dark").media = MEDIA[chosen];
  document.dispatchEvent(new Event("themechange"));
}

const halfMoon = () => svg("svg", { viewBox: "0 0 16 16", class: "half-moon", "aria-hidden": "true" },
  svg("circle", { cx: "8", cy: "8", r: "6.2" }), svg("path", { d: "M8 1.8a6.2 6.2 0 0 1 0 12.4z" }));

/** Make the button change the theme. */
export function startTheme(button) {
  const show = () => {
    fill(button, halfMoon(), WORDS[chosen]);
    button.setAttribute("aria-label", `Colours: ${WORDS[chosen]}`);
  };
  button.addEventListener("click", () => {
    chosen = ORDER[(ORDER.indexOf(chosen) + 1) % ORDER.length];
    try {
      localStorage.setItem(KEY, chosen);
    } catch {
      // As above.
    }
    apply();
    show();
    announce(`Colours: ${WORDS[chosen]}`);
  });
  show();
}

matchMedia(MEDIA.system).addEventListener("change", apply);
apply();
