// The evaluations of a study as they come: each once, in order of candidates where asked.

const scoreOf = (gsf) => (gsf === null ? Infinity : gsf === "-inf" ? -Infinity : gsf === "inf" ? Infinity : gsf);

export class Points {
  constructor() {
    Object.assign(this, { all: [], genes: [], failures: [], best: null, sessions: 0 });
    this.known = new Set();
    this.sorted = true;
  }

  add(brief) {
    if (brief.genes.length) this.genes = brief.genes;
    this.sessions += brief.sessions;
    for (const [candidate, generation, status, gsf, genes, reason, level, cost] of brief.evaluations) {
      if (this.known.has(candidate)) continue; // told again after the connection broke
      this.known.add(candidate);
      const point = { candidate, generation, status, gsf: scoreOf(gsf), genes, reason, level: level ?? null, cost };
      if (this.all.length && this.all[this.all.length - 1].candidate > candidate) this.sorted = false;
      this.all.push(point);
      if (status !== "done") this.failures.push(point);
      else if (this.isBetter(point)) this.best = point;
    }
  }

  // As service/search_replay.py says: the study's own resolution before coarser ones, what was
  // fitted by derivatives before the rest, then the lower cost or score.
  isBetter(point) {
    const rank = (p) => [
      p.level === null ? 0 : 1, -(p.level ?? 0), p.cost === null ? 1 : 0, p.cost === null ? p.gsf : scoreOf(p.cost), p.candidate,
    ];
    if (point.gsf === Infinity) return false;
    if (!this.best) return true;
    const [a, b] = [rank(point), rank(this.best)];
    const k = a.findIndex((value, i) => value !== b[i]);
    return k >= 0 && a[k] < b[k];
  }

  get ordered() {
    if (!this.sorted) this.all.sort((a, b) => a.candidate - b.candidate);
    this.sorted = true;
    return this.all;
  }

  get scored() {
    return this.ordered.filter((point) => point.gsf < Infinity);
  }

  at(candidate) {
    return this.all.find((point) => point.candidate === candidate);
  }
}
