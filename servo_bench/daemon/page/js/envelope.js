// What of the samples can be seen: in each column of the plot the least and the largest value.
//
// Columns are `width_s` wide and fixed in time, so that nothing flickers while the window slides.
// A column with one row gives that row; one with more gives two points, in the order in which the
// extremes came. The cost of drawing is that of two points a column, however fast the samples come.

import { CHANNELS, T } from "./frames.js";
import { Ring } from "./ring.js";

export class Envelope {
  constructor(columns, window_s) {
    this.points = new Ring(2 * columns + 4, CHANNELS);
    this.width_s = window_s / columns;
    this.least = new Float64Array(CHANNELS);
    this.largest = new Float64Array(CHANNELS);
    this.leastCameFirst = new Uint8Array(CHANNELS);
    this.first = new Float64Array(CHANNELS);
    this.clear();
  }

  clear() {
    this.points.clear();
    this.column = null;
    this.rows = 0;
  }

  /** Take one row of `rows`, which begins at `at`. */
  take(rows, at) {
    const column = Math.floor(rows[at + T] / this.width_s);
    if (column !== this.column) {
      this.#close();
      this.column = column;
      this.rows = 0;
    }
    this.rows += 1;
    for (let channel = 1; channel < CHANNELS; channel += 1) this.#widen(channel, rows[at + channel]);
    if (this.rows === 1) for (let channel = 0; channel < CHANNELS; channel += 1) this.first[channel] = rows[at + channel];
  }

  #widen(channel, value) {
    if (this.rows === 1 || Number.isNaN(this.least[channel])) {
      this.least[channel] = value;
      this.largest[channel] = value;
      this.leastCameFirst[channel] = 1;
    } else if (value < this.least[channel]) {
      this.least[channel] = value;
      this.leastCameFirst[channel] = 0;
    } else if (value > this.largest[channel]) {
      this.largest[channel] = value;
      this.leastCameFirst[channel] = 1;
    }
  }

  #close() {
    if (this.rows === 0) return;
    if (this.rows === 1) {
      this.points.advance();
      for (let channel = 0; channel < CHANNELS; channel += 1) this.points.set(channel, this.first[channel]);
      return;
    }
    for (const [share, second] of [[0.25, 0], [0.75, 1]]) {
      this.points.advance();
      this.points.set(T, (this.column + share) * this.width_s);
      for (let channel = 1; channel < CHANNELS; channel += 1) {
        const isLeast = this.leastCameFirst[channel] !== second;
        this.points.set(channel, isLeast ? this.least[channel] : this.largest[channel]);
      }
    }
  }
}
