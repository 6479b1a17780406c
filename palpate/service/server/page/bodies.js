// Slices and the body in three dimensions, in the viewers of the reports.

import { get } from "./api.js";

const ASK_EVERY_MS = 1500;
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

const legendOf = (title, items) =>
  make("ul", { class: "legend", "aria-label": title }, ...items.map(([colour, text]) => {
    const swatch = make("span", { class: "swatch" });
    swatch.style.background = colour;
    return make("li", {}, swatch, text);
  }));

const viewer = async (name, show, data) => {
  const root = make("div", { class: "viewer", "data-viewer": name });
  return [root, () => show(root, data)];
};

export class BodiesSection {
  constructor(page, job) {
    Object.assign(this, { page, job, shown: undefined, loading: false });
    this.words = make("p", { class: "note", role: "status" });
    this.renew = make("button", { type: "button", class: "quiet", hidden: "" });
    this.place = make("div");
    this.renew.addEventListener("click", () => this.load());
    this.root = make("section", { id: "bodies" }, make("h2", {}, "Target and best candidate"), this.words, this.renew, this.place);
    this.words.textContent = "The body and the target are being prepared.";
  }

  // Shows the first available bodies; newer ones on request.
  update(job, sessions) {
    this.now = [job, sessions];
    const best = this.best;
    if (best === this.shown) this.renew.hidden = true; // the drawing may be newer than this view
    if (!sessions || this.loading || best === this.shown) return;
    if (this.shown === undefined || this.shown === null) {
      this.load();
      return;
    }
    this.renew.hidden = false;
    this.renew.textContent = `show candidate ${best}, now the best`;
  }

  get best() {
    const [job] = this.now;
    return job.best ? job.best.candidate : null;
  }

  async load() {
    if (this.loading) return;
    Object.assign(this, { loading: true, failed: false });
    this.renew.hidden = true;
    try {
      let bodies = await get(`/jobs/${encodeURIComponent(this.job)}/bodies`);
      const waits = () => !bodies.ready || (bodies.candidate === this.shown && this.shown !== this.best);
      while (waits() && !this.page.ended) {
        this.words.textContent = "The bodies are being drawn.";
        await pause(ASK_EVERY_MS);
        bodies = await get(`/jobs/${encodeURIComponent(this.job)}/bodies`);
      }
      if (!this.page.ended) await this.show(bodies);
    } catch (error) {
      this.failed = true;
      this.words.textContent = error.message;
      this.shown = this.shown ?? null;
    }
    this.loading = false;
    if (!this.failed && !this.page.ended) this.update(...this.now); // updates that arrived meanwhile, perhaps the last ones
  }

  async show(bodies) {
    this.shown = bodies.candidate;
    this.words.textContent = bodies.candidate === null ? "No candidate has a score yet." : `Candidate ${bodies.candidate}.`;
    this.place.replaceChildren(...bodies.missing.map((sentence) => make("p", { class: "note" }, sentence)));
    const starts = [];
    if (bodies.slices) {
      this.place.append(legendOf("Tissues", bodies.tissues), legendOf("Difference", bodies.differences));
      starts.push(await viewer("slices", showSlices, bodies.slices));
    }
    if (bodies.body) starts.push(await viewer("body", showBody, bodies.body));
    for (const [root, start] of starts) {
      this.place.append(root);
      await start();
    }
  }
}
