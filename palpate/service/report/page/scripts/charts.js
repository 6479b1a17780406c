// Interactive charts: the evaluation under the pointer is marked in all charts.

const showCharts = () => {
  const told = payload("evaluations");
  if (!told) return;
  const tip = make("div", { class: "tip", role: "status" });
  tip.hidden = true;
  document.body.append(tip);
  const charts = [...document.querySelectorAll('svg[data-chart="evaluations"]')].map((svg) => {
    const places = new Map();
    for (const path of svg.querySelectorAll("path[data-i]")) {
      const points = path.getAttribute("d").split("M").slice(1).map((text) => text.split("h")[0].split(" ").map(Number));
      path.dataset.i.split(" ").forEach((i, k) => places.set(Number(i), points[k]));
    }
    const ring = document.createElementNS(svg.namespaceURI, "circle");
    ring.setAttribute("r", "7");
    ring.setAttribute("class", "pointed");
    ring.style.display = "none";
    svg.append(ring);
    return { svg, places, ring };
  });

  const words = (i) => {
    const [candidate, generation, score, ...genes] = told.rows[i];
    const lines = [`candidate ${candidate}, generation ${generation}`, `${told.score} ${score}`];
    told.names.forEach((name, k) => lines.push(`${name} ${genes[k]}`));
    return lines;
  };
  const clear = () => {
    tip.hidden = true;
    for (const { ring } of charts) ring.style.display = "none";
  };
  const point = (chart, i) => {
    for (const { places, ring } of charts) {
      const at = places.get(i);
      ring.style.display = at ? "" : "none";
      if (at) { ring.setAttribute("cx", at[0]); ring.setAttribute("cy", at[1]); }
    }
    tip.replaceChildren(...words(i).map((line) => make("div", {}, line)));
    tip.hidden = false;
    tip.dataset.evaluation = i;
    const box = chart.svg.getBoundingClientRect();
    const factor = box.width / chart.svg.viewBox.baseVal.width;
    const [x, y] = chart.places.get(i);
    const left = box.left + x * factor + 14;
    const widest = document.documentElement.clientWidth - tip.offsetWidth - 8;
    tip.style.left = `${Math.max(8, Math.min(left, widest)) + scrollX}px`;
    tip.style.top = `${box.top + y * factor + 12 + scrollY}px`;
  };
  const nearest = (chart, event) => {
    const box = chart.svg.getBoundingClientRect();
    const factor = chart.svg.viewBox.baseVal.width / box.width;
    const [x, y] = [(event.clientX - box.left) * factor, (event.clientY - box.top) * factor];
    let [found, least] = [null, 30 * 30];
    for (const [i, [px, py]] of chart.places) {
      const away = (px - x) ** 2 + (py - y) ** 2;
      if (away < least) [found, least] = [i, away];
    }
    return found;
  };
  for (const chart of charts) {
    if (!chart.places.size) continue;
    const order = [...chart.places.keys()].sort((a, b) => a - b);
    let at = -1;
    chart.svg.setAttribute("tabindex", "0");
    chart.svg.addEventListener("pointermove", (event) => {
      const found = nearest(chart, event);
      if (found === null) clear();
      else point(chart, found);
    });
    chart.svg.addEventListener("pointerleave", clear);
    chart.svg.addEventListener("blur", clear);
    chart.svg.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (event.key === "Escape") clear();
      if (!step) return;
      event.preventDefault();
      at = (at + step + order.length + (at < 0 && step < 0 ? 1 : 0)) % order.length;
      point(chart, order[at]);
    });
  }
};
