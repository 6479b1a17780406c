// Shows the list of jobs or one job, the signed-in user and the state of the cluster.

import { get, send } from "./api.js";
import { showComparison } from "./compare.js";
import { showJob } from "./job.js";
import { showJobs } from "./jobs.js";
import { attempt, complain } from "./trouble.js";

const CLUSTER_EVERY_MS = 3000;
const main = document.getElementById("main");
const state = { owner: "", readToken: false, cluster: null };
let leave = () => {};

// The current view: its element, and the functions that end it. A view left before its first
// answer does not appear in the next one, and nothing of it keeps running.
const newPage = () => {
  const place = make("div");
  const page = { main: place, state, ended: false, ends: [] };
  page.leave = { push: (end) => (page.ended ? end() : page.ends.push(end)) };
  page.end = () => { page.ended = true; page.ends.forEach((end) => end()); };
  main.replaceChildren(place);
  return page;
};

const route = async () => {
  leave();
  leave = () => {};
  document.getElementById("dialog").close();
  main.replaceChildren();
  complain(null);
  if (state.readToken && !state.owner) {
    main.append(make("section", {}, make("h1", {}, "Sign in"), make("p", {}, "Reading needs a token. Create one with `palpate token new NAME`.")));
    return;
  }
  const place = location.hash.replace(/^#\/?/, "");
  const compared = place.match(/^compare\/(.+)$/);
  const job = decodeURIComponent(place);
  document.title = compared ? "Comparison \u00b7 Palpate" : job ? `${job} \u00b7 Palpate` : "Palpate";
  const page = newPage();
  leave = page.end;
  await attempt(() => {
    if (compared) return showComparison(page, compared[1].split(",").map(decodeURIComponent));
    return job ? showJob(page, job) : showJobs(page);
  });
  if (!page.ended) scrollTo(0, 0);
};

const session = document.getElementById("session");

const showSession = () => {
  document.documentElement.classList.toggle("signed-in", Boolean(state.owner));
  if (state.owner) {
    const out = make("button", { type: "button", class: "quiet" }, "sign out");
    out.addEventListener("click", () => attempt(async () => { await send("DELETE", "/session"); await begin(); }));
    session.replaceChildren(make("span", {}, state.owner), out);
    return;
  }
  const form = make("form", { class: "sign-in" });
  const token = make("input", { type: "password", name: "token", required: "", placeholder: "token", "aria-label": "token", autocomplete: "current-password" });
  const user = make("input", { type: "text", name: "user", hidden: "", autocomplete: "username" });
  form.append(user, token, make("button", {}, "sign in"));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(async () => { await send("POST", "/session", { token: token.value.trim() }); await begin(); });
  });
  session.replaceChildren(form);
};

const watchCluster = async () => {
  const place = document.getElementById("cluster");
  if (!document.hidden && !(state.readToken && !state.owner)) {
    try {
      const cluster = (state.cluster = await get("/cluster"));
      place.textContent = cluster.ready ? `${cluster.threads} worker${cluster.threads === 1 ? "" : "s"}, ${cluster.tasks} task${cluster.tasks === 1 ? "" : "s"}` : cluster.trouble || "no cluster";
      place.className = cluster.ready && cluster.threads ? "" : "off";
      document.dispatchEvent(new Event("cluster"));
    } catch {
      place.textContent = "no answer";
      place.className = "off";
    }
  }
  setTimeout(watchCluster, CLUSTER_EVERY_MS);
};

// A token in the address, as `palpate serve` prints it, is exchanged and forgotten.
const begin = async () => {
  const given = location.hash.match(/^#token=(.+)$/);
  if (given) {
    history.replaceState(null, "", "/#/");
    await attempt(() => send("POST", "/session", { token: decodeURIComponent(given[1]) }));
  }
  const known = await attempt(() => get("/session"));
  if (known) Object.assign(state, { owner: known.owner, readToken: known.read_token });
  showSession();
  await route();
};

addEventListener("hashchange", route);
begin();
watchCluster();
