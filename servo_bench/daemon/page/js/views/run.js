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
    this.charts = new Map(); // by channel
    this.kernels = [];
    this.jobs = new Map(); // id to kind: the work on this run that is not known to be over
    this.playing = false;
    this.ended = "";
    this.asked = 0;
    this.askedSamples = 0;
    this.wrong = h("p", { class: "wrong", role: "alert" });
    this.working = h("p", { class: "working", role: "status" });
    this.buttons = { analyse: button("Analyse", () => this.#work("analyse")), diagnose: button("Diagnose", () => this.#work("diagnose")) };
    this.notes = new NotesCard(id);
    this.events = new EventsCard();
    this.body = h("div", {}, h("p", { class: "hint" }, "Loading …"));
    this.samples = new Map(CHANNELS.map(([channel]) => [channel, h("div")]));
    this.plots = h("section", { class: "card", "aria-label": "Samples" }, h("h2", {}, "Samples"), h("p", { class: "hint" }, "Over time / s; where many samples share a place, the least and the largest of them."), [...this.samples.values()]);
    this.element = h("article", {}, this.wrong, this.body);
    this.#load();
    this.#loadSamples();
  }

  async #load() {
    const asked = (this.asked += 1);
    const { saves } = this.notes;
    try {
      const run = await get(runPath(this.id));
      if (this.closed || asked !== this.asked) return; // a later answer is on its way
      say(this.wrong, "");
      this.#show(run);
      if (saves === this.notes.saves) this.notes.show(run);
    } catch (error) {
      if (asked !== this.asked) return;
      if (!this.places) fill(this.body);
      say(this.wrong, error.message);
    }
  }

  #show(run) {
    for (const drawn of this.kernels.splice(0)) drawn.close();
    const kernels = kernelCard(run.kernels);
    this.kernels.push(...kernels.charts);
    this.places ??= this.#layOut(); // once: what somebody is writing in the notes stays
    fill(this.places.head, head(run));
    fill(this.places.about, about(run));
    fill(this.places.links, this.#links(run));
    fill(this.places.verdict, verdictCard(run, run.has_diagnosis_page ? `/api${runPath(run.id)}/diagnosis/page` : null));
    fill(this.places.quality, qualityCard(run));
    fill(this.places.kernels, kernels.element);
    this.events.show(run);
    say(this.buttons.analyse, run.kernels ? "Analyse again" : "Analyse");
    say(this.buttons.diagnose, run.diagnosis ? "Diagnose again" : "Diagnose");
  }

  #layOut() {
    const place = () => h("div", { class: "place-of" });
    const places = { head: place(), about: place(), links: place(), verdict: place(), quality: place(), kernels: place() };
    fill(
      this.body,
      h("p", { class: "hint" }, h("a", { href: "#/runs" }, "All runs")),
      places.head,
      h("div", { class: "tools" }, places.links, this.buttons.analyse, this.buttons.diagnose),
      this.working,
      h(
        "div",
        { class: "cards" },
        h("div", { class: "side" }, h("section", { class: "card", "aria-label": "About" }, h("h2", {}, "About"), places.about), places.verdict, places.quality),
        h("div", { class: "side" }, this.notes.element, places.kernels),
      ),
      this.plots,
      this.events.element,
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

  /** A status: whether this run plays or has ended, what is done with it now, and what is no longer. */
  heard({ run, last, jobs }) {
    this.#follow(run?.id === this.id, last?.id === this.id ? last.sentence : "");
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

  /** What was read of a run that played is not true of one that is over. */
  #follow(playing, ended) {
    if (playing === this.playing && ended === this.ended) return;
    if (playing !== this.playing) this.#loadSamples();
    [this.playing, this.ended] = [playing, ended];
    this.#load();
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

  async #loadSamples() {
    const asked = (this.askedSamples += 1);
    for (const [channel, title, scale] of CHANNELS) {
      const place = this.samples.get(channel);
      try {
        const { t_s, columns } = await get(`${runPath(this.id)}/samples?${new URLSearchParams({ channels: channel, points: POINTS })}`);
        if (this.closed || asked !== this.askedSamples) return;
        this.charts.get(channel)?.close();
        const drawn = bandChart(title, t_s, columns[channel], scale);
        this.charts.set(channel, drawn);
        fill(place, drawn.figure);
      } catch (error) {
        if (!(error instanceof Problem)) throw error;
        if (error.status === 404 || asked !== this.askedSamples) return; // the run itself says so already
        fill(place, h("p", { class: "hint" }, `${title}: ${error.message}`));
      }
    }
  }

  close() {
    this.closed = true;
    for (const drawn of [...this.charts.values(), ...this.kernels]) drawn.close();
  }
}

/** What people wrote of a run. A field that somebody has changed keeps it until they save. */
class NotesCard {
  constructor(id) {
    this.id = id;
    this.saves = 0;
    this.shown = { tags: "", notes: "" };
    this.tags = h("input", { type: "text" });
    this.notes = h("textarea", { rows: "5", maxlength: "100000" });
    this.said = h("p", { class: "hint", role: "status" });
    this.element = h(
      "section",
      { class: "card", "aria-label": "Notes" },
      h("h2", {}, "Notes"),
      field("Tags", this.tags, { hint: "separated by commas" }),
      field("Notes", this.notes),
      h("div", { class: "tools" }, button("Save", () => this.#save()), this.said),
    );
  }

  show({ tags, notes }) {
    this.#put("tags", tags.join(", "));
    this.#put("notes", notes);
  }

  #put(name, text) {
    const control = this[name];
    if (control.value !== this.shown[name]) return;
    control.value = text;
    this.shown[name] = control.value; // as the control has it: with line ends of its own
  }

  async #save() {
    const written = { tags: this.tags.value, notes: this.notes.value };
    const tags = written.tags.split(",").map((tag) => tag.trim()).filter(Boolean);
    try {
      const kept = await patch(runPath(this.id), { notes: written.notes, tags });
      this.saves += 1;
      this.shown = written;
      this.show(kept);
      say(this.said, "Saved.");
    } catch (error) {
      say(this.said, error.message);
    }
  }
}

/** What happened beside the samples; open or closed as its reader left it. */
class EventsCard {
  constructor() {
    this.title = h("summary");
    this.rows = h("tbody");
    this.element = h("details", { class: "card", hidden: true }, this.title, h("div", { class: "scroll" }, h("table", {}, this.rows)));
  }

  show({ events }) {
    this.element.hidden = events.length === 0;
    say(this.title, `Events (${events.length})`);
    fill(this.rows, events.map(({ at_s, kind, text }) => h("tr", {}, h("td", { class: "numeric" }, quantity(at_s, "s", 5)), h("td", {}, kind), h("td", {}, text))));
  }
}

function head(run) {
  return [h("h1", {}, run.name || NOTHING), h("p", { class: "lead" }, h("span", { class: `ended ended-${run.state}` }, run.state), " ", run.sentence)];
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
