// The record of one candidate in a dialog: its ending, constants and log.

import { get } from "./api.js";
import { attempt } from "./trouble.js";
import { badge, number } from "./words.js";

const fact = (term, value) => make("div", {}, make("dt", {}, term), make("dd", {}, value));

const quantity = (q) => (q !== null && typeof q === "object" ? `${number(q.value)} ${q.unit || ""}`.trim() : number(q));

export const openCandidate = (job, candidate) =>
  attempt(async () => {
    const dialog = document.getElementById("dialog");
    const known = await get(`/jobs/${encodeURIComponent(job)}/candidates/${candidate}`);
    const close = make("button", { type: "button", class: "quiet close", "aria-label": "close" }, "close");
    close.addEventListener("click", () => dialog.close());
    const facts = make("dl", { class: "facts" });
    for (const [name, value] of Object.entries(known.genes || {})) facts.append(fact(name, quantity(value)));
    for (const [name, value] of Object.entries(known.score || {})) facts.append(fact(name.toUpperCase().replace("_", ", "), number(value)));
    for (const [name, value] of Object.entries(known.seconds || {})) facts.append(fact(`${name}, s`, number(value, 3)));
    for (const [name, value] of [["worker", known.worker], ["attempts", known.attempts], ["evaluation digest", known.digest]])
      if (value !== undefined && value !== null && value !== "") facts.append(fact(name, String(value)));
    const parts = [
      make("div", { class: "head" }, make("h2", { id: "dialog-title" }, `Candidate ${known.candidate}, generation ${known.generation}`), badge(known.status), close),
    ];
    if (known.reason) parts.push(make("p", { class: "note warn" }, known.reason));
    parts.push(facts);
    if (known.outcome && Object.keys(known.outcome).length)
      parts.push(make("details", {}, make("summary", {}, "Solver output"), make("pre", {}, JSON.stringify(known.outcome, null, 1))));
    if (known.traceback) parts.push(make("h3", {}, "Log of the worker"), make("pre", { class: "traceback", tabindex: "0" }, known.traceback));
    dialog.replaceChildren(...parts);
    if (!dialog.open) dialog.showModal();
  });
