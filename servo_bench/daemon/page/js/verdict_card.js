// What a diagnosis says of a run: the sentence, causes with intervals, what mending them gains.

import { h } from "./dom.js";
import { NOTHING, inUnit, nameOf, quantity, words } from "./format.js";

/** The card; `page` is where the whole page of the diagnosis is, null where there is none. */
export function verdictCard({ diagnosis, verdict }, page) {
  return h(
    "section",
    { class: "card", "aria-label": "Verdict" },
    h("h2", {}, "Verdict"),
    diagnosis ? told(diagnosis) : h("p", { class: "hint" }, verdict ? `The verdict is ${verdict}, but its file is not of this version: diagnose again.` : "Not diagnosed yet."),
    page ? h("p", {}, h("a", { class: "button", href: page, target: "_blank", rel: "noopener" }, "Open the whole diagnosis")) : null,
  );
}

function told({ verdict, sentence, causes, error, notes, undecided, next_run: next }) {
  return [
    h("p", { class: `large verdict-${verdict}` }, causes.length ? words(causes.map(({ effect }) => effect).join(", ")) : verdict),
    h("p", {}, sentence),
    causes.map(causeTable),
    error ? gain(error) : null,
    more("What this run leaves open", [...notes, ...undecided]),
    next ? more("What to measure next", [next]) : null,
  ];
}

function causeTable({ effect, confidence, parameters, ambiguous_with: rivals }) {
  const rows = Object.entries(parameters).map(([name, { value, unit, ci95 }]) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, nameOf(name, unit)),
      h("td", { class: "numeric" }, inUnit(value, unit)),
      h("td", { class: "numeric" }, `${inUnit(ci95[0], unit, 3)} to ${inUnit(ci95[1], unit, 3)}`),
    ),
  );
  return h(
    "div",
    { class: "cause" },
    h("h3", {}, `${words(effect)}, confidence ${quantity(100 * confidence, "%", 3)}`),
    rivals.length ? h("p", { class: "hint" }, `This run cannot tell it from ${words(rivals.join(", "))}.`) : null,
    rows.length ? h("div", { class: "scroll" }, h("table", {}, h("thead", {}, h("tr", {}, ["", "value", "95 % interval"].map((name) => h("th", { scope: "col", class: name ? "numeric" : null }, name)))), h("tbody", {}, rows))) : null,
  );
}

function gain({ signal, unit, before, after, noise_floor: floor, share_explained: share }) {
  const rows = [
    ["before", before],
    ["after", after],
    ["the sensor's floor", floor],
  ];
  return h(
    "div",
    { class: "gain" },
    h("h3", {}, "What it gains"),
    h("p", {}, `Of the error of the ${signal || NOTHING} that can be explained, ${quantity(100 * share, "%", 3)} is, on data that no fit saw. Its rms:`),
    h("dl", { class: "pairs" }, rows.map(([name, value]) => [h("dt", {}, name), h("dd", {}, inUnit(value, unit, 3))])),
  );
}

function more(title, sentences) {
  if (!sentences.length) return null;
  return h("details", {}, h("summary", {}, title), h("ul", {}, sentences.map((sentence) => h("li", {}, sentence))));
}
