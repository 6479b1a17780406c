// A comparison of studies: their constants with intervals, and their scores.

import { get } from "./api.js";
import { badge, count, number } from "./words.js";

const link = (id) => make("a", { href: `#/${encodeURIComponent(id)}` }, id);

const estimateOf = (estimate) => {
  if (!estimate || estimate.estimate === null) return "\u2013";
  const ends = estimate.interval;
  const interval = ends ? ` (${number(ends.lower)} to ${number(ends.upper)})` : "";
  return `${number(estimate.estimate)}${interval} ${estimate.unit}`.trim();
};

const table = (heads, rows) =>
  make("div", { class: "scroll" }, make("table", { class: "cards" },
    make("thead", {}, make("tr", {}, ...heads.map((head) => make("th", {}, head)))),
    make("tbody", {}, ...rows.map((row) => make("tr", {}, ...row.map((cell, k) => make("td", { "data-is": k ? headText(heads[k]) : "" }, cell)))))));

const headText = (head) => (typeof head === "string" ? head : head.textContent);

export const showComparison = async (page, ids) => {
  const found = await Promise.all(ids.map((id) => get(`/jobs/${encodeURIComponent(id)}/results`)));
  const names = [...new Set(found.flatMap((results) => Object.keys(results.estimates)))];
  const constants = names.map((name) => [name, ...found.map((results) => {
    const estimate = results.estimates[name];
    const cell = make("span", {}, estimateOf(estimate));
    if (estimate && !estimate.quotable) cell.append(make("small", { class: "beside" }, `not quotable: ${estimate.reasons.join("; ")}`));
    return cell;
  })]);
  const best = (results, key, digits) => (results.best && results.best.score ? number(results.best.score[key], digits) : "\u2013");
  const outcomes = [
    ["State", ...found.map((results) => badge(results.state))],
    ["Best GSF", ...found.map((results) => best(results, "gsf", 5))],
    ["Jaccard", ...found.map((results) => best(results, "jc", 3))],
    ["MHD, mm", ...found.map((results) => best(results, "mhd_mm", 3))],
    ["Evaluations", ...found.map((results) => count(results.evaluations.done))],
  ];
  const heads = (first) => [first, ...ids.map(link)];
  page.main.append(make("h1", {}, "Studies side by side"),
    make("section", { id: "constants" }, make("h2", {}, "Constants, with 90 % intervals"), table(heads("Constant"), constants)),
    make("section", { id: "outcomes" }, make("h2", {}, "Outcomes"), table(heads("Outcome"), outcomes)));
};
