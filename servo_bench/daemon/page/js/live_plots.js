// The four live plots. Each drawing costs the same, however fast the samples come.

import { COLOURS, chart, line } from "./chart.js";
import { COMMAND, CURRENT, LATENESS, LOAD_ANGLE, T, VELOCITY } from "./frames.js";
import { NOTHING, steady as decimals } from "./format.js";
import { SteadyRange, extent } from "./range.js";
import { Scroll } from "./scroll.js";
import { h, say } from "./dom.js";

const PLOTS = [
  {
    title: "Velocity / °/s",
    height: 132,
    decimals: 1,
    range: [2, null],
    lines: [
      [COMMAND, line("command", COLOURS.second, { width: 1 })],
      [VELOCITY, line("motor, measured", COLOURS.measured)],
    ],
  },
  { title: "Load angle / °", decimals: 2, range: [0.2, null], lines: [[LOAD_ANGLE, line("load", COLOURS.measured)]] },
  { title: "Motor current / A", decimals: 3, range: [0.1, null], lines: [[CURRENT, line("current", COLOURS.measured)]] },
  { title: "Lateness of the loop / µs", decimals: 0, range: [100, 0], lines: [[LATENESS, line("lateness", COLOURS.measured)]] },
];
const NUMBERS_EVERY_S = 0.1;

/** Plots of `samples`, drawn with the display until `close`; `figures` is what goes on the page. */
export class LivePlots {
  constructor(samples) {
    this.samples = samples;
    this.scroll = new Scroll();
    this.window = [0, samples.window_s];
    this.plots = PLOTS.map((what, index) => this.#plot(what, index === PLOTS.length - 1));
    this.figures = this.plots.map(({ figure }) => figure);
    this.drawn_ms = performance.now();
    this.numbers_ms = 0;
    this.plays = true;
    this.drawing = requestAnimationFrame((now_ms) => this.#draw(now_ms));
  }

  #plot({ title, lines, range, decimals: digits, height = 84 }, last) {
    const steady = new SteadyRange(...range);
    const numbers = lines.map(() => h("span", { class: "now" }));
    if (lines.length > 1) lines.forEach(([, drawn], index) => (numbers[index].style.color = drawn.stroke));
    const made = chart({
      title,
      height: height + (last ? 24 : 0),
      lines: lines.map(([, drawn]) => drawn),
      caption: [last ? h("span", { class: "hint" }, "over time / s") : null, h("span", { class: "nows" }, numbers)],
      data: [[], ...lines.map(() => [])],
      showX: last,
      rangeX: () => this.window,
      rangeY: () => steady.range,
      label: `${title}, live`,
    });
    return { ...made, lines, steady, numbers, digits };
  }

  /** A frame was taken. */
  took() {
    this.scroll.newest(this.samples.last[T], performance.now() / 1e3);
  }

  /** Whether something plays: the last numbers of what is over would look like the rig's. */
  show(plays) {
    if (plays === this.plays) return;
    this.plays = plays;
    this.#sayNumbers();
  }

  #draw(now_ms) {
    this.drawing = requestAnimationFrame((next_ms) => this.#draw(next_ms));
    const edge_s = this.scroll.step(Math.max(now_ms - this.drawn_ms, 0) / 1e3);
    this.drawn_ms = now_ms;
    const state = `${edge_s} ${this.samples.received} ${this.samples.window_s}`;
    if (state === this.state) return; // nothing moves: nothing is drawn
    this.state = state;
    const end_s = Math.max(edge_s, this.samples.window_s);
    this.window = [end_s - this.samples.window_s, end_s];
    const views = this.samples.visible(end_s);
    for (const { plot, lines, steady } of this.plots) {
      const shown = lines.map(([channel]) => views[channel]);
      steady.of(extent(shown));
      plot.setData([views[T], ...shown]);
    }
    if (now_ms - this.numbers_ms > NUMBERS_EVERY_S * 1e3) {
      this.numbers_ms = now_ms;
      this.#sayNumbers();
    }
  }

  #sayNumbers() {
    for (const { lines, numbers, digits } of this.plots) {
      lines.forEach(([channel], index) => say(numbers[index], this.plays ? decimals(this.samples.last[channel], digits) : NOTHING));
    }
  }

  close() {
    cancelAnimationFrame(this.drawing);
    for (const plot of this.plots) plot.close();
  }
}
