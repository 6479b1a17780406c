// Shared by the viewers of a page: elements, switches, and arrays packed into the page.
"use strict";

const make = (tag, attributes = {}, ...children) => {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
};

// The same for SVG; the namespace is taken from the parser, so the page contains no URL.
const makeSvg = (tag, attributes = {}) => {
  const holder = make("div");
  holder.innerHTML = "<svg></svg>";
  const element = document.createElementNS(holder.firstChild.namespaceURI, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
};

// A row of radio buttons; `choose` is called with the value of the chosen one.
const switchOf = (title, name, options, choose) => {
  const set = make("fieldset", { class: "switch" }, make("legend", {}, title));
  options.forEach(([value, text], index) => {
    const input = make("input", { type: "radio", name, value });
    input.checked = index === 0;
    input.addEventListener("change", () => choose(value));
    set.append(make("label", {}, input, make("span", {}, text)));
  });
  return set;
};

const TYPES = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, f4: Float32Array };

// An array of the page: base64 of a zlib stream of little-endian numbers.
const unpack = async (packed) => {
  const bytes = Uint8Array.from(atob(packed.data), (c) => c.charCodeAt(0));
  const inflated = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new TYPES[packed.type](await new Response(inflated).arrayBuffer());
};

const payload = (id) => {
  const script = document.getElementById(`${id}-data`);
  return script ? JSON.parse(script.textContent) : null;
};

const colourOf = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Red, green, blue (0 to 255) and opacity (0 to 255) of #rgb, #rrggbb or #rrggbbaa.
const rgba = (text) => {
  let digits = text.trim().replace("#", "");
  if (digits.length === 3) digits = [...digits].map((d) => d + d).join("");
  digits = digits.padEnd(8, "f");
  return [0, 2, 4, 6].map((k) => parseInt(digits.slice(k, k + 2), 16));
};

const STEPS = 255;

// A table of STEPS + 1 colours between stops.
const tableOf = (stops) => {
  const colours = stops.map(rgba);
  return Array.from({ length: STEPS + 1 }, (_, k) => {
    const place = (k / STEPS) * (colours.length - 1);
    const i = Math.min(Math.floor(place), colours.length - 2);
    return [0, 1, 2].map((c) => colours[i][c] + (place - i) * (colours[i + 1][c] - colours[i][c]));
  });
};

const rounded = (value, digits) => {
  const text = (Math.round(value * 10 ** digits) / 10 ** digits + 0).toFixed(digits);
  return text.replace("-", "\u2212");
};

// Colours from the style sheet are reread when the colour scheme changes.
const onScheme = (redraw) =>
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
