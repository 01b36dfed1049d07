// Volterra kernels as the daemon's analysis gives them: order 1 as stems, order 2 as a map.

import { COLOURS, INK, chart, line } from "./chart.js";
import { h, pairs } from "./dom.js";
import { degrees, figure, number } from "./format.js";

const SHOWN = [
  "vaf_fresh_order1_percent", "vaf_fresh_order3_percent", "vaf_same_order1_percent", "vaf_same_order3_percent",
  "noise_ceiling_percent", "energy_order1_percent", "energy_order2_percent", "energy_order3_percent",
  "polynomial", "memory", "delay_periods", "coefficient_scatter_rad_s",
];
const CELL = 11;
const NEGATIVE = [8, 48, 107];
const POSITIVE = [127, 47, 0];

/** The card of a run's kernels, and its charts, to be closed. */
export function kernelCard(kernels) {
  const card = (...children) => h("section", { class: "card", "aria-label": "Kernels" }, h("h2", {}, "Kernels"), children);
  if (!kernels) return { element: card(h("p", { class: "hint" }, "Not analysed yet.")), charts: [] };
  const rows = SHOWN.filter((name) => name in kernels).map((name) => figure(name, kernels[name]));
  if (!Array.isArray(kernels.lags_s)) return { element: card(pairs(rows)), charts: [] };
  const drawn = linearKernel(kernels);
  return { element: card(drawn.figure, quadraticKernel(kernels), pairs(rows)), charts: [drawn] };
}

/** One or two linear kernels over their lags; `extra` are further [label, values, colour]. */
export function linearKernel({ lags_s, c1_rad_s, coefficient_scatter_rad_s: scatter }, extra = [], label = "order 1") {
  const curves = [[label, c1_rad_s, COLOURS.measured], ...extra];
  const lines = curves.map(([name, , colour], index) => line(name, colour, { points: { show: true, size: 6 }, dash: index ? [6, 4] : undefined }));
  const noise = typeof scatter === "number" ? `scatter of a coefficient ±${number(degrees(scatter), 3)} °/s` : "";
  return chart({
    title: "Kernel of order 1 / °/s per chip, over the lag / ms",
    caption: [h("span", { class: "hint" }, noise)],
    lines,
    data: [lags_s.map((lag_s) => lag_s * 1e3), ...curves.map(([, values]) => values.map(degrees))],
    height: 200,
  });
}

/** The kernel of order 2 as a map: blue is negative, brown positive, white nothing. */
function quadraticKernel({ c2_rad_s: table, lags_s }) {
  if (!Array.isArray(table) || !table.length) return null;
  const size = table.length;
  const largest = Math.max(...table.flat().map(Math.abs)) || 1;
  const canvas = h("canvas", { class: "map", width: size * CELL, height: size * CELL, role: "img", "aria-label": "Kernel of order 2 over both lags" });
  const paint = canvas.getContext("2d");
  table.forEach((row, i) =>
    row.forEach((value, j) => {
      const both = i < j ? value : table[j][i]; // stored for i < j, symmetric
      const share = Math.abs(both) / largest;
      const ink = both < 0 ? NEGATIVE : POSITIVE;
      paint.fillStyle = `rgb(${ink.map((part) => Math.round(255 + (part - 255) * share)).join(" ")})`;
      paint.fillRect(j * CELL, (size - 1 - i) * CELL, CELL, CELL);
    }),
  );
  paint.strokeStyle = INK;
  paint.strokeRect(0, 0, canvas.width, canvas.height);
  const span = `0 to ${number(lags_s.at(-1) * 1e3, 4)} ms both ways`;
  return h("figure", { class: "chart" }, h("figcaption", {}, h("strong", {}, "Kernel of order 2 / °/s"), h("span", { class: "hint" }, ` largest ${number(degrees(largest), 3)} °/s (blue negative, brown positive), lags ${span}`)), canvas);
}
