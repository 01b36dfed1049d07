// Replay of a recording: speed, seek, pause. What it shows comes as the live samples do.

import { T } from "./frames.js";
import { get, post, remove, runPath } from "./api.js";
import { h, say } from "./dom.js";
import { steady } from "./format.js";
import { button } from "./sheet.js";

const SPEEDS = [0.1, 0.5, 1, 2, 5, 10, 100, 1000];
const LOOK_EVERY_MS = 100;

export class ReplayBar {
  /** `run`: the recording to begin with; without one the bar shows what another page replays. */
  constructor(app, run = null) {
    this.app = app;
    this.run = run;
    this.wanted = run !== null;
    this.seconds = 0;
    this.playing = false;
    this.speed = h("select", { "aria-label": "Speed", onchange: () => this.#again() }, SPEEDS.map((speed) => h("option", { value: speed, selected: speed === 1 }, speed === 1000 ? "fastest" : `${speed}×`)));
    this.seek = h("input", {
      type: "range", min: "0", max: "1", step: "0.01", value: "0", "aria-label": "Position in the recording, seconds",
      onpointerdown: () => (this.held = true),
      onpointerup: () => (this.held = false),
      onchange: () => this.#play(Number(this.seek.value)),
    });
    this.place = h("output", { class: "place" });
    this.toggle = button("Pause", () => this.#toggle());
    this.name = h("a", { class: "replay-name" }, "Replay");
    this.wrong = h("p", { class: "wrong", role: "alert" });
    this.element = h(
      "section",
      { class: "replay", "aria-label": "Replay" },
      h("p", { class: "replay-head" }, h("strong", {}, "REPLAY, not the rig: "), this.name),
      h("div", { class: "tools" }, this.toggle, this.seek, this.place, this.speed, button("End replay", () => this.#end())),
      this.wrong,
    );
    this.element.hidden = !this.wanted;
    this.timer = setInterval(() => this.#follow(), LOOK_EVERY_MS);
    if (run !== null) this.#know(run).then(() => this.#play(0));
  }

  async #know(run) {
    try {
      const { name, seconds } = await get(runPath(run));
      if (this.closed) return;
      this.seconds = seconds ?? 0;
      this.seek.max = String(this.seconds);
      this.name.href = `#/runs/${encodeURIComponent(run)}`;
      say(this.name, name);
    } catch (error) {
      say(this.wrong, error.message);
    }
  }

  async #tried(what) {
    try {
      await what();
      say(this.wrong, "");
    } catch (error) {
      say(this.wrong, error.message);
    }
  }

  #play(start_s) {
    return this.#tried(async () => {
      if (this.closed) return;
      await post("/replay", { run: this.run, speed: Number(this.speed.value), start_s });
      this.wanted = true;
    });
  }

  #again() {
    return this.playing ? this.#play(Number(this.seek.value)) : undefined;
  }

  #toggle() {
    if (this.playing) return this.#tried(() => remove("/replay"));
    const at_s = Number(this.seek.value);
    return this.#play(at_s >= this.seconds - 0.1 ? 0 : at_s);
  }

  #end() {
    this.wanted = false;
    this.element.hidden = true;
    return this.#tried(() => remove("/replay"));
  }

  show({ replay, run }) {
    this.playing = replay !== null;
    if (replay !== null && replay.run !== this.run) {
      this.run = replay.run;
      this.#know(replay.run);
    }
    if (replay !== null && document.activeElement !== this.speed) this.speed.value = String(replay.speed);
    this.element.hidden = run !== null || !(this.wanted || this.playing);
    say(this.toggle, this.playing ? "Pause" : "Play");
  }

  #follow() {
    const t_s = this.app.samples.last[T];
    if (this.playing && !this.held && Number.isFinite(t_s)) this.seek.value = String(t_s);
    say(this.place, `${steady(Number(this.seek.value), 1)} of ${steady(this.seconds, 1)} s`);
  }

  close() {
    this.closed = true;
    clearInterval(this.timer);
  }
}
