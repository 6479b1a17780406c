// The list of studies and diagnoses, and the form that submits another study.

import { follow, get, send, upload } from "./api.js";
import { attempt, connected } from "./trouble.js";
import { badge, count, duration, ended, moment, number } from "./words.js";

const EXAMPLE = `name: demo
case:
  reference:
    phantom: {preset: 445ml, spacing_mm: 2.0, glandular_fraction: 0.2, seed: 1}
  mesh: {nodes: 2000}
  load: {force_n: 100}
target:
  constants: {E_fat_kpa: 10, E_glandular_kpa: 40}
search:
  parameters:
    E_fat_kpa: [5, 20]
    E_glandular_kpa: [5, 80]
  population: 12
  generations: 8
seed: 1
`;

export const progressOf = (job) => {
  if (job.evaluations) {
    const [done, most] = [ended(job.evaluations), job.evaluations.at_most];
    return { done, most, text: `${count(done)} of at most ${count(most)}` };
  }
  if (job.phase) return { done: job.phase.done, most: job.phase.of, text: `${job.phase.phase}, ${job.phase.done} of ${job.phase.of}` };
  return { done: 0, most: 1, text: "" };
};

export const leftOf = (job) => {
  return job.state === "running" && job.left_s !== null ? duration(job.left_s) : "";
};

const rowOf = (job) => {
  const progress = progressOf(job);
  const bar = make("progress", { max: progress.most, value: job.state === "finished" ? progress.most : progress.done, "aria-label": `progress of ${job.id}` });
  const failed = job.evaluations ? job.evaluations.diverged + job.evaluations.crashed + job.evaluations.lost : 0;
  const cell = (is, ...children) => make("td", { "data-is": is }, ...children);
  return make("tr", { "data-job": job.id },
    make("td", {}, make("a", { href: `#/${encodeURIComponent(job.id)}` }, job.id)),
    cell("State", badge(job.state)),
    cell("Evaluations", bar, make("span", { class: "beside" }, progress.text)),
    cell("Failed", job.evaluations ? count(failed) : "\u2013"),
    cell("Best score", job.best ? `${job.best.objective} ${number(job.best.value)}` : "\u2013"),
    cell("Time left, at most", leftOf(job) || "\u2013"),
    cell("Owner", job.owner),
    cell("Submitted", moment(job.submitted)));
};

export const showJobs = async (page) => {
  const body = make("tbody");
  const heads = ["Job", "State", "Evaluations", "Failed", "Best score", "Time left, at most", "Owner", "Submitted"];
  const table = make("table", { class: "cards jobs" },
    make("thead", {}, make("tr", {}, ...heads.map((head) => make("th", {}, head)))), body);
  const none = make("p", { class: "note" }, "Nothing has been submitted yet.");
  const more = make("button", { type: "button", class: "quiet", hidden: "" }, "older ones");
  page.main.append(make("h1", {}, "Studies and diagnoses"), submission(), none, make("div", { class: "scroll" }, table), more);

  const rows = new Map();
  const show = (job, older = false) => {
    none.hidden = true;
    const row = rowOf(job);
    if (rows.has(job.id)) rows.get(job.id).replaceWith(row);
    else if (older) body.append(row);
    else body.prepend(row);
    rows.set(job.id, row);
  };
  let before = null;
  const older = async () => {
    const got = await get(`/jobs?limit=50${before === null ? "" : `&before=${before}`}`);
    got.jobs.forEach((job) => rows.has(job.id) || show(job, true));
    before = got.more;
    more.hidden = before === null;
  };
  await older();
  more.addEventListener("click", () => attempt(older));
  page.leave.push(follow("/events", { job: (job) => show(job) }, connected));
};

const submission = () => {
  const text = make("textarea", { name: "study", rows: "18", spellcheck: "false", "aria-label": "study file" });
  text.value = EXAMPLE;
  const file = make("input", { type: "file", accept: ".yaml,.yml" });
  file.addEventListener("change", async () => { if (file.files.length) text.value = await file.files[0].text(); });
  const folder = make("input", { type: "text", name: "folder", placeholder: "FOLDER", pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]*" });
  const images = make("input", { type: "file", multiple: "" });
  const priority = make("input", { type: "number", name: "priority", value: "0", min: "-100", max: "100" });
  const form = make("form", { class: "submission" },
    text,
    make("label", {}, "Read it from a file ", file),
    make("fieldset", {}, make("legend", {}, "Images that it names as FOLDER/FILE"),
      make("label", {}, "folder ", folder), make("label", {}, "files ", images)),
    make("label", {}, "Priority ", priority),
    make("button", { class: "main" }, "Submit"));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(async () => {
      for (const image of images.files) await upload(folder.value, image);
      const job = await send("POST", "/studies", { study: text.value, priority: Number(priority.value) });
      location.hash = `#/${encodeURIComponent(job.id)}`;
    });
  });
  return make("details", { class: "submit needs-token" }, make("summary", {}, "Submit a study"), form);
};
