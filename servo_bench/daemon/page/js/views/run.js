// One run: what it says, what people wrote, its kernels, its quality, its verdict.

import { Problem, get, patch, post, runPath } from "../api.js";
import { bandChart } from "../chart.js";
import { field, fill, h, pairs, say } from "../dom.js";
import { NOTHING, bytes, duration, figure, number, quantity, when } from "../format.js";
import { kernelCard } from "../kernel_plots.js";
import { button } from "../sheet.js";
import { verdictCard } from "../verdict_card.js";

const CHANNELS = [
  ["load_angle_rad", "Load angle / °", 180 / Math.PI],
  ["motor_velocity_rad_s", "Motor velocity / °/s", 180 / Math.PI],
  ["lateness_s", "Lateness of the loop / µs", 1e6],
];
const POINTS = 800;
const WORK = { analyse: "Being analysed", diagnose: "Being diagnosed" };

export function runView(app, id) {
  const page = new RunPage(id);
  return { title: "Run", element: page.element, status: (status) => page.heard(status), close: () => page.close() };
}

class RunPage {
  constructor(id) {
    this.id = id;
    this.charts = [];
    this.kernels = [];
    this.jobs = new Map(); // id to kind: the work on this run that is not known to be over
    this.wrong = h("p", { class: "wrong", role: "alert" });
    this.working = h("p", { class: "working", role: "status" });
    this.buttons = { analyse: button("Analyse", () => this.#work("analyse")), diagnose: button("Diagnose", () => this.#work("diagnose")) };
    this.body = h("div", {}, h("p", { class: "hint" }, "Loading …"));
    this.plots = h("section", { class: "card", "aria-label": "Samples" }, h("h2", {}, "Samples"), h("p", { class: "hint" }, "Over time / s; where many samples share a place, the least and the largest of them."));
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
    this.places ??= this.#layOut(run); // once: what somebody is writing in the notes stays
    fill(this.places.links, this.#links(run));
    fill(this.places.verdict, verdictCard(run, run.has_diagnosis_page ? `/api${runPath(run.id)}/diagnosis/page` : null));
    fill(this.places.quality, qualityCard(run));
    fill(this.places.kernels, kernels.element);
    say(this.buttons.analyse, run.kernels ? "Analyse again" : "Analyse");
    say(this.buttons.diagnose, run.diagnosis ? "Diagnose again" : "Diagnose");
  }

  #layOut(run) {
    const place = () => h("div", { class: "place-of" });
    const places = { links: place(), verdict: place(), quality: place(), kernels: place() };
    fill(
      this.body,
      h("p", { class: "hint" }, h("a", { href: "#/runs" }, "All runs")),
      h("h1", {}, run.name || NOTHING),
      h("p", { class: "lead" }, h("span", { class: `ended ended-${run.state}` }, run.state), " ", run.sentence),
      h("div", { class: "tools" }, places.links, this.buttons.analyse, this.buttons.diagnose),
      this.working,
      h(
        "div",
        { class: "cards" },
        h("div", { class: "side" }, h("section", { class: "card", "aria-label": "About" }, h("h2", {}, "About"), about(run)), places.verdict, places.quality),
        h("div", { class: "side" }, this.#notes(run), places.kernels),
      ),
      this.plots,
      eventsCard(run),
    );
    return places;
  }

  #links(run) {
    const path = `/api${runPath(run.id)}`;
    const link = (text, href, more = {}) => h("a", { class: "button", href, ...more }, text);
    const outside = { target: "_blank", rel: "noopener" };
    return [
      run.has_report ? link("Open the report", `${path}/report`, outside) : null,
      link(`Recording, ${bytes(run.bytes)}`, `${path}/recording`, { download: true }),
      link("Replay", `#/replay/${encodeURIComponent(run.id)}`),
      link("Compare with …", `#/compare?a=${encodeURIComponent(run.id)}`),
    ];
  }

  async #work(kind) {
    this.buttons[kind].disabled = true;
    try {
      const { job } = await post(`${runPath(this.id)}/${kind}`);
      this.jobs.set(job, kind);
      this.#tell(`${WORK[kind]} …`);
    } catch (error) {
      this.buttons[kind].disabled = false;
      this.#tell(error.message, true);
    }
  }

  /** A status: what is done with this run now, and what is no longer. */
  heard({ jobs }) {
    const mine = jobs.filter(({ run }) => run === this.id);
    for (const { id, kind } of mine) {
      this.jobs.set(id, kind);
      this.buttons[kind].disabled = true;
    }
    if (mine.length) this.#tell(mine.map(({ kind, state, progress }) => `${WORK[kind]}: ${state === "waiting" ? "waits for its turn" : progress || "begins"} …`).join(" "));
    for (const id of this.jobs.keys()) {
      if (!mine.some((job) => job.id === id)) this.#ask(id);
    }
  }

  /** A job that no status has any more: over, or so new that the status did not know it. */
  async #ask(id) {
    const kind = this.jobs.get(id);
    this.jobs.delete(id);
    try {
      const { state, sentence } = await get(`/jobs/${encodeURIComponent(id)}`);
      if (this.closed) return;
      if (state === "waiting" || state === "running") {
        this.jobs.set(id, kind);
        return;
      }
      await this.#load();
      this.#tell(sentence, state === "failed");
    } catch (error) {
      this.#tell(error.message, true);
    }
    this.buttons[kind].disabled = false;
  }

  #tell(text, wrong = false) {
    this.working.classList.toggle("wrong", wrong);
    say(this.working, text);
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
        const drawn = bandChart(title, t_s, columns[channel], scale);
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
