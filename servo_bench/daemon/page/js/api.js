// The daemon's HTTP interface. Every failure is a Problem whose message can be shown as it is.

export class Problem extends Error {
  constructor(status, detail, type = "") {
    super(detail);
    this.status = status;
    this.type = type;
  }
}

const UNREACHABLE = "The daemon did not answer. See whether it runs and whether this machine reaches it.";
const PATIENCE_MS = 15_000;
const NO_CONTENT = 204;

/** Call the daemon; the JSON of its answer. Problem where it refuses or does not answer. */
export async function call(method, path, body, { patience_ms = PATIENCE_MS, keepalive = false } = {}) {
  let answer;
  try {
    answer = await fetch(`/api${path}`, {
      method,
      keepalive,
      headers: body === undefined ? {} : { "Content-Type": "application/json" },
      body: body === undefined ? undefined : JSON.stringify(body),
      signal: AbortSignal.timeout(patience_ms),
      cache: "no-store",
    });
  } catch (error) {
    throw new Problem(0, error.name === "TimeoutError" ? `${UNREACHABLE} (${patience_ms / 1e3} s)` : UNREACHABLE);
  }
  const said = await answer.json().catch(() => null);
  // an answer that was cut is none: whoever must know asks again
  if (answer.ok && said === null && answer.status !== NO_CONTENT) throw new Problem(0, UNREACHABLE);
  if (answer.ok) return said;
  if (answer.status === 401) dispatchEvent(new Event("login-needed"));
  throw new Problem(answer.status, detailOf(said) ?? `The daemon refused with status ${answer.status}.`, said?.type);
}

function detailOf(said) {
  return typeof said?.detail === "string" ? said.detail : null;
}

export const get = (path) => call("GET", path);
export const post = (path, body = {}, options) => call("POST", path, body, options);
export const patch = (path, body) => call("PATCH", path, body);
export const remove = (path) => call("DELETE", path);
export const runPath = (id) => `/runs/${encodeURIComponent(id)}`;
