// Arming the queue: an operator who has looked at the rig says so, with a name.

import { get, post } from "./api.js";
import { field, fill, h, mark, say } from "./dom.js";
import { operator } from "./operator.js";
import { ask, button, buttons } from "./sheet.js";

const READ_MS = 1000; // what has changed can be read before a press counts
const CHANGED = 409;

/** A field for the operator's name, filled with the one who was here last. */
export function operatorInput() {
  return h("input", { type: "text", maxlength: "64", required: true, autocomplete: "name", value: operator.name });
}

/** The name in a field of `operatorInput`, kept for the next time; empty, and marked, without one. */
export function operatorIn(input) {
  const name = input.value.trim();
  mark(input, name ? "" : "Say who you are: the name is kept with the run.");
  if (name) operator.name = name;
  else input.focus();
  return name;
}

/** Ask, then arm; whether it was done. The sheet follows the status, and what it showed goes along. */
export async function arm(status) {
  const name = operatorInput();
  const news = new News();
  const wrong = h("p", { class: "wrong", role: "alert" });
  const send = async (done, { target }) => {
    say(wrong, "");
    if (!operatorIn(name)) return;
    if (news.fresh) {
      say(wrong, "That was pressed just as it changed: read it again, then arm.");
      return;
    }
    target.disabled = true;
    try {
      // without a digest in the status none is sent
      done(await post("/arm", { operator: operator.name, seen: news.seen }));
    } catch (error) {
      if (error.status === CHANGED) news.show(await get("/status").catch(() => news.status));
      say(wrong, error.message);
      target.disabled = false;
    }
  };
  news.show(status);
  const answer = await ask(
    "Arm the queue",
    (done) => [
      news.element,
      h("p", {}, "Look at the rig: nobody in reach, nothing in the way, the emergency stop at hand."),
      field("Operator", name),
      wrong,
      buttons(button("Cancel", () => done(null)), button("Arm: the rig is clear", (event) => send(done, event), { class: "go" })),
    ],
    (now) => news.show(now),
  );
  return answer !== null;
}

/** What arming would do now, and whether that has changed under the operator's eyes. */
class News {
  constructor() {
    this.changed_ms = -Infinity;
    this.lines = h("div", { "aria-live": "polite" });
    this.changed = h("p", { class: "wrong", role: "alert" });
    this.element = h("div", {}, this.changed, this.lines);
  }

  get seen() {
    return this.status.arming;
  }

  /** Whether it changed so lately that a press may have been meant for what stood here before. */
  get fresh() {
    return performance.now() - this.changed_ms < READ_MS;
  }

  show(status) {
    this.status = status;
    const lines = consequences(status);
    const text = JSON.stringify([lines, status.arming]);
    if (text === this.text) return;
    if (this.text !== undefined) {
      this.changed_ms = performance.now();
      say(this.changed, "This has changed since the sheet was opened: read it again.");
    }
    this.text = text;
    fill(this.lines, lines.map(([kind, line]) => h("p", { class: kind }, line)));
  }
}

function consequences({ fault, held_reason: reason, queue: [next] }) {
  return [
    ...(fault ? [["fault-text", `Fault: ${fault.sentence}`]] : []),
    ["", reason ? `Held: ${reason}.` : "The queue is not held."],
    [
      "strong",
      next
        ? `As soon as it is armed, “${next.name}” (${next.experiment}, by ${next.operator}) begins and the rig moves.`
        : "Nothing waits: the rig stays still until a run is submitted, and then moves at once.",
    ],
  ];
}
