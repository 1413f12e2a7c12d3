// A list of numbers as a small curve in its row, such as a scan or a set of joints.

import { el, svg } from "./dom.js";

const WIDTH = 160;
const HEIGHT = 22;

/** Make the curve; `draw(items)` shows other numbers. */
export function profile(label) {
  const line = svg("path", { class: "profile-line" });
  const area = svg("path", { class: "profile-area" });
  const root = el("span", { class: "profile" },
    svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", role: "img", "aria-label": label }, area, line));
  return {
    root,
    draw(items) {
      const numbers = items.filter((item) => typeof item === "number");
      if (numbers.length < 2) {
        line.setAttribute("d", "");
        area.setAttribute("d", "");
        return;
      }
      const low = Math.min(...numbers, 0);
      const high = Math.max(...numbers, 0);
      const scale = high > low ? (HEIGHT - 3) / (high - low) : 0;
      const step = WIDTH / (numbers.length - 1);
      const points = numbers.map((number, index) => `${(index * step).toFixed(1)} ${(HEIGHT - 1.5 - (number - low) * scale).toFixed(1)}`);
      const zero = (HEIGHT - 1.5 + low * scale).toFixed(1);
      line.setAttribute("d", `M${points.join("L")}`);
      area.setAttribute("d", `M0 ${zero}L${points.join("L")}L${WIDTH} ${zero}Z`);
    },
  };
}
