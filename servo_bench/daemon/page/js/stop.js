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
const NO_SESSION = 401;
const NOT_STOPPED = new Set(["preparing", "running"]);
const STANDS = new Set(["idle", "analysing"]);

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
      if (error.status === NO_SESSION) {
        clearTimeout(alsoSent);
        const heeded = await stopBySocket(connection, body);
        if (heeded !== null) return heeded;
        break;
      }
      await pause(BETWEEN_MS);
    }
  }
  throw last;
}

/** A session that has run out closes no socket: send a stop by it; what the status then says, null without one. */
function stopBySocket(connection, body) {
  return new Promise((done) => {
    const end = (answer) => {
      clearTimeout(silent);
      connection.removeEventListener("status", heard);
      done(answer);
    };
    const heard = ({ detail: { held, state } }) => {
      if (held && !NOT_STOPPED.has(state)) end({ standing: STANDS.has(state), state });
    };
    const silent = setTimeout(end, PATIENCE_MS, null);
    connection.addEventListener("status", heard);
    if (!connection.send({ kind: "stop", ...body })) end(null);
  });
}

const WRITES = "input:not([type=checkbox]):not([type=radio]):not([type=range]), textarea, select, [contenteditable]";

/** Whether a key means stop: Escape always; Space while the rig may move, unless it is written. */
export function meansStop(event, mayMove) {
  if (event.key === "Escape") return true;
  return event.key === " " && mayMove && !event.target.closest?.(WRITES);
}
