// Starts the viewers; if one cannot start, the page keeps its pictures.

const start = async (name, show) => {
  const root = document.querySelector(`[data-viewer="${name}"]`);
  if (!root) return;
  root.hidden = false;
  try {
    await show(root);
    document.documentElement.classList.add(`has-${name}`);
  } catch (error) {
    root.replaceChildren();
    root.hidden = true;
    console.warn(`The viewer of ${name} cannot run here, so the page shows pictures.`, error);
  }
};

// The page of a running search is rewritten: reload it while the reader is inactive.
const keepFresh = () => {
  const seconds = Number(document.documentElement.dataset.refresh);
  if (!seconds) return;
  let touched = 0;
  for (const kind of ["pointerdown", "pointermove", "keydown", "scroll"])
    addEventListener(kind, () => (touched = Date.now()), { passive: true });
  setInterval(() => { if (Date.now() - touched > 1000 * seconds) location.reload(); }, 1000 * seconds);
};

showCharts();
showDownloads();
start("slices", showSlices);
start("body", showBody);
keepFresh();
