// A smooth right edge for the sliding window.
//
// Frames come 30 times a second and not evenly; the display is drawn 60 times. The edge moves at
// the pace at which the samples' time passes, a little behind the newest, and leans towards it.

const LEAN = 0.06; // of the distance, each drawing
const PACE_MEMORY = 0.1;
const LONGEST_STEP_S = 0.25;

export class Scroll {
  constructor() {
    this.reset();
  }

  reset() {
    this.edge_s = NaN;
    this.pace = 1.0;
    this.frame = null;
  }

  /** A frame came whose newest sample is of `t_s`. */
  newest(t_s, now_s) {
    if (this.frame !== null && now_s > this.frame.now_s) {
      const pace = (t_s - this.frame.t_s) / (now_s - this.frame.now_s);
      if (pace < 0 || t_s - this.edge_s > 5 * Math.max(this.pace, 1)) this.reset();
      else this.pace += PACE_MEMORY * (pace - this.pace);
    }
    this.frame = { t_s, now_s };
    if (Number.isNaN(this.edge_s)) this.edge_s = t_s;
  }

  /** Where the edge is `elapsed_s` after it was asked last. */
  step(elapsed_s) {
    if (this.frame === null) return 0;
    const ahead = this.edge_s + Math.min(elapsed_s, LONGEST_STEP_S) * this.pace;
    this.edge_s = Math.min(ahead + LEAN * (this.frame.t_s - ahead), Math.max(this.frame.t_s, this.edge_s));
    return this.edge_s;
  }
}
