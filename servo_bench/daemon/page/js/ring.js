// Rings of float64 in a fixed amount of memory.
//
// Each value is written twice, `capacity` apart, so that the last n values always lie in one piece
// and can be handed out as a view, without a copy.

export class Ring {
  constructor(capacity, columns) {
    this.capacity = capacity;
    this.columns = Array.from({ length: columns }, () => new Float64Array(2 * capacity));
    this.clear();
  }

  clear() {
    this.count = 0;
    this.head = 0; // where the next value goes, below `capacity`
  }

  /** Begin a row; `set` its columns after. */
  advance() {
    this.row = this.head;
    this.head = (this.head + 1) % this.capacity;
    this.count = Math.min(this.count + 1, this.capacity);
  }

  set(column, value) {
    const values = this.columns[column];
    values[this.row] = value;
    values[this.row + this.capacity] = value;
  }

  /** The last `count` values of a column, the oldest first; valid until the next row. */
  view(column, count = this.count) {
    const end = this.head + this.capacity;
    return this.columns[column].subarray(end - count, end);
  }
}

/** The first place in rising `values` that is not below `least`. */
export function firstFrom(values, least) {
  let [low, high] = [0, values.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < least) low = middle + 1;
    else high = middle;
  }
  return low;
}
