// One look for all plots.

import uPlot from "/vendor/uPlot.esm.js";
import { number } from "./format.js";
import { h } from "./dom.js";

export const INK = "#1b2733";
export const COLOURS = { command: "#8a94a0", measured: "#0b5394", second: "#c2570c", band: "#0b539433" };
const GRID = "#e3e7eb";
const FONT = "13px system-ui, sans-serif";

function axis(extra = {}) {
  return {
    stroke: INK,
    font: FONT,
    grid: { stroke: GRID, width: 1 },
    ticks: { stroke: GRID, width: 1, size: 4 },
    values: (_, splits) => splits.map((value) => number(value, 6)),
    ...extra,
  };
}

/** A line of a plot: what it shows, its colour; dashed lines tell apart without colour. */
export function line(label, stroke, extra = {}) {
  return { label, stroke, width: 1.5, points: { show: false }, spanGaps: false, ...extra };
}

/**
 * A plot in a figure with a caption that says quantity and unit; it follows its figure's width.
 *
 * `lines` as from `line`; `rangeY` gives [low, high]; `label` is what a screen reader reads.
 */
export function chart({ title, lines, data, height = 150, rangeX, rangeY, caption = [], showX = true, bands = [], label = title, hooks = {}, legend = lines.length > 1 }) {
  const key = lines.map((one) => {
    const swatch = h("span", { class: "swatch" });
    swatch.style.borderTopColor = one.stroke;
    swatch.style.borderTopStyle = one.dash ? "dashed" : "solid";
    return h("span", { class: "key" }, swatch, one.label);
  });
  const place = h("div", { class: "plot", role: "img", "aria-label": label });
  const figure = h("figure", { class: "chart" }, h("figcaption", {}, h("strong", {}, title), legend ? key : [], caption), place);
  const plot = new uPlot(
    {
      width: 600,
      height,
      legend: { show: false },
      cursor: { show: false },
      padding: [8, 12, showX ? 0 : 8, 0],
      scales: { x: { time: false, range: rangeX }, y: { range: rangeY } },
      axes: [axis({ show: showX, size: 30 }), axis({ size: 64, space: 20 })],
      series: [{}, ...lines],
      bands,
      hooks,
    },
    data,
    place,
  );
  const watcher = new ResizeObserver(([entry]) => {
    const width = Math.floor(entry.contentRect.width);
    if (width > 0 && width !== plot.width) plot.setSize({ width, height });
  });
  watcher.observe(place);
  const close = () => {
    watcher.disconnect();
    plot.destroy();
  };
  return { figure, plot, close };
}

/** Least and largest value of each block as a band, for whole recordings. */
export function bandChart(title, t_s, { min, max }, scale) {
  const shown = (values) => values.map((value) => (value === null ? null : value * scale));
  return chart({
    title,
    lines: [line("largest", COLOURS.measured), line("least", COLOURS.measured)],
    bands: [{ series: [1, 2], fill: COLOURS.band }],
    data: [t_s, shown(max), shown(min)],
    height: 120,
    legend: false,
  });
}
