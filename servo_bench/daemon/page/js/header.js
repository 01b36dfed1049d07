// What is above every view: state in large letters, limits, banners, the stop button.

import { fill, h, say } from "./dom.js";
import { angle, duration, quantity, velocity, when } from "./format.js";
import { closeSheet } from "./sheet.js";
import { meansStop, stopRig } from "./stop.js";

const MOVING = new Set(["preparing", "running", "stopping"]);
const at = (id) => document.getElementById(id);

export class Header {
  constructor(connection) {
    this.connection = connection;
    this.status = null;
    this.banners = new Map();
    this.stop = at("stop");
    this.stop.addEventListener("click", () => this.#stop("the page's stop button"));
    // captured: nothing on the page can keep the key to itself
    addEventListener("keydown", (event) => this.#key(event), { capture: true });
    addEventListener("keyup", (event) => this.#keyUp(event), { capture: true });
    // what lies below the header must begin below it, however many banners it has
    new ResizeObserver(([{ target }]) => document.documentElement.style.setProperty("--bar", `${target.offsetHeight}px`)).observe(document.querySelector(".bar"));
    connection.addEventListener("gone", ({ detail }) => this.#gone(detail));
    connection.addEventListener("back", () => this.banner("gone", null));
  }

  /** Whether the rig moves or may move, for all that is known. */
  get mayMove() {
    return this.connection.there !== true || this.status === null || MOVING.has(this.status.state);
  }

  #key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || !meansStop(event, this.mayMove)) return;
    event.preventDefault();
    event.stopPropagation();
    closeSheet();
    if (!event.repeat) this.#stop(event.key === "Escape" ? "the Escape key" : "the space bar");
  }

  #keyUp(event) {
    // a button is pressed by the space bar's way up
    if (event.key === " " && meansStop(event, this.mayMove)) event.preventDefault();
  }

  async #stop(reason) {
    this.stop.dataset.busy = "true";
    this.banner("stop", "info", "Stop is being sent …");
    try {
      const { standing, state } = await stopRig(this.connection, reason);
      this.#stopped(standing && seenToEnd(this.status), state);
    } catch (error) {
      this.banner("stop", "alarm", `STOP WAS NOT DELIVERED. Use the emergency stop now. ${error.message}`);
    } finally {
      delete this.stop.dataset.busy;
    }
  }

  #stopped(standing, state) {
    this.stopping = MOVING.has(state);
    const still = standing ? "Stopped: the rig stands." : "Stop given. It is not known whether the rig stands: look at it.";
    this.banner("stop", "info", `${this.stopping ? "Stop given: the rig is being stopped." : still} The queue is held.`);
  }

  #gone(why) {
    this.stopping = false; // nobody knows any more
    const begins = why ? `THIS PAGE IS NOT CONNECTED: the daemon works, but ${why}. Close one, and this one connects by itself.` : "DAEMON GONE: nothing has been heard from it.";
    this.banner("gone", "alarm", `${begins} What is shown is old; the rig may still move. Use the emergency stop if in doubt.`);
    this.#state("unknown", "No contact", why || "the daemon does not answer");
  }

  /** The rig's description, once. */
  rig(rig) {
    say(at("rig"), `${rig.name}${rig.simulated ? " (software rig)" : ""}`);
  }

  /** Show a status. */
  show(status) {
    const before = this.status;
    this.status = status;
    this.#state(status.state, WORDS[status.state] ?? status.state, detailOf(status));
    this.#limits(status.limits);
    this.banner("bus", status.bus_alive ? null : "alarm", "BUS GONE: the bus process is silent. The rig is being stopped; watch it.");
    this.banner("fault", status.fault ? "alarm" : null, status.fault ? `Fault at ${when(status.fault.at_utc)}: ${status.fault.sentence} To clear it look at the rig, then arm the queue.` : "");
    const began = status.run !== null && status.run.id !== before?.run?.id;
    const armed = before?.held && !status.held;
    if (began || armed) this.banner("stop", null);
    if (this.stopping && !MOVING.has(status.state)) this.#stopped(status.state !== "faulted", status.state);
  }

  #state(state, word, detail) {
    const element = at("state");
    element.dataset.state = state;
    document.body.dataset.state = state;
    say(element, word);
    say(at("state-detail"), detail);
    document.title = `${word} · servo-bench`;
  }

  #limits(limits) {
    const rows = [
      ["velocity", velocity(limits.velocity_rad_s)],
      ["travel", angle(limits.travel_rad)],
      ["run time", duration(limits.run_time_s)],
    ];
    const text = JSON.stringify(rows);
    if (text === this.limitsText) return;
    this.limitsText = text;
    fill(at("limits"), rows.map(([name, value]) => h("div", {}, h("dt", {}, `limit, ${name}`), h("dd", {}, value))));
  }

  /** Show, change, or with kind null take away a banner. */
  banner(name, kind, text = "") {
    const shown = this.banners.get(name);
    if (kind === null) {
      shown?.remove();
      this.banners.delete(name);
      return;
    }
    if (shown) {
      shown.className = `banner banner-${kind}`;
      say(shown, text);
      return;
    }
    const made = h("p", { class: `banner banner-${kind}`, "data-banner": name }, text);
    this.banners.set(name, made);
    at("banners").append(made);
    at("banners").scrollTop = 0; // a new one is not looked for
  }
}

const WORDS = {
  idle: "Idle",
  preparing: "Preparing",
  running: "Running",
  stopping: "Stopping",
  analysing: "Analysing",
  faulted: "Fault",
};

/** Whether the daemon has seen a run's end; one that was only started knows nothing of the rig. */
function seenToEnd(status) {
  return status !== null && status.last !== null;
}

function detailOf(status) {
  const { state, run, held, held_reason: reason, queue, replay } = status;
  if (run !== null) return `${run.name}, by ${run.operator}: ${run.phase}, ${quantity(run.seconds_left, "s left", 3)}`;
  const still = seenToEnd(status) ? "the rig stands; " : "the rig may move: look at it; ";
  const known = state === "faulted" ? "" : still; // a fault's own sentence says what the drive said
  if (replay !== null) return `${known}a recording is replayed at ${replay.speed}×`;
  if (held) return `${known}queue held: ${reason}`;
  return queue.length ? `${queue.length} waiting` : "armed: a submitted run begins at once";
}
