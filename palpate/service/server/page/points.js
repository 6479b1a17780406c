// The evaluations of a study as they arrive, each once; sorted by candidate on request.

const scoreOf = (told) => (told === null ? Infinity : told === "-inf" ? -Infinity : told === "inf" ? Infinity : told);

export class Points {
  constructor() {
    Object.assign(this, { all: [], genes: [], failures: [], bestCandidate: null, sessions: 0 });
    this.known = new Set();
    this.sorted = true;
  }

  add(brief) {
    if (brief.genes.length) this.genes = brief.genes;
    this.sessions += brief.sessions;
    for (const [candidate, generation, status, score, genes, reason] of brief.evaluations) {
      if (this.known.has(candidate)) continue; // repeated after a reconnection
      this.known.add(candidate);
      const point = { candidate, generation, status, score: scoreOf(score), genes, reason };
      if (this.all.length && this.all[this.all.length - 1].candidate > candidate) this.sorted = false;
      this.all.push(point);
      if (status !== "done") this.failures.push(point);
    }
  }

  // The best candidate, sent by the service with every change of the job.
  get best() {
    return (this.bestCandidate !== null && this.at(this.bestCandidate)) || null;
  }

  get ordered() {
    if (!this.sorted) this.all.sort((a, b) => a.candidate - b.candidate);
    this.sorted = true;
    return this.all;
  }

  get scored() {
    return this.ordered.filter((point) => point.score < Infinity);
  }

  at(candidate) {
    return this.all.find((point) => point.candidate === candidate);
  }
}
