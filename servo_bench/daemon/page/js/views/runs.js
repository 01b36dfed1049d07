// The run list: search, tags, and two runs to compare.

import { get } from "../api.js";
import { fill, h, say } from "../dom.js";
import { NOTHING, duration, number, quantity, when, words } from "../format.js";
import { button } from "../sheet.js";

const PAGE = 50;
const TYPING_MS = 200;

export function runsView() {
  const list = new RunList();
  return { title: "Runs", element: list.element, status: (status) => list.heard(status), close: () => list.close() };
}

class RunList {
  constructor() {
    this.offset = 0;
    this.tag = "";
    this.asked = 0;
    this.chosen = new Map();
    this.search = h("input", { type: "search", id: "search", placeholder: "name, notes, operator, cause …", maxlength: "200", oninput: () => this.#typed() });
    this.tagShown = button("", () => this.#filter(""), { class: "tag", hidden: true });
    this.total = h("p", { class: "hint", "aria-live": "polite" });
    this.rows = h("tbody");
    this.wrong = h("p", { class: "wrong", role: "alert" });
    this.compare = button("Compare two", () => this.#compare(), { disabled: true });
    this.newer = button("Newer", () => this.#turn(-PAGE));
    this.older = button("Older", () => this.#turn(PAGE));
    const names = ["", "Run", "Started", "Experiment", "Ended", "Length", "Missed", "VAF, fresh", "Verdict", "Tags"];
    const wide = new Set(["Experiment", "Length", "Missed"]); // left out where the screen is narrow
    const numeric = new Set(["Length", "Missed", "VAF, fresh"]);
    this.element = h(
      "section",
      { "aria-label": "Runs" },
      h("h1", {}, "Runs"),
      h("div", { class: "tools" }, h("label", { for: "search" }, "Search"), this.search, this.tagShown, this.compare, this.total),
      this.wrong,
      h("div", { class: "scroll" }, h("table", {}, h("thead", {}, h("tr", {}, names.map((name) => h("th", { scope: "col", class: `${wide.has(name) ? "wide" : ""} ${numeric.has(name) ? "numeric" : ""}` }, name)))), this.rows)),
      h("div", { class: "tools" }, this.newer, this.older),
    );
    this.#load();
  }

  heard({ last, state, jobs }) {
    const text = JSON.stringify([last, state, jobs.map(({ id }) => id)]);
    if (this.heardText !== undefined && text !== this.heardText) this.#load();
    this.heardText = text;
  }

  #typed() {
    clearTimeout(this.typing);
    this.typing = setTimeout(() => this.#from(0), TYPING_MS);
  }

  #filter(tag) {
    this.tag = tag;
    this.tagShown.hidden = tag === "";
    say(this.tagShown, `tag: ${tag} ✕`);
    this.#from(0);
  }

  #turn(by) {
    this.#from(Math.max(this.offset + by, 0));
  }

  #from(offset) {
    this.offset = offset;
    this.#load();
  }

  async #load() {
    const asked = (this.asked += 1);
    const query = new URLSearchParams({ q: this.search.value, tag: this.tag, limit: PAGE, offset: this.offset });
    try {
      const { total, runs } = await get(`/runs?${query}`);
      if (asked !== this.asked) return; // a later search was faster
      say(this.wrong, "");
      say(this.total, total ? `${this.offset + 1}–${this.offset + runs.length} of ${total}` : "No run is found.");
      fill(this.rows, runs.map((run) => this.#row(run)));
      this.newer.disabled = this.offset === 0;
      this.older.disabled = this.offset + runs.length >= total;
      for (const turn of [this.newer, this.older]) turn.hidden = this.newer.disabled && this.older.disabled;
    } catch (error) {
      say(this.wrong, error.message);
    }
  }

  #row(run) {
    const fresh = run.figures.vaf_fresh_order3_percent;
    const pick = h("input", { type: "checkbox", "aria-label": `Choose ${run.name} for a comparison`, checked: this.chosen.has(run.id) });
    if (this.chosen.has(run.id)) this.chosen.set(run.id, pick); // the box of an earlier load is gone
    pick.addEventListener("change", () => this.#pick(run.id, pick));
    return h(
      "tr",
      {},
      h("td", {}, pick),
      h("td", { class: "run-name" }, h("a", { href: `#/runs/${encodeURIComponent(run.id)}` }, run.name || NOTHING), run.notes ? h("span", { class: "hint note" }, run.notes) : null),
      h("td", { class: "nowrap" }, when(run.started_utc)),
      h("td", { class: "wide" }, run.experiment || NOTHING),
      h("td", { title: run.sentence }, h("span", { class: `ended ended-${run.state}` }, run.state)),
      h("td", { class: "numeric wide" }, duration(run.seconds)),
      h("td", { class: "numeric wide" }, number(run.missed, 9)),
      h("td", { class: "numeric" }, quantity(fresh, "%", 4)),
      h("td", { title: run.verdict ?? "not diagnosed" }, run.causes.length ? words(run.causes.join(", ")) : (run.verdict ?? NOTHING)),
      h("td", {}, run.tags.map((tag) => button(tag, () => this.#filter(tag), { class: "tag", "aria-label": `Show runs with the tag ${tag}` }))),
    );
  }

  #pick(id, box) {
    if (box.checked) this.chosen.set(id, box);
    else this.chosen.delete(id);
    if (this.chosen.size > 2) {
      const [first, itsBox] = this.chosen.entries().next().value;
      itsBox.checked = false;
      this.chosen.delete(first);
    }
    this.compare.disabled = this.chosen.size !== 2;
  }

  #compare() {
    const [a, b] = this.chosen.keys();
    location.hash = `#/compare?${new URLSearchParams({ a, b })}`;
  }

  close() {
    clearTimeout(this.typing);
  }
}
