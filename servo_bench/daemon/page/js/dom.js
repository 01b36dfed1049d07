// Elements from values. Text becomes text nodes and nothing else: no name that came from outside
// is ever read as markup.

/** An element. `properties`: attributes; `on…` listeners; `class`; true/false for boolean ones. */
export function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined));
  return element;
}

/** Put `children` in place of what is in `element`. */
export function fill(element, ...children) {
  element.replaceChildren(...children.flat(Infinity).filter((child) => child !== null && child !== undefined));
}

/** Set the text only where it differs: an unchanged live region is not read out again. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

let numbered = 0;

/** A labelled field: the control, its label, its unit, and a place for what is wrong with it. */
export function field(label, control, { unit = "", hint = "" } = {}) {
  const id = `field-${(numbered += 1)}`;
  control.id = id;
  control.setAttribute("aria-describedby", `${id}-wrong ${id}-hint`);
  return h(
    "div",
    { class: "field" },
    h("label", { for: id }, label, unit ? h("span", { class: "unit" }, ` / ${unit}`) : null),
    control,
    h("p", { class: "hint", id: `${id}-hint` }, hint),
    h("p", { class: "wrong", id: `${id}-wrong`, "aria-live": "polite" }),
  );
}

/** Say what is wrong with a field of `field`; an empty text clears it. */
export function mark(control, wrong) {
  control.setAttribute("aria-invalid", wrong ? "true" : "false");
  say(document.getElementById(`${control.id}-wrong`), wrong);
}

/** A table of names and values, each value a text or an element. */
export function pairs(rows) {
  return h(
    "dl",
    { class: "pairs" },
    rows.map(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]),
  );
}
