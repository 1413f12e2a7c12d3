// A small curve of a rate over the last minutes.

import { setAttribute, svg } from "./dom.js";
import { rate } from "./format.js";

const WIDTH = 240;
const HEIGHT = 44;

/** Make the curve; `draw(rates)` shows newer ones, oldest first. */
export function sparkline(label) {
  const line = svg("path", { class: "spark-line" });
  const area = svg("path", { class: "spark-area" });
  const root = svg("svg", { class: "spark", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none", role: "img", "aria-label": label }, area, line);
  return {
    root,
    draw(rates) {
      const known = rates.filter((each) => each !== null);
      if (known.length < 2) return;
      const high = Math.max(...known, 1e-9) * 1.15;
      const step = WIDTH / 239;
      const start = WIDTH - step * (rates.length - 1);
      const points = rates
        .map((each, index) => (each === null ? null : `${(start + index * step).toFixed(1)} ${(HEIGHT - 2 - (each / high) * (HEIGHT - 4)).toFixed(1)}`))
        .filter(Boolean);
      line.setAttribute("d", `M${points.join("L")}`);
      const left = points[0].split(" ")[0];
      area.setAttribute("d", `M${left} ${HEIGHT}L${points.join("L")}L${WIDTH} ${HEIGHT}Z`);
      setAttribute(root, "aria-label", `${label}: now ${rate(known[known.length - 1])}, at most ${rate(Math.max(...known))}`);
    },
  };
}
