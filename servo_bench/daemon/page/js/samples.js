// The samples that the page keeps: the last minute at 1 kHz, and what of them can be seen, in the
// units that are shown.

import { CHANNELS, SHOWN, T } from "./frames.js";
import { Envelope } from "./envelope.js";
import { Ring, firstFrom } from "./ring.js";

export const KEPT_ROWS = 65_536; // 60 s at 1 kHz; 3 MB, written twice
const COLUMNS = 1000;

export class Samples {
  constructor(window_s) {
    this.raw = new Ring(KEPT_ROWS, CHANNELS);
    this.show(window_s);
    this.last = new Float64Array(CHANNELS).fill(NaN);
    this.received = 0;
  }

  /** Slide a window of `window_s` from now on. */
  show(window_s) {
    this.window_s = window_s;
    this.seen = new Envelope(COLUMNS, window_s);
    const columns = Array.from({ length: CHANNELS }, (_, channel) => this.raw.view(channel));
    const row = new Float64Array(CHANNELS);
    for (let at = firstFrom(columns[T], this.raw.count ? columns[T].at(-1) - window_s : 0); at < this.raw.count; at += 1) {
      for (let channel = 0; channel < CHANNELS; channel += 1) row[channel] = columns[channel][at];
      this.seen.take(row, 0);
    }
  }

  /** Forget everything: something else will be shown. */
  clear() {
    this.raw.clear();
    this.seen.clear();
    this.last.fill(NaN);
  }

  /** Take the rows of a frame. */
  take(rows) {
    for (let at = 0; at < rows.length; at += CHANNELS) {
      const t_s = rows[at + T];
      // backwards or over the window: something else is shown, another run or a seek
      if (t_s < this.last[T] || t_s > this.last[T] + this.window_s) this.clear();
      this.raw.advance();
      for (let channel = 0; channel < CHANNELS; channel += 1) {
        this.last[channel] = rows[at + channel] * SHOWN[channel];
        this.raw.set(channel, this.last[channel]);
      }
      this.seen.take(this.last, 0);
      this.received += 1;
    }
  }

  /** Views of the points that can be seen up to `end_s`, one for each channel. */
  visible(end_s) {
    const points = this.seen.points;
    const all = points.view(T);
    // one point before the window, so that the line reaches its edge
    const count = all.length - Math.max(firstFrom(all, end_s - this.window_s) - 1, 0);
    return Array.from({ length: CHANNELS }, (_, channel) => points.view(channel, count));
  }
}
