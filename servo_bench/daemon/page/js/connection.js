// The live connection: status and samples from the daemon, and whether it is there at all.
//
// The daemon says something at least twice a second. A second without a word means that it, or the
// way to it, is gone; the page says so before that second is over, and connects again by itself.

import { call } from "./api.js";
import { rowsOf } from "./frames.js";

const SILENT_MS = 900;
const LOOK_EVERY_MS = 50;
const AGAIN_MS = 500;

/** Tells "status" (detail: Status), "rows" (detail: Float64Array), "gone", "back". */
export class Connection extends EventTarget {
  constructor(address) {
    super();
    this.address = address;
    this.there = null; // null until the daemon has spoken or been silent for too long
    this.heard_ms = performance.now();
    this.#connect();
    setInterval(() => this.#look(), LOOK_EVERY_MS);
  }

  /** Whether a message could be sent. */
  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  #connect() {
    this.tried_ms = performance.now();
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => this.#heard(data);
    socket.onclose = () => {
      if (socket === this.socket) this.#gone();
    };
    this.socket = socket;
  }

  #heard(data) {
    this.heard_ms = performance.now();
    if (this.there !== true) {
      this.there = true;
      this.#tell("back");
    }
    if (data instanceof ArrayBuffer) {
      const rows = rowsOf(data);
      if (rows !== null) this.#tell("rows", rows);
      return;
    }
    const message = JSON.parse(data);
    if (message.kind === "status") this.#tell("status", message);
  }

  #look() {
    const now_ms = performance.now();
    const waited_ms = now_ms - Math.max(this.heard_ms, this.tried_ms);
    if (now_ms - this.heard_ms > SILENT_MS) this.#gone();
    const state = this.socket.readyState;
    const dead = state === WebSocket.CLOSED || state === WebSocket.CLOSING || waited_ms > 3 * SILENT_MS;
    if (dead && now_ms - this.tried_ms > AGAIN_MS) {
      const old = this.socket;
      this.#connect();
      old.close();
    }
  }

  #gone() {
    if (this.there === false) return;
    this.there = false;
    this.#tell("gone");
    // a socket does not say why it was refused; this answer does: 401 brings the login
    call("GET", "/status", undefined, { patience_ms: 2000 }).catch(() => {});
  }

  #tell(kind, detail) {
    this.dispatchEvent(new CustomEvent(kind, { detail }));
  }
}

/** The daemon's live address, beside the page's own. */
export function liveAddress(location) {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live`;
}
