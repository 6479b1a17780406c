// Numbers, times and states formatted for readers, as in palpate/service/number_formatting.py.

export const number = (value, digits = 4) => {
  if (value === null || value === undefined || value === "nan") return "\u2013";
  if (value === "inf" || value === Infinity) return "\u221e";
  if (value === "-inf" || value === -Infinity) return "\u2212\u221e";
  const text = Math.abs(value) >= 10 ** digits ? value.toFixed(0) : String(Number(value.toPrecision(digits)));
  return text.replace("-", "\u2212");
};

export const count = (value) => String(value).replace(/\B(?=(\d{3})+$)/g, "\u202f");

export const duration = (seconds) => {
  if (seconds < 100) return `${Math.round(seconds)} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min`;
  if (seconds < 86400) return `${Math.floor(seconds / 3600)} h ${Math.floor((seconds % 3600) / 60)} min`;
  return `${Math.floor(seconds / 86400)} d ${Math.floor((seconds % 86400) / 3600)} h`;
};

export const bytes = (value) => (value >= 2 ** 30 ? `${(value / 2 ** 30).toFixed(1)} GB` : `${Math.round(value / 2 ** 20)} MB`);

export const moment = (iso) => new Date(iso).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });

export const badge = (state) => make("span", { class: `badge ${state}` }, state);

export const ended = (evaluations) =>
  evaluations.done + evaluations.diverged + evaluations.crashed + evaluations.lost;
