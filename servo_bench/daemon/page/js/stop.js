// The stop: a button that is always there, Escape, and Space while the rig moves.
//
// It goes out at once by POST /api/stop, which says who stops, and also by the open WebSocket where
// that is not answered in a moment; it is repeated until the daemon has answered. Nothing is asked.

import { Problem, call } from "./api.js";
import { operator } from "./operator.js";

const TRIES = 20;
const PATIENCE_MS = 1000;
const BETWEEN_MS = 150;
const MOMENT_MS = 80;

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

/** Send a stop; the daemon's answer. Problem where it could not be delivered. */
export async function stopRig(connection, reason) {
  const body = { operator: operator.name, reason };
  const alsoSent = setTimeout(() => connection.send({ kind: "stop", ...body }), MOMENT_MS);
  let last = new Problem(0, "The daemon did not answer.");
  for (let tried = 0; tried < TRIES; tried += 1) {
    try {
      const answer = await call("POST", "/stop", body, { patience_ms: PATIENCE_MS, keepalive: true });
      clearTimeout(alsoSent);
      return answer;
    } catch (error) {
      last = error;
      if (error.status === 401) break;
      await pause(BETWEEN_MS);
    }
  }
  throw last;
}

const WRITES = "input:not([type=checkbox]):not([type=radio]):not([type=range]), textarea, select, [contenteditable]";

/** Whether a key means stop: Escape always; Space while the rig may move, unless it is written. */
export function meansStop(event, mayMove) {
  if (event.key === "Escape") return true;
  return event.key === " " && mayMove && !event.target.closest?.(WRITES);
}
