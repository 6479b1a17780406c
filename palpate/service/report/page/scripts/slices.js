// Slices through the bodies of a page, all at one place, moved by a slider.

const AXES = ["x", "y", "z"];
// Labels of a comparison: outside, rest of the body, in both, first only, second only.
const WIDE = 1.4; // slices wider than this are drawn two in a row
const [OUTSIDE, BODY, BOTH, FIRST, SECOND] = [0, 1, 2, 3, 4];

// Labels of a plane, rows from the bottom, on the lattice of `frame`.
const planeOf = (volume, view, atMm, frame) => {
  const { shape, spacing, origin, labels } = volume;
  const out = new Uint8Array(frame.columns * frame.rows);
  const plane = Math.round((atMm - origin[view.normal]) / spacing[view.normal]);
  if (plane < 0 || plane >= shape[view.normal]) return out;
  const strides = [1, shape[0], shape[0] * shape[1]];
  const [a, b] = [view.across, view.up];
  for (let row = 0; row < frame.rows; row++) {
    const j = Math.round((frame.start[1] + row * frame.step - origin[b]) / spacing[b]);
    if (j < 0 || j >= shape[b]) continue;
    const base = plane * strides[view.normal] + j * strides[b];
    for (let column = 0; column < frame.columns; column++) {
      const i = Math.round((frame.start[0] + column * frame.step - origin[a]) / spacing[a]);
      if (i >= 0 && i < shape[a]) out[row * frame.columns + column] = labels[base + i * strides[a]];
    }
  }
  return out;
};

// The places of tissues in the first body, in the second, and in both.
const difference = (first, second, tissues) => {
  const compared = new Set(tissues);
  return first.map((label, k) => {
    const [here, there] = [compared.has(label), compared.has(second[k])];
    if (here && there) return BOTH;
    if (here) return FIRST;
    if (there) return SECOND;
    return label || second[k] ? BODY : OUTSIDE;
  });
};

// Where a model has less (FIRST) or more (SECOND) than a scan: outline before gland.
const overlay = (scan, model, gland) =>
  scan.map((label, k) => {
    const other = model[k];
    if (!label !== !other) return label ? FIRST : SECOND;
    if ((label === gland) !== (other === gland)) return label === gland ? FIRST : SECOND;
    if (label === gland) return BOTH;
    return label ? BODY : OUTSIDE;
  });

// Edges between pixels inside and outside of a mask, as the data of an SVG path in pixels.
const edgesOf = (frame, inside) => {
  const { columns, rows } = frame;
  const at = (column, row) => column >= 0 && row >= 0 && column < columns && row < rows && inside(row * columns + column);
  let path = "";
  for (let row = 0; row <= rows; row++)
    for (let column = 0; column < columns; column++) {
      let length = 0;
      while (column + length < columns && at(column + length, row) !== at(column + length, row - 1)) length++;
      if (length) path += `M${column} ${rows - row}h${length}`;
      column += length;
    }
  for (let column = 0; column <= columns; column++)
    for (let row = 0; row < rows; row++) {
      let length = 0;
      while (row + length < rows && at(column, row + length) !== at(column - 1, row + length)) length++;
      if (length) path += `M${column} ${rows - row}v${-length}`;
      row += length;
    }
  return path;
};

// Where two plates cross a slice, in pixels; a slice along the plates meets none. Lines are drawn
// about a pixel outside the body, so as not to hide its skin.
const platesOf = (plates, view, atMm, frame) => {
  const [a, b] = [plates.axis[view.across], plates.axis[view.up]];
  if (Math.hypot(a, b) < 0.05) return "";
  const [left, bottom] = frame.start.map((v) => v - frame.step / 2);
  const pixel = (x, y) => `${(x - left) / frame.step} ${frame.rows - (y - bottom) / frame.step}`;
  const [right, top] = [left + frame.columns * frame.step, bottom + frame.rows * frame.step];
  return plates.heights.map((height, k) => {
    const c = height + (k ? 1 : -1) * frame.step * Math.min(1, frame.columns / 400) - plates.axis[view.normal] * atMm;
    return Math.abs(b) >= Math.abs(a)
      ? `M${pixel(left, (c - a * left) / b)}L${pixel(right, (c - a * right) / b)}`
      : `M${pixel((c - b * bottom) / a, bottom)}L${pixel((c - b * top) / a, top)}`;
  }).join("");
};

// Tissue without a value, in a slice that shows one.
const GREY = [138, 148, 161];

// 1, 2 or 5 times a power of ten, about a fifth of a length.
const roundLength = (mm) => {
  const power = 10 ** Math.floor(Math.log10(mm / 4));
  return power * [5, 2, 1].find((k) => k * power <= mm / 4);
};

const showSlices = async (root, told = payload("slices")) => {
  const sets = await Promise.all(
    told.sets.map(async (set) => {
      const volumes = {};
      for (const [name, v] of Object.entries(set.volumes))
        volumes[name] = { ...v, labels: await unpack(v.labels) };
      const fields = {};
      for (const [name, v] of Object.entries(set.fields))
        fields[name] = { ...v, labels: await unpack(v.labels) };
      return { ...set, volumes, fields };
    }),
  );
  const state = { view: 0, set: 0, choice: told.choices.length ? told.choices[0][0] : "", coloured: "" };
  const lengths = tableOf(told.stops);
  state.at = [...sets[0].at];
  const tissueColours = Object.fromEntries(
    Object.entries(told.labels).map(([label, [, colour]]) => [label, rgba(colour)]),
  );
  const differenceColours = told.differences.map(([, colour]) => rgba(colour));

  const slider = make("input", { type: "range", step: "any", "aria-label": "position of the slice" });
  const place = make("output", { class: "place" });
  const panels = make("div", { class: "panels" });
  const readout = make("p", { class: "readout", "aria-live": "polite" });

  const fieldOf = (name) => sets[state.set].fields[name] || sets[state.set].fields[`${name}:${state.choice}`];
  const named = (name) => (name === "$choice" ? state.choice : name);
  const shown = () => told.panels.filter((p) => p.volumes.every((v) => sets[state.set].volumes[named(v)]));
  const frameOf = (view, volumes) => {
    const box = sets[state.set].box;
    const step = Math.min(volumes[0].spacing[view.across], volumes[0].spacing[view.up]);
    const start = [box[view.across][0] + step / 2, box[view.up][0] + step / 2];
    const count = (axis) => Math.max(1, Math.round((box[axis][1] - box[axis][0]) / step));
    return { step, start, columns: count(view.across), rows: count(view.up) };
  };

  const draw = () => {
    const view = told.views[state.view];
    const { box, volumes } = sets[state.set];
    const range = box[view.normal];
    const step = Object.values(volumes)[0].spacing[view.normal];
    Object.assign(slider, { min: range[0], max: range[1], step, value: state.at[view.normal] });
    place.value = `${AXES[view.normal]} = ${rounded(state.at[view.normal], 1)} mm`;
    root.dataset.at = state.at[view.normal];
    root.dataset.view = view.name;
    const aspect = (box[view.across][1] - box[view.across][0]) / (box[view.up][1] - box[view.up][0]);
    panels.classList.toggle("wide-ones", aspect > WIDE);
    panels.replaceChildren(...shown().map((panel) => drawPanel(panel, view)));
    smoothSmall();
  };

  // Voxels smaller than pixels are averaged: nearest-neighbour sampling leaves holes in thin skin.
  const smoothSmall = () => {
    for (const canvas of panels.querySelectorAll("canvas"))
      canvas.style.imageRendering = canvas.clientWidth * devicePixelRatio < canvas.width ? "auto" : "";
  };

  const drawPanel = (panel, view) => {
    const volumes = panel.volumes.map((name) => sets[state.set].volumes[named(name)]);
    const frame = frameOf(view, volumes);
    const planes = volumes.map((v) => planeOf(v, view, state.at[view.normal], frame));
    let values = planes[0];
    if (panel.kind === "difference") values = difference(planes[0], planes[1], panel.tissues);
    if (panel.kind === "overlay") values = overlay(planes[0], planes[1], panel.tissues[0]);
    const canvas = make("canvas", { width: frame.columns, height: frame.rows, role: "img" });
    const title = panel.title.replace("$choice", (told.choices.find(([k]) => k === state.choice) || ["", ""])[1]);
    canvas.setAttribute("aria-label", `${title}, ${view.name} slice`);
    const field = panel.coloured.includes(state.coloured) ? fieldOf(state.coloured) : null;
    const lengthsHere = field ? planeOf(field, view, state.at[view.normal], frame) : null;
    const image = new ImageData(frame.columns, frame.rows);
    for (let row = 0; row < frame.rows; row++)
      for (let column = 0; column < frame.columns; column++) {
        const at = row * frame.columns + column;
        const value = values[at];
        let colour = panel.kind === "labels" ? tissueColours[value] : differenceColours[value];
        if (field && value)
          colour = lengthsHere[at] ? [...lengths[lengthsHere[at]], 255] : [...GREY, panel.tissues.includes(value) ? 153 : 46];
        if (!colour) continue;
        image.data.set(colour, 4 * ((frame.rows - 1 - row) * frame.columns + column));
      }
    canvas.getContext("2d").putImageData(image, 0, 0);
    canvas.addEventListener("pointermove", (event) => tell(event, canvas, panel, view, frame, values, title));
    canvas.addEventListener("pointerleave", () => (readout.textContent = told.hint));
    const over = makeSvg("svg", { viewBox: `0 0 ${frame.columns} ${frame.rows}`, preserveAspectRatio: "none" });
    const outline = panel.outline && sets[state.set].volumes[panel.outline];
    if (outline) {
      const seen = planeOf(outline, view, state.at[view.normal], frame);
      const compared = new Set(panel.tissues);
      const path = edgesOf(frame, (k) => seen[k] !== 0) + edgesOf(frame, (k) => compared.has(seen[k]));
      over.append(makeSvg("path", { d: path, class: "interface" }));
    }
    const plates = sets[state.set].plates[named(panel.volumes[0])];
    if (plates) over.append(makeSvg("path", { d: platesOf(plates, view, state.at[view.normal], frame), class: "plate" }));
    const mm = roundLength(frame.columns * frame.step);
    const bar = make("div", { class: "scale-bar" });
    bar.style.width = `${(100 * mm) / (frame.columns * frame.step)}%`;
    return make(
      "figure", { class: "panel" }, make("figcaption", {}, title),
      make("div", { class: "slice" }, canvas, over), bar, make("span", {}, `${mm} mm`),
    );
  };

  const scale = make("div", { class: "scale" });
  const drawScale = () => {
    const field = state.coloured && fieldOf(state.coloured);
    scale.hidden = !field;
    if (!field) return;
    const bar = make("span", { class: "bar" });
    bar.style.background = `linear-gradient(to right, ${told.stops.join(",")})`;
    scale.replaceChildren(
      make("span", {}, "0 mm"), bar, make("span", {}, `${rounded(field.end, 1)} mm`),
      make("span", { class: "what" }, told.meanings[state.coloured]),
    );
  };

  const tell = (event, canvas, panel, view, frame, values, title) => {
    const box = canvas.getBoundingClientRect();
    const column = Math.floor(((event.clientX - box.left) / box.width) * frame.columns);
    const row = frame.rows - 1 - Math.floor(((event.clientY - box.top) / box.height) * frame.rows);
    if (column < 0 || row < 0 || column >= frame.columns || row >= frame.rows) return;
    const at = [...state.at];
    at[view.across] = frame.start[0] + column * frame.step;
    at[view.up] = frame.start[1] + row * frame.step;
    const value = values[row * frame.columns + column];
    const names = panel.kind === "labels" ? told.labels[value] : told.differences[value];
    const where = AXES.map((axis, k) => `${axis} ${rounded(at[k], 1)}`).join(", ");
    readout.textContent = `${title} at ${where} mm: ${names ? names[0] : "air"}`;
  };

  slider.addEventListener("input", () => {
    state.at[told.views[state.view].normal] = Number(slider.value);
    draw();
  });
  const controls = make("div", { class: "controls" });
  if (told.views.length > 1) {
    const planes = told.views.map((view, k) => [String(k), view.name]);
    controls.append(switchOf("Plane", "plane", planes, (k) => { state.view = Number(k); draw(); }));
  }
  if (sets.length > 1) {
    const scans = sets.map((set, k) => [String(k), set.name]);
    controls.append(switchOf("Scan", "slice-scan", scans, (k) => {
      state.set = Number(k);
      state.at = [...sets[state.set].at];
      drawScale();
      draw();
    }));
  }
  if (told.choices.length > 1)
    controls.append(switchOf("Model", "slice-choice", told.choices, (k) => { state.choice = k; drawScale(); draw(); }));
  const fields = [...new Set(sets.flatMap((set) => Object.keys(set.fields).map((key) => key.split(":")[0])))];
  if (fields.length) {
    const colours = [["", "tissues"], ...fields.map((name) => [name, name])];
    controls.append(switchOf("Colours", "slice-colour", colours, (k) => { state.coloured = k; drawScale(); draw(); }));
  }
  if (told.views.length > 1 || sets[0].volumes) {
    const label = make("label", { class: "slide" }, make("span", {}, "Slice"), slider, place);
    if (told.flat) label.hidden = true;
    controls.append(label);
  }
  readout.textContent = told.hint;
  root.append(controls, panels, scale, readout);
  drawScale();
  draw();
  new ResizeObserver(smoothSmall).observe(panels);
};
