// A chart on a canvas that is redrawn at most once a frame.
//
// Twenty thousand dots drawn as filled squares take 5 to 10 ms; as SVG elements they take seconds.

export const ticks = (low, high, most) => {
  const rough = (high - low) / Math.max(1, most);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((k) => k * power >= rough * 0.999) * power;
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
};

export const tickText = (value) => String(Number(value.toPrecision(6))).replace("-", "\u2212");

// From values to pixels.
export const scale = (low, high, from, to) => {
  const span = high - low || 1;
  return (value) => from + ((value - low) / span) * (to - from);
};

// An interval around finite values, with margins.
export const limits = (values) => {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
  if (low > high) return [-1, 0];
  const room = 0.06 * (high - low) || Math.max(1, Math.abs(high)) * 0.06;
  return [low - room, high + room];
};

export class Chart {
  // `draw(chart)` draws all; `place(x, y)` returns the candidate at a point; `pointed(candidate)` is
  // called under the pointer, `open(candidate)` on a click; `order()` is used by the arrow keys.
  constructor(root, { name, height, draw, place, order, pointed, open }) {
    Object.assign(this, { root, heightOf: height, drawAll: draw });
    this.canvas = make("canvas", { class: "chart", "data-chart": name, role: "img", "aria-label": name });
    this.context = this.canvas.getContext("2d");
    root.append(this.canvas);
    this.waiting = false;
    this.observer = new ResizeObserver(() => this.redraw());
    this.observer.observe(root);
    onScheme(() => this.redraw());
    if (place) this.listen(place, order, pointed, open);
  }

  listen(place, order, pointed, open) {
    const at = (event) => {
      const box = this.canvas.getBoundingClientRect();
      return place(event.clientX - box.left, event.clientY - box.top);
    };
    let key = -1;
    this.canvas.tabIndex = 0;
    this.canvas.addEventListener("pointermove", (event) => pointed(at(event)));
    this.canvas.addEventListener("pointerleave", () => pointed(null));
    this.canvas.addEventListener("blur", () => pointed(null));
    this.canvas.addEventListener("click", (event) => { const found = at(event); if (found !== null) open(found); });
    this.canvas.addEventListener("keydown", (event) => {
      const all = order();
      const step = { ArrowRight: 1, ArrowLeft: -1, Home: -Infinity, End: Infinity }[event.key];
      if (event.key === "Enter" && key >= 0 && key < all.length) open(all[key]);
      if (event.key === "Escape") pointed(null);
      if (!step || !all.length) return;
      event.preventDefault();
      key = Math.min(all.length - 1, Math.max(0, key + step));
      pointed(all[key]);
    });
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; if (this.canvas.isConnected) this.paint(); });
  }

  paint() {
    this.width = Math.max(240, this.root.clientWidth);
    this.height = this.heightOf(this.width);
    const ratio = devicePixelRatio || 1;
    const [width, height] = [Math.round(this.width * ratio), Math.round(this.height * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    Object.assign(this.canvas.style, { width: `${this.width}px`, height: `${this.height}px` });
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.context.clearRect(0, 0, this.width, this.height);
    this.colours = new Map();
    this.drawAll(this);
  }

  colour(name) {
    if (!this.colours.has(name)) this.colours.set(name, colourOf(`--${name}`));
    return this.colours.get(name);
  }

  text(text, x, y, { align = "left", size = 12, colour = "soft", weight = "" } = {}) {
    const { context } = this;
    context.font = `${weight} ${size}px system-ui, -apple-system, "Segoe UI", Roboto, Arial, sans-serif`;
    context.textAlign = align;
    context.fillStyle = this.colour(colour);
    context.fillText(text, x, y);
  }

  line(points, colour, width = 1, dash = []) {
    const { context } = this;
    context.beginPath();
    points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
    context.setLineDash(dash);
    context.strokeStyle = this.colour(colour);
    context.lineWidth = width;
    context.stroke();
    context.setLineDash([]);
  }

  dot(x, y, colour, radius) {
    this.context.fillStyle = this.colour(colour);
    this.context.beginPath();
    this.context.arc(x, y, radius, 0, 2 * Math.PI);
    this.context.fill();
  }

  ring(x, y) {
    this.context.beginPath();
    this.context.arc(x, y, 6.5, 0, 2 * Math.PI);
    this.context.strokeStyle = this.colour("vermilion");
    this.context.lineWidth = 2;
    this.context.stroke();
  }

  cross(x, y, colour, half = 3.5) {
    this.line([[x - half, y - half], [x + half, y + half]], colour, 1.5);
    this.line([[x - half, y + half], [x + half, y - half]], colour, 1.5);
  }
}
