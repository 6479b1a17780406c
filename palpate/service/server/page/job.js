// The live page of one job: its progress, charts, failures, bodies and workers.

import { address, follow, get, send } from "./api.js";
import { BodiesSection } from "./bodies.js";
import { openCandidate } from "./candidate.js";
import { leftOf, progressOf } from "./jobs.js";
import { convergence, parallel, ranges } from "./plots.js";
import { Points } from "./points.js";
import { attempt, connected } from "./trouble.js";
import { badge, bytes, count, moment, number } from "./words.js";

const FAILURES_AT_FIRST = 30;
const FILE_WORDS = {
  "report.html": "report", "study.yaml": "settings (study.yaml)", "journal.jsonl": "journal (journal.jsonl)",
  "diagnosis.html": "report", "diagnosis.json": "record (diagnosis.json)", "palpate.log": "log (palpate.log)",
};
const ENDED = ["finished", "failed", "cancelled"];
const ACTIONS = {
  pause: ["waiting", "running"], resume: ["paused", "failed"], cancel: ["waiting", "running", "paused", "failed"],
};
const CANCEL = "Cancel this job permanently? Completed work is saved, but the job cannot be resumed.";

const section = (id, title, ...children) => make("section", { id }, make("h2", {}, title), ...children);
const path = (job) => `/jobs/${encodeURIComponent(job)}`;

export const showJob = async (page, id) => {
  let job = await get(path(id));
  const head = headOf(page, id);
  const workers = workersOf();
  const inner = job.kind === "study" ? await studyOf(page, id) : diagnosisOf();
  page.main.append(head.root, ...inner.sections, workers.root);
  const update = (now) => {
    job = now;
    head.update(job);
    inner.update(job);
    workers.update(page.state.cluster);
  };
  update(job);
  const renew = () => workers.update(page.state.cluster);
  document.addEventListener("cluster", renew);
  page.leave.push(() => document.removeEventListener("cluster", renew));
  page.update = update;
  page.watch = () => watch(page, id, inner, update);
  page.watch();
};

// Follows until the job ends.
const watch = (page, id, inner, update) => {
  const end = follow(`${path(id)}/points`, {
    job: update,
    points: inner.add,
    end: () => end(),
    problem: (told) => { end(); attempt(() => { throw new Error(told.error); }); },
  }, connected);
  page.leave.push(end);
};

const headOf = (page, id) => {
  const state = make("span", { role: "status" });
  const buttons = make("div", { class: "actions needs-token" });
  const words = make("p", { class: "note warn", hidden: "" });
  const bar = make("progress", { "aria-label": "progress" });
  const lead = make("p", { class: "lead" });
  const tiles = make("dl", { class: "tiles" });
  const links = make("p", { class: "links" });
  const kind = make("p", { class: "kind" });
  const root = make("header", {}, kind, make("div", { class: "head" }, make("h1", {}, id), state), buttons, words, bar, lead, tiles, links);

  const button = (text, act) => {
    const one = make("button", { type: "button", "data-action": text }, text);
    one.addEventListener("click", () => attempt(act));
    return one;
  };
  const change = (action) => async () => {
    if (action === "cancel" && !confirm(CANCEL)) return;
    const ended = ENDED.includes((await get(path(id))).state);
    page.update(await send("POST", `${path(id)}/${action}`));
    if (ended) page.watch(); // its stream had ended
  };
  const diagnose = async () => {
    const job = await send("POST", "/diagnoses", { source: { study: id } });
    location.hash = `#/${encodeURIComponent(job.id)}`;
  };
  let offered = "";
  const update = (job) => {
    kind.textContent = `${job.kind} of ${job.owner}, submitted ${moment(job.submitted)}, priority ${job.priority}`;
    if (state.textContent !== job.state) state.replaceChildren(badge(job.state));
    const actions = Object.keys(ACTIONS).filter((action) => ACTIONS[action].includes(job.state));
    const diagnosable = job.kind === "study" && job.state === "finished";
    if (offered !== `${actions}${diagnosable}`) {
      offered = `${actions}${diagnosable}`;
      buttons.replaceChildren(...actions.map((action) => button(action, change(action))));
      if (diagnosable) buttons.append(button("diagnose", diagnose));
    }
    words.hidden = !(job.reason || job.note);
    words.textContent = job.reason || job.note;
    const progress = progressOf(job);
    Object.assign(bar, { max: progress.most, value: job.state === "finished" ? progress.most : progress.done });
    lead.textContent = leadOf(job, progress);
    tiles.replaceChildren(...tilesOf(job).map(([term, value, unit]) =>
      make("div", {}, make("dt", {}, term), make("dd", {}, value, unit ? make("small", {}, ` ${unit}`) : ""))));
    const cluster = page.state.cluster;
    links.replaceChildren(...job.files.flatMap((name) => [make("a", { href: address(`${path(id)}/files/${name}`), target: "_blank", rel: "noopener", "data-file": name }, FILE_WORDS[name] || name), " "]));
    if (cluster && cluster.dashboard) links.append(make("a", { class: "dask", href: cluster.dashboard, target: "_blank", rel: "noopener" }, "Dask\u2019s dashboard"));
  };
  return { root, update };
};

const leadOf = (job, progress) => {
  const parts = [];
  if (job.kind === "study") parts.push(`${progress.text} evaluations, ${job.generations} of at most ${job.generations_at_most} generations complete`);
  else if (progress.text) parts.push(progress.text);
  if (job.state === "running" && job.per_minute && !job.stopped)
    parts.push(`${number(job.per_minute, 3)} per minute`, `at most ${leftOf(job)} left`);
  if (job.stopped) parts.push(`ended: ${job.stopped}`);
  return parts.join("; ");
};

const tilesOf = (job) => {
  if (!job.evaluations) return [];
  const { done, diverged, crashed, lost, reused } = job.evaluations;
  const tiles = [["Done", count(done)], ["Diverged", count(diverged)], ["Crashed", count(crashed)], ["Lost", count(lost)], ["Reused", count(reused)]];
  if (job.best) tiles.push([`Best ${job.best.objective}`, number(job.best.value)], ["Jaccard", number(job.best.score.jc, 3)], ["MHD", number(job.best.score.mhd_mm, 3), "mm"]);
  return tiles;
};

const studyOf = async (page, id) => {
  const asked = await get(`${path(id)}/study`);
  const points = new Points();
  const bodies = new BodiesSection(page, id);
  const failures = failuresOf(points, id);
  const readout = make("p", { class: "readout", "aria-live": "polite" });
  const hint = "Point at a dot to see its candidate in all charts, or click it for details. On the keyboard, use the arrow keys.";
  readout.textContent = hint;
  let charts = [];
  const redraw = () => charts.forEach((chart) => chart.redraw());
  const view = {
    score: asked.score,
    pointed: null,
    point: (candidate) => {
      if (candidate === view.pointed) return;
      view.pointed = candidate;
      const p = candidate === null ? null : points.at(candidate);
      readout.textContent = p ? [`candidate ${p.candidate}, generation ${p.generation + 1}`, p.status === "done" ? `${asked.score} ${number(p.score)}` : `${p.status}: ${p.reason}`, ...asked.parameters.map((q, k) => `${q.label}: ${number(p.genes[k])}`)].join("; ") : hint;
      redraw();
    },
    open: (candidate) => openCandidate(id, candidate),
  };
  const figures = ["convergence", "ranges", "parallel"].map(() => make("figure", {}));
  charts = [convergence(figures[0], points, view), ranges(figures[1], points, asked.parameters, view), parallel(figures[2], points, asked.parameters, view)];
  const best = make("button", { type: "button", class: "quiet", hidden: "" }, "open the best candidate");
  best.addEventListener("click", () => view.open(points.bestCandidate));
  const why = make("p", { class: "note", hidden: "" });
  let job = null;
  return {
    sections: [
      section("convergence", "Progress of the search", figures[0], readout, why, best),
      section("parameters", "Parameters between their bounds", figures[1]),
      section("parallel", "Parameters and score together", make("p", {}, "One line for each of the 300 best and the 100 newest candidates; stronger colours are better."), figures[2]),
      bodies.root,
      failures.root,
      section("study", "The study", make("details", {}, make("summary", {}, "Study file, with all defaults"), make("pre", {}, asked.file))),
    ],
    add: (brief) => {
      points.add(brief);
      failures.update();
      redraw();
      if (job) bodies.update(job, points.sessions);
    },
    update: (now) => {
      job = now;
      points.bestCandidate = job.best ? job.best.candidate : null;
      best.hidden = !job.best;
      why.textContent = job.best ? job.best.note : "";
      why.hidden = !why.textContent;
      redraw();
      bodies.update(job, points.sessions);
    },
  };
};

const failuresOf = (points, id) => {
  const body = make("tbody");
  const none = make("p", {}, "None so far.");
  const more = make("button", { type: "button", class: "quiet", hidden: "" });
  const table = make("div", { class: "scroll", hidden: "" }, make("table", { class: "cards" },
    make("thead", {}, make("tr", {}, ...["Candidate", "Generation", "Ending"].map((h) => make("th", {}, h)), make("th", { class: "words" }, "Constants"), make("th", { class: "words" }, "Reason"))), body));
  let [shown, most] = [0, FAILURES_AT_FIRST];
  const row = (p) => {
    const open = make("button", { type: "button", class: "quiet" }, String(p.candidate));
    open.setAttribute("aria-label", `open candidate ${p.candidate}`);
    open.addEventListener("click", () => openCandidate(id, p.candidate));
    const constants = points.genes.map((name, k) => `${name} ${number(p.genes[k])}`).join(", ");
    return make("tr", {}, make("td", {}, open), make("td", { "data-is": "Generation" }, String(p.generation + 1)), make("td", { "data-is": "Ending" }, badge(p.status)),
      make("td", { class: "words", "data-is": "Constants" }, constants), make("td", { class: "words", "data-is": "Reason" }, p.reason));
  };
  const update = () => {
    const { failures } = points;
    for (; shown < Math.min(most, failures.length); shown++) body.append(row(failures[shown]));
    none.hidden = failures.length > 0;
    table.hidden = !failures.length;
    more.hidden = failures.length <= shown;
    more.textContent = `${failures.length - shown} more`;
  };
  more.addEventListener("click", () => { most += 200; update(); });
  return { root: section("failures", "Candidates that failed", none, table, more), update };
};

const diagnosisOf = () => {
  const steps = new Map();
  const list = make("ol", { class: "steps" });
  return {
    sections: [section("steps", "Steps", list)],
    add: (brief) => {
      for (const [phase, done, of, task] of brief.steps) {
        if (!steps.has(phase)) {
          const item = make("li", {});
          steps.set(phase, item);
          list.append(item);
        }
        const bar = make("progress", { max: of || 1, value: done, "aria-label": phase });
        steps.get(phase).replaceChildren(make("span", {}, phase), bar, make("span", { class: "beside" }, `${done} of ${of}${task ? `, ${task}` : ""}`));
      }
    },
    update: () => {},
  };
};

const workersOf = () => {
  const body = make("tbody");
  const none = make("p", {}, "There are none at the moment.");
  const heads = ["Worker", "Running", "Waiting", "CPU", "Memory"];
  const root = section("workers", "Workers", none, make("div", { class: "scroll" }, make("table", { class: "cards" }, make("thead", {}, make("tr", {}, ...heads.map((h) => make("th", {}, h)))), body)));
  const meter = (value, most, text) => make("span", {}, make("meter", { value, max: most || 1, "aria-label": text }), make("span", { class: "beside" }, text));
  const update = (cluster) => {
    const workers = cluster ? cluster.workers : [];
    none.hidden = workers.length > 0;
    none.textContent = (cluster && cluster.trouble) || "There are none at the moment.";
    body.replaceChildren(...workers.map((w) => make("tr", {}, make("td", {}, w.name),
      make("td", { "data-is": "Running" }, String(w.running)), make("td", { "data-is": "Waiting" }, String(w.waiting)),
      make("td", { "data-is": "CPU" }, meter(w.cpu_percent, 100 * w.threads, `${Math.round(w.cpu_percent)} %`)),
      make("td", { "data-is": "Memory" }, meter(w.memory_bytes, w.memory_limit_bytes || w.memory_bytes, w.memory_limit_bytes ? `${bytes(w.memory_bytes)} of ${bytes(w.memory_limit_bytes)}` : bytes(w.memory_bytes))))));
  };
  return { root, update };
};
