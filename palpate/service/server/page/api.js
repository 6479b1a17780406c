// Requests to the API of the service that serves this page.

const PREFIX = "/api/v1";

export class Refused extends Error {
  constructor(status, message) {
    super(message);
    this.status = status;
  }
}

const answered = async (request) => {
  let response;
  try {
    response = await request;
  } catch {
    throw new Refused(0, "The service does not answer. This page will continue when it is back.");
  }
  if (response.status === 204) return null;
  const text = await response.text();
  let record;
  try {
    record = JSON.parse(text);
  } catch {
    record = { error: text.slice(0, 200) };
  }
  if (!response.ok) throw new Refused(response.status, record.error || response.statusText);
  return response.status === 202 ? { ...record, ready: false } : record;
};

export const get = (path) => answered(fetch(PREFIX + path));

export const send = (method, path, body) =>
  answered(fetch(PREFIX + path, {
    method,
    headers: body === undefined ? {} : { "Content-Type": "application/json" },
    body: body === undefined ? undefined : JSON.stringify(body),
  }));

export const upload = (folder, file) =>
  answered(fetch(`${PREFIX}/uploads/${encodeURIComponent(folder)}/${encodeURIComponent(file.name)}`, {
    method: "PUT", body: file,
  }));

export const address = (path) => PREFIX + path;

// Follows server-sent events: `on` maps their kinds to functions. If the connection breaks, the
// browser reconnects and continues. Returns a function that ends it.
export const follow = (path, on, connected) => {
  const source = new EventSource(PREFIX + path);
  for (const [kind, act] of Object.entries(on))
    source.addEventListener(kind, (event) => act(JSON.parse(event.data)));
  source.addEventListener("open", () => connected(true));
  source.addEventListener("error", () => connected(false));
  return () => source.close();
};
