// The queue: what waits, whether it is held and why, and the button that arms it.

import { remove } from "./api.js";
import { arm } from "./arming.js";
import { fill, h, say } from "./dom.js";
import { button } from "./sheet.js";

export class QueuePanel {
  constructor() {
    this.held = h("p", { class: "held" });
    this.arm = button("Arm the queue …", () => arm(this.status), { class: "go", disabled: true });
    this.list = h("ol", { class: "queue" });
    this.wrong = h("p", { class: "wrong", role: "alert" });
    this.element = h("section", { class: "card", "aria-label": "Queue" }, h("h2", {}, "Queue"), this.held, this.arm, this.list, this.wrong);
  }

  show(status) {
    this.status = status;
    this.element.classList.toggle("is-held", status.held);
    say(this.held, status.held ? `Held: ${status.held_reason || "an operator must arm it"}` : "Armed: the next run begins by itself.");
    this.arm.hidden = !status.held && status.fault === null;
    this.arm.disabled = status.state === "stopping"; // refused until the rig stands
    const text = JSON.stringify(status.queue);
    if (text === this.text) return;
    this.text = text;
    fill(this.list, status.queue.length ? status.queue.map((entry) => this.#entry(entry)) : h("li", { class: "hint" }, "Nothing waits."));
  }

  #entry({ id, name, experiment, operator }) {
    const take = button("Remove", () => this.#remove(id), { "aria-label": `Remove ${name} from the queue`, class: "small" });
    return h("li", {}, h("span", { class: "queue-name" }, name), h("span", { class: "hint" }, `${experiment}, by ${operator}`), take);
  }

  async #remove(id) {
    try {
      await remove(`/queue/${encodeURIComponent(id)}`);
      say(this.wrong, "");
    } catch (error) {
      say(this.wrong, error.message);
    }
  }
}
