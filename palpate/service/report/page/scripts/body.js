// The body in three dimensions, turned by pointer or keyboard.
//
// This script fills the triangles itself, with a depth buffer: some thousand take a few
// milliseconds, look the same everywhere and need no graphics driver, which browsers without
// a GPU no longer emulate.

const AMBIENT = 0.55;
const MOST_PIXELS = 900000;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const unit = (a) => { const n = Math.hypot(...a) || 1; return a.map((v) => v / n); };

// To the right, up and towards the viewer; the direction of the plates, y, points up.
const cameraOf = ({ azimuth, elevation }) => {
  const [a, e] = [(azimuth * Math.PI) / 180, (elevation * Math.PI) / 180];
  const near = [Math.cos(e) * Math.sin(a), Math.sin(e), Math.cos(e) * Math.cos(a)];
  const across = [Math.cos(a), 0, -Math.sin(a)];
  return { near, across, up: cross(near, across) };
};

const normalsOf = (vertices, triangles) => {
  const normals = new Float32Array(vertices.length);
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
    const u = [0, 1, 2].map((k) => vertices[b + k] - vertices[a + k]);
    const v = [0, 1, 2].map((k) => vertices[c + k] - vertices[a + k]);
    const n = cross(u, v);
    for (const corner of [a, b, c]) for (let k = 0; k < 3; k++) normals[corner + k] += n[k];
  }
  for (let i = 0; i < normals.length; i += 3) {
    const n = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    for (let k = 0; k < 3; k++) normals[i + k] /= n;
  }
  return normals;
};

// Pixels with depth. Corners are [x, y, depth, light, value].
class Raster {
  constructor(width, height) {
    Object.assign(this, { width, height, image: new ImageData(width, height) });
    this.depth = new Float32Array(width * height).fill(-Infinity);
  }

  // `paint` writes the colour of a pixel: (offset in the image, light, value).
  triangle(a, b, c, paint, keepDepth = true) {
    const area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    if (Math.abs(area) < 1e-9) return;
    const left = Math.max(0, Math.floor(Math.min(a[0], b[0], c[0])));
    const right = Math.min(this.width - 1, Math.ceil(Math.max(a[0], b[0], c[0])));
    const top = Math.max(0, Math.floor(Math.min(a[1], b[1], c[1])));
    const bottom = Math.min(this.height - 1, Math.ceil(Math.max(a[1], b[1], c[1])));
    for (let y = top; y <= bottom; y++)
      for (let x = left; x <= right; x++) {
        const u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area;
        const v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area;
        const w = 1 - u - v;
        if (u < -1e-6 || v < -1e-6 || w < -1e-6) continue;
        const depth = u * a[2] + v * b[2] + w * c[2];
        const at = y * this.width + x;
        if (depth <= this.depth[at]) continue;
        if (keepDepth) this.depth[at] = depth;
        paint(4 * at, u * a[3] + v * b[3] + w * c[3], u * a[4] + v * b[4] + w * c[4]);
      }
  }

  // A line, hidden where it is behind the body.
  line(a, b, colour, thick) {
    const steps = Math.ceil(Math.hypot(b[0] - a[0], b[1] - a[1])) || 1;
    const half = thick / 2;
    for (let s = 0; s <= steps; s++) {
      const [x, y, depth] = [0, 1, 2].map((k) => a[k] + (s / steps) * (b[k] - a[k]));
      for (let dy = Math.round(y - half); dy < y + half; dy++)
        for (let dx = Math.round(x - half); dx < x + half; dx++) {
          if (dx < 0 || dy < 0 || dx >= this.width || dy >= this.height) continue;
          const at = dy * this.width + dx;
          if (depth + 0.5 >= this.depth[at]) this.blend(4 * at, colour, 1);
        }
    }
  }

  blend(at, colour, opacity) {
    const data = this.image.data;
    const under = data[at + 3] / 255;
    const total = opacity + under * (1 - opacity);
    for (let k = 0; k < 3; k++)
      data[at + k] = (colour[k] * opacity + data[at + k] * under * (1 - opacity)) / total;
    data[at + 3] = 255 * total;
  }
}

const showBody = async (root, told = payload("body")) => {
  const surfaces = await Promise.all(told.surfaces.map(async (s) => ({
    ...s, triangles: await unpack(s.triangles), rest: await unpack(s.rest),
  })));
  const sets = await Promise.all(told.sets.map(async (set) => ({
    ...set,
    surfaces: await Promise.all(set.surfaces.map(async (one) => {
      const [moved, gap] = [{}, {}];
      for (const [key, packed] of Object.entries(one.moved)) moved[key] = await unpack(packed);
      for (const [key, packed] of Object.entries(one.gap)) gap[key] = await unpack(packed);
      return { moved, gap };
    })),
  })));
  const state = {
    azimuth: -50, elevation: 18, zoom: 1, surface: 0, set: 0, colouring: told.colourings[0].key,
    loaded: told.states.length ? told.states[0][0] : "rest",
    choice: told.choices.length ? told.choices[0][0] : "",
  };
  const tables = Object.fromEntries(told.colourings.filter((c) => c.stops).map((c) => [c.key, tableOf(c.stops)]));
  const cache = new Map();

  const canvas = make("canvas", {
    class: "body", tabindex: "0", role: "img",
    "aria-label": "The body in three dimensions. Arrow keys turn it, plus and minus zoom, 0 resets the view.",
  });
  const scale = make("div", { class: "scale" });
  const context = canvas.getContext("2d");

  const verticesOf = () => {
    const moved = sets[state.set].surfaces[state.surface].moved[state.choice];
    return state.loaded === "rest" || !moved ? surfaces[state.surface].rest : moved;
  };
  const valuesOf = () => {
    const one = sets[state.set].surfaces[state.surface];
    if (state.colouring === "gap") return one.gap[state.choice] || null;
    const moved = one.moved[state.choice];
    if (state.colouring !== "displacement" || !moved) return null;
    const rest = surfaces[state.surface].rest;
    return Float32Array.from({ length: rest.length / 3 }, (_, i) =>
      Math.hypot(...[0, 1, 2].map((k) => moved[3 * i + k] - rest[3 * i + k])));
  };
  const remembered = (key, compute) => {
    if (!cache.has(key)) cache.set(key, compute());
    return cache.get(key);
  };

  const draw = () => {
    const cssWidth = root.clientWidth || 600;
    const cssHeight = Math.round(Math.min(560, Math.max(300, cssWidth * 0.62)));
    const ratio = Math.min(devicePixelRatio || 1, Math.sqrt(MOST_PIXELS / (cssWidth * cssHeight)));
    const [width, height] = [Math.round(cssWidth * ratio), Math.round(cssHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    canvas.style.height = `${cssHeight}px`;
    const raster = new Raster(width, height);
    const camera = cameraOf(state);
    const perMm = (state.zoom * Math.min(width / told.reach[0], height / told.reach[1]));
    const place = (p) => {
      const q = [0, 1, 2].map((k) => p[k] - told.middle[k]);
      return [width / 2 + perMm * dot(q, camera.across), height / 2 - perMm * dot(q, camera.up), dot(q, camera.near)];
    };
    drawSurface(raster, camera, place);
    drawApparatus(raster, camera, place, ratio);
    context.putImageData(raster.image, 0, 0);
    drawLabels(place, ratio);
    drawAxes(camera, ratio);
    root.dataset.azimuth = state.azimuth.toFixed(1);
    root.dataset.elevation = state.elevation.toFixed(1);
    root.dataset.zoom = state.zoom.toFixed(2);
  };

  const drawSurface = (raster, camera, place) => {
    const surface = surfaces[state.surface];
    const key = [state.surface, state.set, state.choice].join();
    const vertices = verticesOf();
    const normals = remembered(`n${key}${state.loaded}`, () => normalsOf(vertices, surface.triangles));
    const values = remembered(`v${key}${state.colouring}`, valuesOf);
    const colouring = told.colourings.find((c) => c.key === state.colouring);
    const table = values && tables[state.colouring];
    const [low, high] = colouring.range || [0, 1];
    const plain = rgba(surface.colour);
    const unknown = rgba(colourOf("--unknown"));
    const lamp = unit([0, 1, 2].map((k) => camera.near[k] + 0.5 * camera.up[k] - 0.5 * camera.across[k]));
    const count = vertices.length / 3;
    const corners = new Array(count);
    for (let i = 0; i < count; i++) {
      const p = place([vertices[3 * i], vertices[3 * i + 1], vertices[3 * i + 2]]);
      const light = Math.abs(normals[3 * i] * lamp[0] + normals[3 * i + 1] * lamp[1] + normals[3 * i + 2] * lamp[2]);
      p.push(AMBIENT + (1 - AMBIENT) * light, values ? (values[i] - low) / (high - low) : 0);
      corners[i] = p;
    }
    const data = raster.image.data;
    const paint = (at, light, value) => {
      let colour = plain;
      if (table) {
        const step = Math.round(STEPS * value);
        colour = Number.isNaN(step) ? unknown : table[step < 0 ? 0 : step > STEPS ? STEPS : step];
      }
      data[at] = colour[0] * light;
      data[at + 1] = colour[1] * light;
      data[at + 2] = colour[2] * light;
      data[at + 3] = 255;
    };
    const t = surface.triangles;
    for (let k = 0; k < t.length; k += 3) raster.triangle(corners[t[k]], corners[t[k + 1]], corners[t[k + 2]], paint);
  };

  const stageOf = () => sets[state.set].stages[state.loaded];

  const drawApparatus = (raster, camera, place, ratio) => {
    const stage = stageOf();
    const sheets = stage.sheets.map((sheet) => ({ ...sheet, at: sheet.corners.map(place) }));
    const far = (sheet) => sheet.at.reduce((sum, p) => sum + p[2], 0);
    for (const sheet of sheets.sort((a, b) => far(a) - far(b))) {
      const colour = rgba(colourOf(sheet.kind === "wall" ? "--wall" : "--plate"));
      const [a, b, c, d] = sheet.at.map((p) => [...p, 1, 0]);
      const paint = (at) => raster.blend(at, colour, 0.2);
      raster.triangle(a, b, c, paint, false);
      raster.triangle(a, c, d, paint, false);
      sheet.at.forEach((p, k) => raster.line(p, sheet.at[(k + 1) % 4], colour, 1.3 * ratio));
    }
    const ink = rgba(colourOf("--vermilion"));
    for (const arrow of stage.arrows) {
      const [from, to] = [place(arrow.from), place(arrow.to)];
      raster.line(from, to, ink, 3 * ratio);
      const along = unit([to[0] - from[0], to[1] - from[1], 0]);
      const size = 9 * ratio * Math.min(1, Math.hypot(to[0] - from[0], to[1] - from[1]) / (12 * ratio));
      const side = [-along[1] * size * 0.6, along[0] * size * 0.6];
      const back = [to[0] - along[0] * size, to[1] - along[1] * size];
      const paint = (at) => raster.blend(at, ink, 1);
      raster.triangle(
        [...to, 1, 0], [back[0] + side[0], back[1] + side[1], to[2], 1, 0],
        [back[0] - side[0], back[1] - side[1], to[2], 1, 0], paint, false,
      );
    }
  };

  const drawLabels = (place, ratio) => {
    context.font = `${12 * ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    const write = (text, p, variable) => {
      const [x, y] = place(p);
      const half = context.measureText(text).width / 2 + 4 * ratio;
      const inside = Math.min(Math.max(x, half), canvas.width - half);
      context.lineWidth = 3 * ratio;
      context.strokeStyle = colourOf("--card");
      context.strokeText(text, inside, Math.min(Math.max(y, 14 * ratio), canvas.height - 6 * ratio));
      context.fillStyle = colourOf(variable);
      context.fillText(text, inside, Math.min(Math.max(y, 14 * ratio), canvas.height - 6 * ratio));
    };
    for (const label of stageOf().labels) write(label.text, label.at, label.kind === "load" ? "--vermilion" : "--soft");
  };

  // The axes of space, in the lower left corner.
  const drawAxes = (camera, ratio) => {
    const [x, y, long] = [38 * ratio, canvas.height - 38 * ratio, 22 * ratio];
    context.strokeStyle = context.fillStyle = colourOf("--soft");
    context.lineWidth = 1.2 * ratio;
    context.textAlign = "center";
    ["x", "y", "z"].forEach((name, k) => {
      const [dx, dy] = [camera.across[k], -camera.up[k]];
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(x + long * dx, y + long * dy);
      context.stroke();
      if (Math.hypot(dx, dy) > 0.25) context.fillText(name, x + 1.4 * long * dx, y + 1.4 * long * dy + 4 * ratio);
    });
  };

  const drawScale = () => {
    const colouring = told.colourings.find((c) => c.key === state.colouring);
    scale.hidden = !colouring.stops;
    if (scale.hidden) return;
    const [low, high] = colouring.range;
    const bar = make("span", { class: "bar" });
    bar.style.background = `linear-gradient(to right, ${colouring.stops.join(",")})`;
    scale.replaceChildren(
      make("span", {}, `${rounded(low, 2)} mm`), bar, make("span", {}, `${rounded(high, 2)} mm`),
      make("span", { class: "what" }, colouring.about),
    );
  };

  let waiting = false;
  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  };
  const turn = (da, de) => {
    state.azimuth = ((state.azimuth + da + 540) % 360) - 180;
    state.elevation = Math.min(89, Math.max(-89, state.elevation + de));
    redraw();
  };
  const zoom = (factor) => { state.zoom = Math.min(6, Math.max(0.4, state.zoom * factor)); redraw(); };
  const look = (azimuth, elevation) => { Object.assign(state, { azimuth, elevation, zoom: 1 }); redraw(); };

  let from = null;
  canvas.addEventListener("pointerdown", (event) => {
    from = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!from) return;
    turn(-0.5 * (event.clientX - from[0]), 0.5 * (event.clientY - from[1]));
    from = [event.clientX, event.clientY];
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (from = null));
  const keys = {
    ArrowLeft: () => turn(10, 0), ArrowRight: () => turn(-10, 0), ArrowUp: () => turn(0, -10),
    ArrowDown: () => turn(0, 10), "+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2),
    0: () => look(-50, 18),
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });

  const controls = make("div", { class: "controls" });
  const set = (key) => (value) => { state[key] = value; drawScale(); redraw(); };
  const numbered = (list) => list.map((one, k) => [String(k), one.name]);
  if (surfaces.length > 1) controls.append(switchOf("Surface", "surface", numbered(surfaces), (k) => set("surface")(Number(k))));
  if (sets.length > 1) controls.append(switchOf("Scan", "body-scan", numbered(sets), (k) => set("set")(Number(k))));
  if (told.states.length > 1) controls.append(switchOf("Shape", "shape", told.states, set("loaded")));
  if (told.choices.length > 1) controls.append(switchOf("Model", "body-choice", told.choices, set("choice")));
  if (told.colourings.length > 1)
    controls.append(switchOf("Colour", "colour", told.colourings.map((c) => [c.key, c.title]), set("colouring")));
  const views = make("div", { class: "switch views" });
  for (const [text, azimuth, elevation] of [["from the nipple", 0, 0], ["from the side", -90, 0], ["from above", 0, 89], ["reset", -50, 18]]) {
    const button = make("button", { type: "button" }, text);
    button.addEventListener("click", () => look(azimuth, elevation));
    views.append(button);
  }
  const hint = make("p", { class: "readout" }, "Drag to rotate, or focus it and use the arrow keys; + and \u2212 zoom.");
  root.append(controls, make("div", { class: "stage" }, canvas), scale, views, hint);
  drawScale();
  draw();
  new ResizeObserver(redraw).observe(root);
  onScheme(redraw);
};
