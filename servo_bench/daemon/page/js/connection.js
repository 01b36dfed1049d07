// The live connection: status and samples from the daemon, and whether it is there at all.
//
// The daemon says something at least twice a second. A second without a word means that it, or the
// way to it, is gone; the page says so before that second is over, and connects again by itself.

import { call } from "./api.js";
import { rowsOf } from "./frames.js";

const SILENT_MS = 900;
const LOOK_EVERY_MS = 50;
const AGAIN_MS = 500;
const TRY_AGAIN_LATER = 1013; // the daemon is well, and has no place for this page

/** Tells "status" (detail: Status), "rows" (detail: Float64Array), "gone" (detail: why, if the daemon said it), "back". */
export class Connection extends EventTarget {
  constructor(address) {
    super();
    this.address = address;
    this.there = null; // null until the daemon has spoken or been silent for too long
    this.why = "";
    this.refused_ms = -Infinity;
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
    socket.onclose = ({ code, reason }) => {
      if (code === TRY_AGAIN_LATER) this.refused_ms = performance.now();
      if (socket === this.socket) this.#gone(code === TRY_AGAIN_LATER ? reason : "");
    };
    this.socket = socket;
  }

  #heard(data) {
    this.heard_ms = performance.now();
    if (this.there !== true) {
      this.there = true;
      this.why = "";
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
    if (now_ms - this.heard_ms > SILENT_MS) this.#gone(now_ms - this.refused_ms < 3 * SILENT_MS ? this.why : "");
    const state = this.socket.readyState;
    const dead = state === WebSocket.CLOSED || state === WebSocket.CLOSING || waited_ms > 3 * SILENT_MS;
    if (dead && now_ms - this.tried_ms > AGAIN_MS) {
      const old = this.socket;
      this.#connect();
      old.close();
    }
  }

  #gone(why) {
    if (this.there === false && why === this.why) return;
    this.there = false;
    this.why = why;
    this.#tell("gone", why);
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
