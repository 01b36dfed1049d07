// Arming the queue: an operator who has looked at the rig says so, with a name.

import { post } from "./api.js";
import { field, h, mark, say } from "./dom.js";
import { operator } from "./operator.js";
import { ask, button, buttons } from "./sheet.js";

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

/** Ask, then arm; whether it was done. */
export async function arm(status) {
  const name = operatorInput();
  const next = status.queue[0];
  const wrong = h("p", { class: "wrong", role: "alert" });
  const answer = await ask("Arm the queue", (done) => [
    status.fault ? h("p", { class: "fault-text" }, `Fault: ${status.fault.sentence}`) : null,
    h("p", {}, status.held_reason ? `Held: ${status.held_reason}.` : "The queue is not held."),
    h(
      "p",
      { class: "strong" },
      next
        ? `As soon as it is armed, “${next.name}” (${next.experiment}, by ${next.operator}) begins and the rig moves.`
        : "Nothing waits: the rig stays still until a run is submitted, and then moves at once.",
    ),
    h("p", {}, "Look at the rig: nobody in reach, nothing in the way, the emergency stop at hand."),
    field("Operator", name),
    wrong,
    buttons(
      button("Cancel", () => done(null)),
      button(
        "Arm: the rig is clear",
        async ({ target }) => {
          if (!operatorIn(name)) return;
          target.disabled = true;
          try {
            done(await post("/arm", { operator: operator.name }));
          } catch (error) {
            say(wrong, error.message);
            target.disabled = false;
          }
        },
        { class: "go" },
      ),
    ),
  ]);
  return answer !== null;
}
