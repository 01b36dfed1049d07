// The live view: plots, the run that plays, the queue, and the replay's bar.

import { LivePlots } from "../live_plots.js";
import { QueuePanel } from "../queue_panel.js";
import { ReplayBar } from "../replay_bar.js";
import { fill, h, pairs, say } from "../dom.js";
import { duration, lateness, number } from "../format.js";

const WINDOWS_S = [2, 10, 30, 60];

export function liveView(app, { replay } = {}) {
  const plots = new LivePlots(app.samples);
  const queue = new QueuePanel();
  const bar = new ReplayBar(app, replay);
  const run = new RunCard();
  const last = h("section", { class: "card", "aria-label": "Last run" });
  const choice = h(
    "select",
    { id: "window", onchange: () => app.samples.show(Number(choice.value)) },
    WINDOWS_S.map((seconds) => h("option", { value: seconds, selected: seconds === app.samples.window_s }, `${seconds} s`)),
  );
  const element = h(
    "div",
    { class: "live" },
    h("section", { class: "plots", "aria-label": "Live plots" }, h("div", { class: "tools" }, h("label", { for: "window" }, "Window"), choice), bar.element, plots.figures),
    h("aside", { class: "side" }, run.element, queue.element, last),
  );
  let lastText = "";
  return {
    title: "Live",
    element,
    status(status) {
      plots.show(status.run !== null || status.replay !== null);
      run.show(status);
      queue.show(status);
      bar.show(status);
      const text = JSON.stringify(status.last);
      if (text === lastText) return;
      lastText = text;
      last.hidden = status.last === null;
      if (status.last) fill(last, h("h2", {}, "Last run"), h("p", {}, status.last.sentence), h("a", { href: `#/runs/${status.last.id}` }, "Open it"));
    },
    rows: () => plots.took(),
    close() {
      plots.close();
      bar.close();
    },
  };
}

class RunCard {
  constructor() {
    this.progress = h("progress", { max: "1", "aria-label": "Progress of the run" });
    this.left = h("p", { class: "large" });
    this.facts = h("div", {});
    this.element = h("section", { class: "card", "aria-label": "Run" }, h("h2", {}, "Run"), this.left, this.progress, this.facts);
  }

  show({ run, state }) {
    this.progress.hidden = run === null;
    if (run === null) {
      say(this.left, state === "analysing" ? "The last run is being analysed." : "Nothing plays.");
      fill(this.facts);
      return;
    }
    this.progress.value = run.slots ? Math.min(run.slot / run.slots, 1) : 0;
    say(this.left, `${duration(run.seconds_left)} left`);
    fill(
      this.facts,
      pairs([
        ["name", run.name],
        ["experiment", run.experiment],
        ["operator", run.operator],
        ["phase", run.phase],
        ["slot", `${number(run.slot, 9)} of ${number(run.slots, 9)}`],
        ["missed slots", number(run.missed, 9)],
        ["lateness, median", lateness(run.lateness_p50_s)],
        ["lateness, largest", lateness(run.lateness_max_s)],
      ]),
    );
  }
}
