// Buttons that save a chart: as an image (PNG), as a drawing (SVG), and its numbers (CSV).

// Style properties that a drawing needs in a separate file, without the style sheet.
const STYLED = [
  "fill", "fill-opacity", "stroke", "stroke-width", "stroke-opacity", "stroke-dasharray", "stroke-linecap",
  "stroke-linejoin", "vector-effect", "font-family", "font-size", "font-weight", "opacity", "display", "image-rendering",
];
const IMAGE_SCALE = 2;

const save = (name, content, type) => {
  const address = URL.createObjectURL(new Blob([content], { type }));
  make("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
};

// A drawing with inline styles, on the background colour of the page.
const standalone = (svg) => {
  const copy = svg.cloneNode(true);
  const [from, to] = [svg, copy].map((root) => [root, ...root.querySelectorAll("*")]);
  from.forEach((element, k) => {
    const style = getComputedStyle(element);
    for (const name of STYLED) to[k].style.setProperty(name, style.getPropertyValue(name));
  });
  copy.style.display = "block"; // the narrow page hides the wide form, which is the one saved
  const { width, height } = svg.viewBox.baseVal;
  for (const [name, value] of Object.entries({ width, height })) copy.setAttribute(name, value);
  const paper = makeSvg("rect", { width, height });
  paper.style.fill = colourOf("--card");
  copy.prepend(paper);
  return { text: new XMLSerializer().serializeToString(copy), width, height };
};

const savePng = async (name, svg) => {
  const { text, width, height } = standalone(svg);
  const image = new Image();
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(text)}`;
  await image.decode();
  const canvas = make("canvas", { width: IMAGE_SCALE * width, height: IMAGE_SCALE * height });
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  canvas.toBlob((blob) => save(name, blob, "image/png"));
};

// Rows as in RFC 4180; typographic minus signs become ASCII.
const csv = (rows) => rows.map((row) => row.map((cell) => {
  const text = cell === null ? "" : String(cell).replace(/^\u2212/, "-");
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}).join(",") + "\r\n").join("");

const rowsOf = (figure, svg) => {
  const table = figure.querySelector("script.table");
  if (table) return JSON.parse(table.textContent);
  const told = svg.dataset.chart === "evaluations" && payload("evaluations");
  return told ? [["candidate", "generation", told.score, ...told.names], ...told.rows] : null;
};

const showDownloads = () => {
  const page = document.title.split(" \u00b7 ")[0];
  const numbers = new Map();
  for (const figure of document.querySelectorAll("main figure")) {
    const svg = figure.querySelector(":scope > svg.chart");
    if (!svg || figure.closest(".still")) continue;
    const section = (figure.closest("section") || { id: "chart" }).id;
    numbers.set(section, (numbers.get(section) || 0) + 1);
    const name = `${page}-${section}-${numbers.get(section)}`.replace(/[^\w.-]+/g, "_");
    const row = make("div", { class: "save" });
    const button = (kind, act) => {
      const one = make("button", { type: "button", "aria-label": `Save this chart as ${kind}` }, kind);
      one.addEventListener("click", act);
      row.append(one);
    };
    button("PNG", () => savePng(`${name}.png`, svg));
    button("SVG", () => save(`${name}.svg`, standalone(svg).text, "image/svg+xml"));
    const rows = rowsOf(figure, svg);
    if (rows) button("CSV", () => save(`${name}.csv`, csv(rows), "text/csv"));
    figure.append(row);
  }
};
