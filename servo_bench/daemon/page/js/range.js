// A vertical range that holds still: it grows when the data leave it and shrinks only when they
// fill little of it, always to round numbers.

const FILLED_LEAST = 0.3;
const MARGIN = 0.08;

/** The least and largest finite value of some arrays; null where there is none. */
export function extent(arrays) {
  let [least, largest] = [Infinity, -Infinity];
  for (const values of arrays) {
    for (let at = 0; at < values.length; at += 1) {
      const value = values[at];
      if (value < least) least = value;
      if (value > largest) largest = value;
    }
  }
  return least <= largest ? [least, largest] : null;
}

/** The smallest of 1, 2, 5 times a power of ten that is not below `size`. */
export function round125(size) {
  const power = 10 ** Math.floor(Math.log10(size));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= size * (1 - 1e-9));
}

export class SteadyRange {
  /** `smallest` is the least span; `floor` a value that is always in the range, or null. */
  constructor(smallest, floor = null) {
    this.smallest = smallest;
    this.floor = floor;
    this.range = [floor ?? -smallest / 2, (floor ?? -smallest / 2) + smallest];
  }

  /** The range for data that reach over `seen`, [least, largest] or null. */
  of(seen) {
    if (seen === null) return this.range;
    const least = this.floor === null ? seen[0] : Math.min(seen[0], this.floor);
    const [low, high] = this.range;
    const span = seen[1] - least;
    const fits = least >= low && seen[1] <= high;
    if (!fits || (span < FILLED_LEAST * (high - low) && high - low > 1.01 * this.smallest)) {
      const step = round125(Math.max(span, this.smallest) / 5);
      const margin = MARGIN * span;
      const bottom = this.floor !== null && least >= this.floor ? this.floor : Math.floor((least - margin) / step) * step;
      const top = Math.ceil((seen[1] + margin) / step) * step;
      this.range = [bottom, Math.max(top, bottom + this.smallest)];
    }
    return this.range;
  }
}
