// The charts of a study: scores over candidates, the best values between the bounds, and
// parallel coordinates of parameters and score.

import { Chart, limits, scale, ticks, tickText } from "./canvas.js";
import { number } from "./words.js";

const [LEFT, RIGHT, TOP, BOTTOM] = [54, 12, 34, 40];
const NEAR_PX = 18;
const [ROW, NARROW_ROW] = [58, 84];
const SHADES = 5; // from worst to best
const BEST_LINES = 300;
const NEWEST_LINES = 100;

const legend = (chart, items) => {
  let x = LEFT;
  for (const [mark, colour, text] of items) {
    if (mark === "line") chart.line([[x, 14], [x + 16, 14]], colour, 2.2);
    else if (mark === "cross") chart.cross(x + 8, 14, colour);
    else chart.dot(x + 8, 14, colour, mark === "large" ? 5.5 : 3);
    chart.text(text, x + 22, 18);
    x += 40 + chart.context.measureText(text).width;
  }
};

// Scores of all evaluations and the best so far; failures are drawn along the top.
export const convergence = (root, points, view) => {
  let places = new Map();
  const draw = (chart) => {
    const all = points.ordered;
    const last = Math.max(1, all.length ? all[all.length - 1].candidate : 1);
    const across = scale(0, last, LEFT + 4, chart.width - RIGHT);
    const [low, high] = limits(all.map((p) => p.score));
    const up = scale(low, high, chart.height - BOTTOM, TOP);
    for (const value of ticks(low, high, 6)) {
      chart.line([[LEFT, up(value)], [chart.width - RIGHT, up(value)]], "rule", 0.8);
      chart.text(tickText(value), LEFT - 8, up(value) + 4, { align: "right" });
    }
    for (const value of ticks(0, last, Math.min(10, chart.width / 70)))
      chart.text(tickText(value), across(value), chart.height - BOTTOM + 18, { align: "center" });
    chart.text("candidate, in order of proposal", (LEFT + chart.width - RIGHT) / 2, chart.height - 6, { align: "center" });
    const items = [["dot", "grey", "evaluation"], ["line", "blue", "lowest so far"]];
    legend(chart, points.failures.length ? [...items, ["cross", "vermilion", "failed"]] : items);
    chart.text(view.score, LEFT - 8, 18, { align: "right" });
    places = new Map();
    const size = all.length > 4000 ? 2 : all.length > 300 ? 3.5 : 6;
    let best = Infinity;
    const steps = [];
    chart.context.globalAlpha = all.length > 4000 ? 0.45 : 0.65;
    for (const p of all) {
      const x = across(p.candidate);
      const y = p.score === Infinity ? TOP : p.score === -Infinity ? chart.height - BOTTOM : up(p.score);
      places.set(p.candidate, [x, y]);
      if (p.score === Infinity) continue;
      chart.context.fillStyle = chart.colour("grey");
      chart.context.fillRect(x - size / 2, y - size / 2, size, size);
      if (p.score < best) {
        if (steps.length) steps.push([x, steps[steps.length - 1][1]]);
        steps.push([x, y]);
        best = p.score;
      }
    }
    chart.context.globalAlpha = 1;
    for (const p of points.failures) chart.cross(...places.get(p.candidate), "vermilion");
    if (steps.length) chart.line([...steps, [chart.width - RIGHT, steps[steps.length - 1][1]]], "blue", 2.2);
    if (places.has(view.pointed)) chart.ring(...places.get(view.pointed));
    chart.canvas.dataset.drawn = all.length;
    chart.canvas.setAttribute("aria-label", `Scores of ${all.length} evaluations; the best is ${number(best)}. Use the arrow keys to move between them and Enter to open one.`);
  };
  const place = (x, y) => {
    let [found, least] = [null, NEAR_PX ** 2];
    for (const [candidate, [px, py]] of places) {
      const away = (px - x) ** 2 + (py - y) ** 2;
      if (away < least) [found, least] = [candidate, away];
    }
    return found;
  };
  return new Chart(root, {
    name: "convergence", height: (width) => (width < 600 ? 280 : 330), draw, place,
    order: () => points.ordered.map((p) => p.candidate), pointed: view.point, open: view.open,
  });
};

// Every parameter between its bounds: the best tenth, the best, and the target if known.
export const ranges = (root, points, parameters, view) => {
  const draw = (chart) => {
    const narrow = chart.width < 600;
    const scored = [...points.scored].sort((a, b) => a.score - b.score);
    const good = scored.slice(0, Math.max(2, Math.ceil(scored.length / 10)));
    const labels = parameters.map((p) => { chart.text("", 0, 0, { size: 14 }); return chart.context.measureText(p.label).width; });
    const left = narrow ? 8 : 24 + Math.max(...labels);
    const row = narrow ? NARROW_ROW : ROW;
    const items = [["large", "blue", "best so far"], ["dot", "grey", "best tenth"]];
    const known = parameters.some((p) => p.target !== null);
    legend(chart, known ? [...items, ["line", "ink", "target"]] : items);
    parameters.forEach((p, k) => {
      const y = TOP + row * k + row / 2 + (narrow ? 12 : 0);
      const at = scale(p.lower, p.upper, left + 6, chart.width - RIGHT - 6);
      if (narrow) chart.text(p.label, left, y - 29, { size: 14, colour: "ink" });
      else chart.text(p.label, left - 16, y + 5, { size: 14, colour: "ink", align: "right" });
      chart.context.lineCap = "round";
      chart.line([[left + 6, y], [chart.width - RIGHT - 6, y]], "rule", 7);
      chart.context.lineCap = "butt";
      chart.context.globalAlpha = 0.6;
      for (const one of good) chart.line([[at(one.genes[k]), y - 5], [at(one.genes[k]), y + 5]], "grey", 1.5);
      chart.context.globalAlpha = 1;
      if (p.target !== null) chart.line([[at(p.target), y - 10], [at(p.target), y + 10]], "ink", 2, [2, 2]);
      chart.text(tickText(p.lower), left, y + 22, { size: 11 });
      chart.text(tickText(p.upper), chart.width - RIGHT, y + 22, { size: 11, align: "right" });
      if (points.best) {
        const x = at(points.best.genes[k]);
        chart.dot(x, y, "blue", 5.5);
        const beside = Math.min(Math.max(x, left + 24), chart.width - RIGHT - 24);
        chart.text(number(points.best.genes[k]), beside, y - 11, { align: "center", colour: "blue", weight: "600", size: 13 });
      }
      const shown = view.pointed === null ? null : points.at(view.pointed);
      if (shown) chart.ring(at(shown.genes[k]), y);
    });
    const said = parameters.map((p, k) => `${p.label}: ${points.best ? number(points.best.genes[k]) : "none yet"}, searched from ${tickText(p.lower)} to ${tickText(p.upper)}`);
    chart.canvas.setAttribute("aria-label", said.join("; "));
  };
  const height = (width) => TOP + 8 + parameters.length * (width < 600 ? NARROW_ROW : ROW);
  return new Chart(root, { name: "ranges", height, draw });
};

// Parallel coordinates of parameters and score, for the best and the newest candidates.
export const parallel = (root, points, parameters, view) => {
  const draw = (chart) => {
    const axes = [...parameters.map((p) => p.label), view.score];
    const scored = points.scored;
    const ranked = [...scored].sort((a, b) => b.score - a.score);
    const chosen = new Set(ranked.slice(-BEST_LINES));
    for (const p of scored.slice(-NEWEST_LINES)) chosen.add(p);
    const [low, high] = limits([...chosen].map((p) => p.score));
    const [top, bottom] = [46, chart.height - 26];
    const x = scale(0, axes.length - 1, 40, chart.width - 40);
    const ups = [...parameters.map((p) => scale(p.lower, p.upper, bottom, top)), scale(low, high, bottom, top)];
    const path = (p) => [...p.genes, Math.max(p.score, low)].map((value, k) => [x(k), ups[k](value)]);
    const shown = ranked.filter((p) => chosen.has(p)); // the best are drawn last
    chart.context.globalAlpha = shown.length > 60 ? 0.5 : 0.8;
    shown.forEach((p, k) => chart.line(path(p), `age${Math.floor((SHADES * k) / shown.length)}`, 1.1));
    chart.context.globalAlpha = 1;
    if (points.best) chart.line(path(points.best), "blue", 2.6);
    const pointed = view.pointed === null ? null : points.at(view.pointed);
    if (pointed && pointed.score < Infinity) chart.line(path(pointed), "vermilion", 2.6);
    axes.forEach((label, k) => {
      const align = k === 0 ? "left" : k === axes.length - 1 ? "right" : "center";
      const at = k === 0 ? 4 : k === axes.length - 1 ? chart.width - 4 : x(k);
      chart.line([[x(k), top], [x(k), bottom]], "axis", 1.2);
      const long = chart.width / axes.length < 92;
      chart.text(long ? label.split(",")[0] : label, at, long && k % 2 ? 18 : 34, { align, colour: "ink" });
      const [from, to] = k < parameters.length ? [parameters[k].lower, parameters[k].upper] : [low, high];
      const digits = (value) => number(value, 3);
      chart.text(digits(from), x(k), bottom + 16, { align: "center", size: 11 });
      chart.text(digits(to), x(k) + 4, top + 4, { size: 11 });
    });
    chart.canvas.dataset.drawn = shown.length;
    chart.canvas.setAttribute("aria-label", `Parallel coordinates of ${shown.length} candidates through ${axes.join(", ")}; stronger colours are better.`);
  };
  return new Chart(root, { name: "parallel", height: (width) => (width < 600 ? 260 : 320), draw });
};
