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

const rowOf = (job, isChosen, choose) => {
  const progress = progressOf(job);
  const bar = make("progress", { max: progress.most, value: job.state === "finished" ? progress.most : progress.done, "aria-label": `progress of ${job.id}` });
  const failed = job.evaluations ? job.evaluations.diverged + job.evaluations.crashed + job.evaluations.lost : 0;
  const cell = (is, ...children) => make("td", { "data-is": is }, ...children);
  const box = make("input", { type: "checkbox", "aria-label": `compare ${job.id}` });
  box.checked = isChosen;
  box.addEventListener("change", () => choose(job.id, box.checked));
  return make("tr", { "data-job": job.id },
    make("td", {}, ...(job.kind === "study" ? [box, " "] : []), make("a", { href: `#/${encodeURIComponent(job.id)}` }, job.id)),
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
  const more = make("button", { type: "button", class: "quiet", hidden: "" }, "show older jobs");
  const study = submission();
  const diagnosis = diagnosisForm();
  const none = nothingYet(study, diagnosis);
  const chosen = new Set();
  const compare = make("button", { type: "button", class: "quiet", disabled: "" }, "compare selected studies");
  compare.addEventListener("click", () => { location.hash = `#/compare/${[...chosen].map(encodeURIComponent).join(",")}`; });
  const scroll = make("div", { class: "scroll", hidden: "" }, table);
  page.main.append(make("h1", {}, "Studies and diagnoses"), none, study, diagnosis, scroll, more, compare);

  const choose = (id, on) => {
    if (on) chosen.add(id);
    else chosen.delete(id);
    compare.disabled = chosen.size < 2;
  };
  const rows = new Map();
  const show = (job, older = false) => {
    none.hidden = true;
    scroll.hidden = false;
    const row = rowOf(job, chosen.has(job.id), choose);
    if (rows.has(job.id)) rows.get(job.id).replaceWith(row);
    else if (older) body.append(row);
    else body.prepend(row);
    rows.set(job.id, row);
    compare.hidden = rows.size < 2;
  };
  compare.hidden = true;
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

// The page of a new user: possible first steps, one of which needs no files.
const nothingYet = (study, diagnosis) => {
  const demo = make("button", { type: "button", class: "main needs-token" }, "Start the demo");
  demo.addEventListener("click", () => attempt(() => submitStudy(EXAMPLE, 0)));
  const scans = make("button", { type: "button", class: "needs-token" }, "Upload scans");
  scans.addEventListener("click", () => {
    diagnosis.open = true;
    diagnosis.querySelector("input[type=file]").focus();
  });
  const own = make("button", { type: "button", class: "needs-token" }, "Use a study file");
  own.addEventListener("click", () => {
    study.open = true;
    study.querySelector("textarea").focus();
  });
  return make("div", { class: "empty" },
    make("p", { class: "note" }, "Nothing has been submitted yet. The demo finds the stiffness of a virtual breast in a few minutes. With a scan at rest and one under load, a diagnosis finds what your own model lacks."),
    make("p", { class: "actions" }, demo, scans, own));
};

const submitStudy = async (text, priority) => {
  const job = await send("POST", "/studies", { study: text, priority });
  location.hash = `#/${encodeURIComponent(job.id)}`;
};

// A folder of uploads is named after its first file, in letters that the service accepts.
const folderOf = (files) => {
  const named = files.find((file) => /\.ya?ml$/.test(file.name)) || files[0];
  const stem = named ? named.name.replace(/\..*$/, "") : "";
  return stem.replace(/[^A-Za-z0-9._-]+/g, "-").replace(/^[^A-Za-z0-9]+/, "").slice(0, 40);
};

// Files and their upload folder, whose name is suggested when they are chosen.
const uploadFields = (hint) => {
  const folder = make("input", { type: "text", name: "folder", placeholder: "FOLDER", pattern: "[A-Za-z0-9][A-Za-z0-9._\\-]*" });
  const files = make("input", { type: "file", multiple: "", "aria-label": hint });
  files.addEventListener("change", () => { if (!folder.value) folder.value = folderOf([...files.files]); });
  const send = async () => { for (const file of files.files) await upload(folder.value, file); };
  return { folder, files, send };
};

const submission = () => {
  const text = make("textarea", { name: "study", rows: "18", spellcheck: "false", "aria-label": "study file" });
  text.value = EXAMPLE;
  const file = make("input", { type: "file", accept: ".yaml,.yml" });
  file.addEventListener("change", async () => { if (file.files.length) text.value = await file.files[0].text(); });
  const images = uploadFields("images of the study");
  const priority = make("input", { type: "number", name: "priority", value: "0", min: "-100", max: "100" });
  const form = make("form", { class: "submission" },
    text,
    make("label", {}, "Read it from a file ", file),
    make("fieldset", {}, make("legend", {}, "Images, named FOLDER/FILE in the study"),
      make("label", {}, "files ", images.files), make("label", {}, "folder ", images.folder)),
    make("label", {}, "Priority ", priority),
    make("button", { class: "main" }, "Submit"));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(async () => {
      await images.send();
      await submitStudy(text.value, Number(priority.value));
    });
  });
  return make("details", { class: "submit needs-token" }, make("summary", {}, "Submit a study"), form);
};

const diagnosisForm = () => {
  const scans = uploadFields("case.yaml and scans");
  scans.files.required = true;
  scans.folder.required = true;
  const nodes = make("input", { type: "number", name: "nodes", value: "5000", min: "200", max: "500000" });
  const button = make("button", { class: "main" }, "Upload and diagnose");
  const form = make("form", { class: "submission" },
    make("p", {}, "Choose the scans and the file that describes them, case.yaml. ", make("code", {}, "palpate new diagnosis NAME"), " writes a template."),
    make("fieldset", {}, make("legend", {}, "Case and scans"),
      make("label", {}, "files ", scans.files), make("label", {}, "folder ", scans.folder)),
    make("label", {}, "Nodes of the mesh ", nodes),
    button);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(async () => {
      button.disabled = true;
      try {
        await scans.send();
        const source = { upload: scans.folder.value };
        const job = await send("POST", "/diagnoses", { source, nodes: Number(nodes.value) });
        location.hash = `#/${encodeURIComponent(job.id)}`;
      } finally {
        button.disabled = false;
      }
    });
  });
  return make("details", { class: "submit needs-token" }, make("summary", {}, "Diagnose scans"), form);
};
