// Two runs side by side: has the rig changed, where, and by how much?

import { call, get, runPath } from "../api.js";
import { field, fill, h, say } from "../dom.js";
import { NOTHING, degrees, figure, number, when, words } from "../format.js";
import { linearKernel } from "../kernel_plots.js";
import { COLOURS } from "../chart.js";

const PATIENCE_MS = 300_000; // both runs are fitted
const LISTED = 500;
const LEAST_P = 1e-9; // smaller ones say nothing more
const LARGEST_SHARE = 10; // of a value that is nearly nothing: no share says anything

export function compareView(app, query) {
  const page = new ComparePage(query.get("a") ?? "", query.get("b") ?? "");
  return { title: "Compare", element: page.element, close: () => page.close() };
}

class ComparePage {
  constructor(a, b) {
    this.charts = [];
    this.a = h("select", { required: true });
    this.b = h("select", { required: true });
    this.wrong = h("p", { class: "wrong", role: "alert" });
    this.result = h("div", { "aria-live": "polite" });
    this.submit = h("button", { type: "submit", class: "go" }, "Compare");
    this.element = h(
      "section",
      { "aria-label": "Compare two runs" },
      h("h1", {}, "Compare two runs"),
      h("form", { class: "fields pickers", onsubmit: (event) => this.#asked(event) }, field("Before (a)", this.a), field("After (b)", this.b), h("div", { class: "field" }, this.submit)),
      this.wrong,
      this.result,
    );
    this.#load(a, b);
  }

  async #load(a, b) {
    try {
      const { runs } = await get(`/runs?limit=${LISTED}`);
      const older = new Set([a, b].filter((id) => id && !runs.some((run) => run.id === id)));
      for (const id of older) runs.push(...(await this.#named(id)));
      for (const [select, chosen] of [[this.a, a], [this.b, b]]) {
        fill(select, h("option", { value: "" }, "choose a run"), runs.map(({ id, name, started_utc }) => h("option", { value: id, selected: id === chosen }, `${name}, ${when(started_utc)}`)));
      }
      if (a && b) this.#compare(a, b);
    } catch (error) {
      say(this.wrong, error.message);
    }
  }

  /** A run that the list is too short for; none, and why, where there is none. */
  async #named(id) {
    try {
      return [await get(runPath(id))];
    } catch (error) {
      say(this.wrong, error.message);
      return [];
    }
  }

  #asked(event) {
    event.preventDefault();
    const [a, b] = [this.a.value, this.b.value];
    if (!a || !b || a === b) say(this.wrong, "Choose two different runs.");
    else if (location.hash === `#/compare?a=${a}&b=${b}`) this.#compare(a, b);
    else location.hash = `#/compare?a=${a}&b=${b}`;
  }

  async #compare(a, b) {
    say(this.wrong, "");
    fill(this.result, h("p", { class: "large" }, "Both runs are being fitted; this takes some seconds …"));
    this.submit.disabled = true;
    try {
      const found = await call("GET", `/compare?${new URLSearchParams({ a, b })}`, undefined, { patience_ms: PATIENCE_MS });
      if (!this.closed) this.#show(found);
    } catch (error) {
      fill(this.result);
      say(this.wrong, error.message);
    } finally {
      this.submit.disabled = false;
    }
  }

  #show({ changed, sentences, kernels, parameters, noise, figures }) {
    for (const drawn of this.charts.splice(0)) drawn.close();
    if (kernels) {
      this.charts.push(
        linearKernel({ lags_s: kernels.lags_s, c1_rad_s: kernels.c1_a_rad_s }, [
          ["b", kernels.c1_b_rad_s, COLOURS.second],
        ], "a"),
      );
    }
    fill(
      this.result,
      h("p", { class: "large" }, changed ? "Something has changed." : "Nothing has changed that chance does not explain."),
      h("ul", {}, sentences.map((sentence) => h("li", {}, sentence))),
      this.charts.map(({ figure: drawn }) => drawn),
      kernels ? ordersTable(kernels.orders) : null,
      changesTable("The rig's numbers", parameters),
      changesTable("Noise at standstill", noise),
      figuresTable(figures),
    );
  }

  close() {
    this.closed = true;
    for (const drawn of this.charts) drawn.close();
  }
}

function table(title, names, rows) {
  if (!rows.length) return null;
  return h("section", { class: "card", "aria-label": title }, h("h2", {}, title), h("div", { class: "scroll" }, h("table", {}, h("thead", {}, h("tr", {}, names.map((name) => h("th", { scope: "col" }, name)))), h("tbody", {}, rows))));
}

function row(changed, ...cells) {
  return h("tr", { class: changed ? "changed" : "" }, cells.map((cell) => h("td", {}, cell)), h("td", {}, changed ? "changed" : "–"));
}

function changesTable(title, changes) {
  const rows = changes.map((change) => {
    const convert = change.unit === "rad" ? degrees : (value) => value;
    const unit = change.unit === "rad" ? "°" : change.unit.replace("m2", "m²");
    const shown = (value, digits = 5) => (value === null ? NOTHING : number(convert(value), digits));
    const told = change.share !== null && Math.abs(change.share) < LARGEST_SHARE;
    const share = told ? `${number(100 * change.share, 3)} %` : NOTHING;
    const what = [`${words(change.label)} / ${unit || "1"}`, h("span", { class: "hint note" }, change.where)];
    return row(change.changed, what, shown(change.a), shown(change.b), share, `${shown(change.interval_low, 3)} to ${shown(change.interval_high, 3)}`);
  });
  return table(title, ["quantity / unit", "a", "b", "b over a − 1", "difference, 95 %", ""], rows);
}

function ordersTable(orders) {
  const rows = orders.map(({ order, share, gain_share, p_value, changed }) => row(changed, `order ${order}`, `${number(100 * share, 3)} %`, changed ? `${number(100 * gain_share, 3)} %` : NOTHING, p_value < LEAST_P ? `< ${number(LEAST_P, 1)}` : number(p_value, 3)));
  return table("Kernels", ["", "change over the linear response", "of it a gain", "p", ""], rows);
}

function figuresTable(figures) {
  const rows = Object.entries(figures).map(([name, { a, b }]) => h("tr", {}, [figure(name, a)[0], figure(name, a)[1], figure(name, b)[1]].map((cell) => h("td", {}, cell))));
  return table("Main figures", ["", "a", "b"], rows);
}
