// Numbers for people: SI comes in, degrees, microseconds and percent go out, always with the unit.

export const NOTHING = "–";
const DEGREES = 180 / Math.PI;

export const degrees = (rad) => rad * DEGREES;

function known(value) {
  return typeof value === "number" && Number.isFinite(value);
}

/** `digits` significant digits without an exponent where that is readable; a true minus sign. */
export function number(value, digits = 4) {
  if (!known(value)) return NOTHING;
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text =
    size >= 1e6 || size < 1e-4
      ? value.toExponential(digits - 1)
      : value.toLocaleString("en", { maximumSignificantDigits: digits, useGrouping: false });
  return text.replaceAll("-", "−");
}

/** With so many decimals, always: what is read while it changes must not jump. */
export function steady(value, decimals) {
  if (!known(value)) return NOTHING;
  const text = value.toFixed(decimals);
  return (Number(text) === 0 ? text.replace("-", "") : text).replaceAll("-", "−");
}

export function quantity(value, unit, digits = 4) {
  return known(value) ? `${number(value, digits)} ${unit}`.trim() : NOTHING;
}

export const angle = (rad) => quantity(known(rad) ? degrees(rad) : null, "°");
export const velocity = (rad_s) => quantity(known(rad_s) ? degrees(rad_s) : null, "°/s");

/** 95 s as "1 min 35 s". */
export function duration(seconds) {
  if (!known(seconds)) return NOTHING;
  if (seconds < 60) return quantity(seconds, "s", seconds < 10 ? 2 : 3);
  const whole = Math.round(seconds);
  const [hours, minutes] = [Math.floor(whole / 3600), Math.floor((whole % 3600) / 60)];
  return hours ? `${hours} h ${minutes} min` : `${minutes} min ${whole % 60} s`;
}

/** A time that is small: µs or ms, whichever reads better. */
export function lateness(seconds) {
  if (!known(seconds)) return NOTHING;
  if (seconds === 0) return "0 µs";
  return Math.abs(seconds) < 1e-3 ? quantity(seconds * 1e6, "µs", 3) : quantity(seconds * 1e3, "ms", 3);
}

export function bytes(count) {
  if (!known(count)) return NOTHING;
  return count < 1e6 ? quantity(count / 1e3, "kB", 3) : quantity(count / 1e6, "MB", 3);
}

/** Local date and time of an ISO 8601 text; the text itself where it is no time. */
export function when(utc) {
  const date = new Date(utc);
  if (Number.isNaN(date.getTime())) return utc || NOTHING;
  const two = (part) => String(part).padStart(2, "0");
  const day = `${date.getFullYear()}-${two(date.getMonth() + 1)}-${two(date.getDate())}`;
  return `${day} ${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}`;
}

const UNITS = [
  ["_rad_s", "°/s", degrees],
  ["_rad", "°", degrees],
  ["_percent", "%", (value) => value],
  ["_nm", "N m", (value) => value],
];
const PEOPLE = /\b(coulomb|stribeck|hertz)\b/g;

/** A name of the files as people read it. */
export const words = (text) =>
  text
    .replaceAll("_", " ")
    .replace(/\bvaf\b/, "VAF")
    .replace(/\border(\d)/, "order $1")
    .replace(PEOPLE, (name) => name[0].toUpperCase() + name.slice(1));

const READERS = { rad: ["°", degrees], "rad/s": ["°/s", degrees], 1: ["", (value) => value] };

/** A parameter's name without the unit that it ends in: `gap_rad` in rad as "gap". */
export function nameOf(name, unit) {
  const endings = ["_per_", "_"].map((per) => `_${unit.toLowerCase().replaceAll("n m", "nm").replaceAll("/", per).replaceAll(" ", "_")}`);
  const ending = endings.find((text) => text !== "_" && name.endsWith(text));
  return words(ending ? name.slice(0, -ending.length) : name);
}

/** A number with the unit that came beside it; angles in degrees. */
export function inUnit(value, unit, digits = 4) {
  const [shown, convert] = READERS[unit] ?? [unit, (same) => same];
  return quantity(known(value) ? convert(value) : null, shown, digits);
}

/** Name and value of a figure as people read it, from its name in the files: unit suffix last. */
export function figure(name, value) {
  if (!known(value)) return [words(name), value === null || value === undefined ? NOTHING : String(value)];
  for (const [suffix, unit, convert] of UNITS) {
    if (name.endsWith(suffix)) return [words(name.slice(0, -suffix.length)), quantity(convert(value), unit)];
  }
  if (name.endsWith("_s")) return [words(name.slice(0, -2)), lateness(value)];
  return [words(name), number(value, 6)];
}
