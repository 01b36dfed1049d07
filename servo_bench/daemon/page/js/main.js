// The page: one connection, one header, one view at a time, chosen by the address after "#".

import { get } from "./api.js";
import { Connection, liveAddress } from "./connection.js";
import { fill } from "./dom.js";
import { Header } from "./header.js";
import { Samples } from "./samples.js";
import { closeSheet, tellSheet } from "./sheet.js";
import { compareView } from "./views/compare.js";
import { liveView } from "./views/live.js";
import { loginView } from "./views/login.js";
import { runView } from "./views/run.js";
import { runsView } from "./views/runs.js";
import { startView } from "./views/start.js";

const WINDOW_S = 10;
const VIEWS = [
  [/^live$/, liveView],
  [/^start$/, startView],
  [/^runs$/, runsView],
  [/^runs\/([^/]+)$/, (app, [id]) => runView(app, id)],
  [/^replay\/([^/]+)$/, (app, [id]) => liveView(app, { replay: id })],
  [/^compare$/, (app, _, query) => compareView(app, query)],
  [/^login$/, (app, _, query) => loginView(query.get("from") ?? "")],
];

const connection = new Connection(liveAddress(location));
const header = new Header(connection);
const app = { samples: new Samples(WINDOW_S), status: null, rig: null };
let view = null;

function route() {
  const [path, query] = location.hash.replace(/^#\/?/, "").split("?");
  for (const [pattern, make] of VIEWS) {
    const found = pattern.exec(path);
    if (found) return open(make, found.slice(1).map(decoded), new URLSearchParams(query));
  }
  location.replace("#/live");
  return undefined;
}

function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part; // a stray percent sign: there is no such run, and the daemon will say so
  }
}

function open(make, parts, query) {
  closeSheet();
  view?.close?.();
  const main = document.getElementById("main");
  view = make(app, parts, query);
  fill(main, view.element);
  for (const tab of document.querySelectorAll("#tabs a")) {
    const own = location.hash.startsWith(tab.getAttribute("href"));
    if (own) tab.setAttribute("aria-current", "page");
    else tab.removeAttribute("aria-current");
  }
  main.setAttribute("aria-label", view.title);
  if (app.status) view.status?.(app.status);
}

async function learnRig() {
  try {
    app.rig = await get("/rig");
    header.rig(app.rig);
  } catch (error) {
    console.info("the rig is not known yet:", error.message); // asked again when the daemon is back
  }
}

connection.addEventListener("status", ({ detail }) => {
  app.status = detail;
  header.show(detail);
  view?.status?.(detail);
  tellSheet(detail);
});
connection.addEventListener("rows", ({ detail }) => {
  app.samples.take(detail);
  view?.rows?.();
});
connection.addEventListener("back", learnRig);
addEventListener("login-needed", () => {
  if (location.hash.startsWith("#/login")) return;
  location.hash = `#/login?${new URLSearchParams({ from: location.hash })}`;
});
addEventListener("hashchange", () => {
  route();
  scrollTo(0, 0);
  document.getElementById("main").focus({ preventScroll: true });
});
route();
