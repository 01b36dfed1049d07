// Binary frames of samples, little-endian: uint32 magic, rows, channels, 0; then rows × channels
// float64, row by row.

export const T = 0;
export const COMMAND = 1;
export const VELOCITY = 2;
export const LOAD_ANGLE = 3;
export const CURRENT = 4;
export const LATENESS = 5;
export const CHANNELS = 6;

/** From SI to what is shown: s, °/s, °/s, °, A, µs. */
export const SHOWN = [1, 180 / Math.PI, 180 / Math.PI, 180 / Math.PI, 1, 1e6];

const MAGIC = 0x53424c56;
const HEAD_BYTES = 16;

/** The rows of a frame as one flat Float64Array; null for bytes that are no such frame. */
export function rowsOf(buffer) {
  if (buffer.byteLength < HEAD_BYTES) return null;
  const head = new DataView(buffer, 0, HEAD_BYTES);
  const [magic, rows, channels] = [0, 4, 8].map((at) => head.getUint32(at, true));
  if (magic !== MAGIC || channels !== CHANNELS) return null;
  if (buffer.byteLength !== HEAD_BYTES + rows * channels * 8) return null;
  return new Float64Array(buffer, HEAD_BYTES); // every browser's machine is little-endian
}
