// The cell as this page knows it, and the way to it: one stream of events, requests with JSON.
//
// `state` is the last of everything; `on(kind, f)` calls f at every change of a kind. A stream without a beat
// for 1.1 s is stale: the page says so, and of its orders only stops go out.

export const state = { me: null, cell: null, status: null, arm: null, sight: null, control: null, sentences: [], vacuum: null, found: null, picture: 0, beat: null, stale: true };
const listeners = {};
let source = null;
let heard = 0;

export function on(kind, listener) {
  (listeners[kind] ??= new Set()).add(listener);
  return () => listeners[kind].delete(listener);
}

export function emit(kind) {
  for (const listener of [...(listeners[kind] ?? [])]) listener();
}

// A cookie goes to every port of its computer; what is stored here is read by this page's origin alone.
const SECRET = "celld-page";

/** A session for the ticket of a link. */
export async function signIn(ticket) {
  const { page } = await api("sign-in", { body: { ticket } });
  localStorage.setItem(SECRET, page);
}

/** A request; throws an Error with what the cell said. */
export async function api(path, options = {}) {
  const headers = options.body === undefined ? {} : { "content-type": "application/json" };
  const secret = localStorage.getItem(SECRET);
  if (secret) headers["x-celld-page"] = secret;
  const body = options.body === undefined ? undefined : JSON.stringify(options.body);
  let answer;
  try {
    // No answer is an answer too: whoever pressed Stop has to know.
    const signal = AbortSignal.timeout(options.within ?? 30000);
    answer = await fetch("/api/v1/" + path, { method: options.method ?? (body ? "POST" : "GET"), headers, body, signal });
  } catch {
    throw new Error("no answer from celld");
  }
  const content = await answer.json().catch(() => ({}));
  if (!answer.ok) {
    const error = new Error(content.error ?? content.message ?? `HTTP ${answer.status}`);
    error.status = answer.status;
    error.hint = content.hint;
    throw error;
  }
  return content;
}

/** What lets the cell begin something: not by a person who does not see the present. */
export async function handIn(path, body) {
  if (state.stale) throw new Error(OLD);
  return api(path, { method: "POST", body });
}

const OLD = "what is shown is old: only what stops is sent";

/** An order to the cell: what it answers, accepted or not. */
export async function order(command, more = {}) {
  try {
    const stops = ["abort", "disarm", "pause"].includes(command.do);
    // Nothing but a stop is given by who does not see the present; the daemon refuses it too, a little later.
    if (state.stale && !stops) return { accepted: false, message: OLD };
    return await api("orders", { body: { command, beat: state.beat, ...more }, within: stops ? 5000 : 20000 });
  } catch (error) {
    return { accepted: false, message: error.message };
  }
}

const kinds = {
  status: (data) => { state.status = data; },
  arm: (data) => { state.arm = data; },
  sight: (data) => { state.sight = data; },
  carried: (data) => {
    if (state.sight) state.sight.carried = data;
    if (state.arm) state.arm.carried = data.find(({ held }) => held) ?? null;
  },
  control: (data) => { state.control = data; },
  vacuum: (data) => { state.vacuum = data; },
  picture: (data) => { state.picture = data; },
  sentences: (data) => { state.sentences = data; },
  sentence: (data) => { state.sentences = [...state.sentences, data].slice(-200); },
  found: (data) => { state.found = data; },
  beat: (data) => { state.beat = data; },
};

export async function reload() {
  state.me = await api("me");
  state.cell = await api("cell");
  emit("me");
  emit("cell");
}

// Browsers have six connections to a page's server for all its tabs: one that is not looked at gives its own
// back.
document.addEventListener("visibilitychange", () => {
  if (!source) return;
  if (document.hidden) source.close();
  else connect();
});

export function connect() {
  source?.close();
  source = new EventSource("/api/v1/events");
  heard = performance.now();
  for (const [kind, take] of Object.entries(kinds)) {
    source.addEventListener(kind, (event) => {
      const before = state.status?.daemon;
      take(JSON.parse(event.data));
      // Another celld may have another cell, and another page.
      if (kind === "status" && before && state.status && state.status.daemon !== before) location.reload();
      // Only a beat says that what is shown is of now.
      if (kind === "beat") {
        heard = performance.now();
        if (state.stale) { state.stale = false; emit("stale"); }
      }
      emit(kind === "sentence" ? "sentences" : kind);
    });
  }
  source.addEventListener("cell", () => reload().catch(() => {}));
}

// The browser comes back by itself unless it was refused: a celld that was started anew is found again, and
// its page may be another one.
setInterval(async () => {
  if (!source) return;
  if (document.hidden) return;
  const silent = performance.now() - heard;
  if (silent > 1100 && !state.stale) { state.stale = true; emit("stale"); }
  if (state.stale && source.readyState === EventSource.CLOSED && silent > 3000) {
    heard = performance.now();
    try {
      await reload();
      connect();
    } catch (error) {
      if (error.status === 401) location.reload();
    }
  }
}, 200);

export const colour = (id) => state.cell?.objects.find((object) => object.id === id)?.colour ?? "#888";
export const object = (id) => state.cell?.objects.find((known) => known.id === id);
/** The cell's own words for a way back begin so. */
export const onAWayBack = (status) => Boolean(status?.message.startsWith("on a way back"));
export const mine = () => state.control && state.me && state.control.session === state.me.session;
const ranks = ["view", "operate", "approve", "engineer"];
export const may = (role) => state.me && ranks.indexOf(state.me.role) >= ranks.indexOf(role);
