// Questions to the operator. A sheet lies over the view but never over the header: the stop button
// stays in reach of finger and Tab while a question is open, which a modal dialog would not allow.

import { h, fill } from "./dom.js";

let open = null;
let hears = null;

/** Close the open sheet as if it was cancelled. */
export function closeSheet() {
  open?.(null);
}

/** Let the open sheet hear a status: what it says must be what is so when its button is pressed. */
export function tellSheet(status) {
  hears?.(status);
}

/**
 * Ask; resolves to what `done` is given, null where it was cancelled.
 *
 * `content(done)` gives the children, buttons and all; `heard(status)` is called while it is open.
 */
export function ask(title, content, heard = null) {
  closeSheet();
  const before = document.activeElement;
  const main = document.getElementById("main");
  return new Promise((resolve) => {
    const heading = h("h2", { id: "sheet-title", tabindex: "-1" }, title);
    const sheet = h("section", { class: "sheet", role: "dialog", "aria-labelledby": "sheet-title" });
    const cover = h("div", { class: "cover" }, sheet);
    const done = (answer) => {
      if (open !== done) return;
      open = hears = null;
      cover.remove();
      main.inert = false;
      if (before?.isConnected) before.focus();
      resolve(answer);
    };
    open = done;
    hears = heard;
    fill(sheet, heading, content(done));
    main.inert = true;
    main.after(cover);
    heading.focus();
  });
}

/** The row of buttons at a sheet's end. */
export function buttons(...children) {
  return h("div", { class: "buttons" }, children);
}

/** A button of a sheet or a view. */
export function button(text, onclick, properties = {}) {
  return h("button", { type: "button", onclick, ...properties }, text);
}
