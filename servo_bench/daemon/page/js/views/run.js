// One run: what it says, what people wrote, its kernels, its quality, its verdict.

import { Problem, get, patch, post, runPath } from "../api.js";
import { bandChart } from "../chart.js";
import { field, fill, h, pairs, say } from "../dom.js";
import { NOTHING, bytes, duration, figure, number, quantity, when } from "../format.js";
import { kernelCard } from "../kernel_plots.js";
import { button } from "../sheet.js";

const CHANNELS = [
  ["load_angle_rad", "Load angle / °", 180 / Math.PI],
  ["motor_velocity_rad_s", "Motor velocity / °/s", 180 / Math.PI],
  ["lateness_s", "Lateness of the loop / µs", 1e6],
];
const POINTS = 800;
const LOOK_EVERY_MS = 500;

export function runView(app, id) {
  const page = new RunPage(id);
  return { title: "Run", element: page.element, close: () => page.close() };
}

class RunPage {
  constructor(id) {
    this.id = id;
    this.charts = [];
    this.kernels = [];
    this.wrong = h("p", { class: "wrong", role: "alert" });
    this.working = h("p", { class: "hint", "aria-live": "polite" });
    this.body = h("div", {}, h("p", { class: "hint" }, "Loading …"));
    this.plots = h("section", { class: "card", "aria-label": "Samples" }, h("h2", {}, "Samples"));
    this.element = h("article", {}, this.wrong, this.body);
    this.#load();
    this.#loadSamples();
  }

  async #load() {
    try {
      const run = await get(runPath(this.id));
      if (!this.closed) this.#show(run);
    } catch (error) {
      fill(this.body);
      say(this.wrong, error.message);
    }
  }

  #show(run) {
    for (const drawn of this.kernels.splice(0)) drawn.close();
    const kernels = kernelCard(run.kernels);
    this.kernels.push(...kernels.charts);
    fill(
      this.body,
      h("p", { class: "hint" }, h("a", { href: "#/runs" }, "All runs")),
      h("h1", {}, run.name || NOTHING),
      h("p", { class: "lead" }, h("span", { class: `ended ended-${run.state}` }, run.state), " ", run.sentence),
      this.#actions(run),
      h(
        "div",
        { class: "cards" },
        h("section", { class: "card", "aria-label": "About" }, h("h2", {}, "About"), about(run)),
        this.#notes(run),
        verdictCard(run),
        kernels.element,
        qualityCard(run),
      ),
      this.plots,
      eventsCard(run),
    );
  }

  #actions(run) {
    const path = `/api${runPath(run.id)}`;
    return h(
      "div",
      { class: "tools" },
      run.has_report ? h("a", { class: "button", href: `${path}/report`, target: "_blank", rel: "noopener" }, "Open the report") : null,
      h("a", { class: "button", href: `${path}/recording`, download: true }, `Recording, ${bytes(run.bytes)}`),
      h("a", { class: "button", href: `#/replay/${encodeURIComponent(run.id)}` }, "Replay"),
      h("a", { class: "button", href: `#/compare?a=${encodeURIComponent(run.id)}` }, "Compare with …"),
      button(run.kernels ? "Analyse again" : "Analyse", ({ target }) => this.#analyse(target)),
      this.working,
    );
  }

  async #analyse(control) {
    control.disabled = true;
    try {
      const { job } = await post(`${runPath(this.id)}/analyse`);
      say(this.working, "Being analysed …");
      const ended = await this.#jobEnded(job);
      if (ended === null) return;
      say(this.working, ended.sentence);
      await this.#load();
    } catch (error) {
      say(this.working, error.message);
    } finally {
      control.disabled = false;
    }
  }

  /** The job when it is over; null where this page was left meanwhile. */
  async #jobEnded(job) {
    while (!this.closed) {
      const said = await get(`/jobs/${encodeURIComponent(job)}`);
      if (said.state === "done" || said.state === "failed") return said;
      await new Promise((done) => setTimeout(done, LOOK_EVERY_MS));
    }
    return null;
  }

  #notes(run) {
    const tags = h("input", { type: "text", value: run.tags.join(", ") });
    const notes = h("textarea", { rows: "5", maxlength: "100000" });
    notes.value = run.notes;
    const said = h("p", { class: "hint", role: "status" });
    const save = async () => {
      const list = tags.value.split(",").map((tag) => tag.trim()).filter(Boolean);
      try {
        const kept = await patch(runPath(run.id), { notes: notes.value, tags: list });
        tags.value = kept.tags.join(", ");
        say(said, "Saved.");
      } catch (error) {
        say(said, error.message);
      }
    };
    return h("section", { class: "card", "aria-label": "Notes" }, h("h2", {}, "Notes"), field("Tags", tags, { hint: "separated by commas" }), field("Notes", notes), h("div", { class: "tools" }, button("Save", save), said));
  }

  async #loadSamples() {
    for (const [channel, title, scale] of CHANNELS) {
      try {
        const { t_s, columns } = await get(`${runPath(this.id)}/samples?${new URLSearchParams({ channels: channel, points: POINTS })}`);
        if (this.closed) return;
        const drawn = bandChart(`${title}, least and largest over ${number(t_s.length, 9)} blocks`, t_s, columns[channel], scale);
        this.charts.push(drawn);
        this.plots.append(drawn.figure);
      } catch (error) {
        if (!(error instanceof Problem)) throw error;
        if (error.status === 404) return; // the run itself says so already
        this.plots.append(h("p", { class: "hint" }, `${title}: ${error.message}`));
      }
    }
  }

  close() {
    this.closed = true;
    for (const drawn of [...this.charts, ...this.kernels]) drawn.close();
  }
}

function about(run) {
  return pairs([
    ["experiment", run.experiment || NOTHING],
    ["rig", run.rig || NOTHING],
    ["operator", run.operator || NOTHING],
    ["started", when(run.started_utc)],
    ["length", duration(run.seconds)],
    ["missed slots", number(run.missed, 9)],
  ]);
}

function verdictCard({ diagnosis, verdict }) {
  const card = (...children) => h("section", { class: "card", "aria-label": "Verdict" }, h("h2", {}, "Verdict"), children);
  if (!diagnosis) return card(h("p", { class: "hint" }, "Not diagnosed yet: servo-bench diagnose on the recording writes a verdict beside it."));
  const causes = Array.isArray(diagnosis.causes) ? diagnosis.causes : [];
  return card(
    h("p", { class: "large" }, verdict ?? NOTHING),
    h("p", {}, String(diagnosis.sentence ?? "")),
    causes.map((cause) =>
      h(
        "div",
        {},
        h("h3", {}, `${cause.effect}, confidence ${quantity(100 * cause.confidence, "%", 3)}`),
        pairs(
          Object.entries(cause.parameters ?? {}).map(([name, { value, unit, ci95 }]) => [
            name,
            `${quantity(value, unit)}${ci95 ? ` (95 %: ${number(ci95[0])} to ${number(ci95[1])})` : ""}`,
          ]),
        ),
      ),
    ),
  );
}

function qualityCard({ quality, sentences }) {
  const flags = sentences.length ? h("ul", {}, sentences.map((sentence) => h("li", {}, sentence))) : null;
  const rows = Object.entries(quality ?? {}).filter(([, value]) => typeof value !== "object" || value === null);
  return h(
    "section",
    { class: "card", "aria-label": "Quality" },
    h("h2", {}, "Quality of the run"),
    quality ? [flags ?? h("p", {}, "Nothing to remark."), pairs(rows.map(([name, value]) => figure(name, value)))] : h("p", { class: "hint" }, "Not analysed yet."),
  );
}

function eventsCard({ events }) {
  if (!events.length) return null;
  const rows = events.map(({ at_s, kind, text }) => h("tr", {}, h("td", { class: "numeric" }, quantity(at_s, "s", 5)), h("td", {}, kind), h("td", {}, text)));
  return h("details", { class: "card" }, h("summary", {}, `Events (${events.length})`), h("div", { class: "scroll" }, h("table", {}, h("tbody", {}, rows))));
}
