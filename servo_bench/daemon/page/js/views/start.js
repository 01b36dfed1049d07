// Start a run: an experiment, checked fields, and an operator who confirms what will move.

import { get, post } from "../api.js";
import { operatorIn, operatorInput } from "../arming.js";
import { degrees, angle, duration, number, quantity, velocity } from "../format.js";
import { field, fill, h, mark, pairs, say } from "../dom.js";
import { QueuePanel } from "../queue_panel.js";
import { operator } from "../operator.js";
import { ask, button, buttons } from "../sheet.js";

export function startView(app) {
  const queue = new QueuePanel();
  const form = new StartForm(app);
  const element = h(
    "div",
    { class: "columns" },
    h("section", { "aria-label": "Start a run" }, h("h1", {}, "Start a run"), form.element),
    h("aside", { class: "side" }, queue.element),
  );
  return { title: "Start a run", element, status: (status) => queue.show(status) };
}

class StartForm {
  constructor(app) {
    this.app = app;
    this.choice = h("select", { required: true, onchange: () => this.#show() });
    this.facts = h("div", { class: "card" });
    this.name = h("input", { type: "text", maxlength: "100", placeholder: "the experiment's name" });
    this.operator = operatorInput();
    this.notes = h("textarea", { rows: "3", maxlength: "10000" });
    this.amplitude = h("input", { type: "number", min: "0", step: "any", inputmode: "decimal" });
    this.periods = h("input", { type: "number", min: "1", max: "100", step: "1", inputmode: "numeric" });
    this.standstill = h("input", { type: "number", min: "0", max: "3600", step: "any", inputmode: "decimal" });
    this.wrong = h("p", { class: "wrong", role: "alert" });
    this.submit = h("button", { type: "submit", class: "go", disabled: true }, "Check, then confirm …");
    this.element = h(
      "form",
      { novalidate: true, onsubmit: (event) => this.#submit(event) },
      field("Experiment", this.choice),
      this.facts,
      h("div", { class: "fields" }, field("Operator", this.operator), field("Name of the run", this.name)),
      h(
        "fieldset",
        {},
        h("legend", {}, "Changes to the experiment (empty: as in the file)"),
        h(
          "div",
          { class: "fields" },
          field("Amplitude", this.amplitude, { unit: "°/s" }),
          field("Periods of identification", this.periods),
          field("Standstill", this.standstill, { unit: "s" }),
        ),
      ),
      field("Notes", this.notes),
      this.wrong,
      this.submit,
    );
    this.#load();
  }

  async #load() {
    try {
      this.experiments = await get("/experiments");
    } catch (error) {
      say(this.wrong, error.message);
      return;
    }
    fill(this.choice, this.experiments.map(({ file, name }) => h("option", { value: file }, file === name ? name : `${file} (${name})`)));
    this.submit.disabled = this.experiments.length === 0;
    this.#show();
  }

  #show() {
    const chosen = this.experiments.find(({ file }) => file === this.choice.value);
    if (!chosen) return;
    fill(this.facts, movement(chosen), h("details", {}, h("summary", {}, "The file"), h("pre", {}, chosen.text)));
    this.name.placeholder = chosen.name;
  }

  /** The changes that were asked; null where a field is wrong, which then says so. */
  #overrides() {
    const { velocity_rad_s } = this.app.status?.limits ?? { velocity_rad_s: Infinity };
    const highest = degrees(velocity_rad_s);
    const rules = [
      [this.amplitude, "amplitude_deg_s", (v) => v > 0 && v <= highest, `Give more than 0 and at most ${number(highest)} °/s, the rig's limit.`],
      [this.periods, "periods", (v) => Number.isInteger(v) && v >= 1 && v <= 100, "Give a whole number from 1 to 100."],
      [this.standstill, "standstill_s", (v) => v >= 0 && v <= 3600, "Give 0 to 3600 s."],
    ];
    const overrides = {};
    let first = null;
    for (const [control, name, allowed, words] of rules) {
      const empty = control.value === "" && !control.validity.badInput;
      const value = control.valueAsNumber;
      const right = empty || allowed(value);
      mark(control, right ? "" : words);
      if (!right) first ??= control;
      else if (!empty) overrides[name] = value;
    }
    first?.focus();
    return first === null ? overrides : null;
  }

  async #submit(event) {
    event.preventDefault();
    const overrides = this.#overrides();
    if (!operatorIn(this.operator) || overrides === null) return;
    say(this.wrong, "");
    this.submit.disabled = true;
    try {
      const asked = { experiment: this.choice.value, overrides };
      const preview = await post("/preview", asked);
      const { value: name } = this.name;
      await confirmed(this.app, preview, { ...asked, name: name.trim(), notes: this.notes.value, operator: operator.name });
    } catch (error) {
      say(this.wrong, error.message);
    } finally {
      this.submit.disabled = false;
    }
  }
}

function movement({ peak_velocity_rad_s, peak_travel_rad, seconds, period_s, slots }) {
  return pairs([
    ["how fast", `up to ±${velocity(peak_velocity_rad_s)}`],
    ["how far", `up to ±${angle(peak_travel_rad)} from where it stands`],
    ["how long", `${duration(seconds)} (${number(slots, 9)} slots of ${quantity(period_s * 1e3, "ms")})`],
  ]);
}

/** Let the operator confirm what will move, then submit it. */
async function confirmed(app, preview, request) {
  const { rig } = app;
  const sure = h("input", { type: "checkbox", id: "sure" });
  const wrong = h("p", { class: "wrong", role: "alert" });
  const begins = h("p", { class: "strong", "aria-live": "polite" });
  const heard = (status) => say(begins, whenItBegins(status));
  heard(app.status);
  const send = async (done, { target }) => {
    if (!sure.checked) {
      say(wrong, "Tick the box first: a run needs somebody at the rig.");
      sure.focus();
      return;
    }
    target.disabled = true;
    try {
      done(await post("/runs", { ...request, confirm: true }));
    } catch (error) {
      say(wrong, error.message);
      target.disabled = false;
    }
  };
  const content = (done) => [
    h("p", {}, h("strong", {}, rig?.name ?? "The rig"), rig?.simulated ? " is a software rig: nothing real moves." : ": its motor shaft and load will turn, both ways."),
    movement(preview),
    begins,
    h("p", { class: "check" }, sure, h("label", { for: "sure" }, "I stand at the rig, nobody is in reach of it, and the emergency stop is at hand.")),
    wrong,
    buttons(button("Cancel", () => done(null)), button("Submit the run", (event) => send(done, event), { class: "go" })),
  ];
  const answer = await ask("Confirm: the rig will move", content, heard);
  if (answer !== null) location.hash = "#/live";
}

function whenItBegins(status) {
  if (status === null) return "It begins as soon as the daemon lets it.";
  if (status.held) return `It waits: the queue is held (${status.held_reason}). It begins when an operator arms the queue.`;
  const before = status.queue.length + (status.run === null ? 0 : 1);
  return before ? `${before} before it; then it begins by itself.` : "It begins at once.";
}
