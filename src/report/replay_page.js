// Draws a recorded run at the time that the slider shows. Reads the JSON of the page; calls no address.
"use strict";

const run = JSON.parse(document.getElementById("data").textContent);
const SVG = "http://www.w3.org/2000/svg";

function h(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(key, value);
    else if (value !== null && value !== false) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child !== null && child !== false));
  return element;
}

function s(name, attributes = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

/** The last entry not after a time; entries are in order. */
function last(list, time, when = (entry) => entry[0]) {
  let [low, high] = [0, list.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (when(list[middle]) <= time) low = middle + 1; else high = middle;
  }
  return low ? list[low - 1] : null;
}

const ends = [run.arm, run.states, run.pictures, run.plans].map((list) => list.at(-1)?.[0] ?? 0);
const length = Math.max(0.1, ...ends, run.sentences.at(-1)?.at ?? 0);

const PIXELS = 640;
const scale = PIXELS / Math.max(run.table[0], run.table[1], 0.01);
const margin = 0.06 * scale;
// The arm's base is in front of the near edge.
const front = 0.25 * scale;
const [width, height] = run.table.map((side) => side * scale);
const point = ([x, y]) => [x * scale, height - y * scale];
const moved = ([px, py, theta]) => ([x, y]) => [px + Math.cos(theta) * x - Math.sin(theta) * y, py + Math.sin(theta) * x + Math.cos(theta) * y];
const corners = (outline) => outline.map(point).map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ");

function arrow(from, to, number) {
  const [a, b] = [point(from), point(to)];
  const at = [0, 1].map((axis) => a[axis] + (b[axis] - a[axis]) / 3);
  return [s("line", { x1: a[0], y1: a[1], x2: b[0], y2: b[1], stroke: "currentColor", "stroke-width": 1.5, "marker-end": "url(#tip)" }),
    s("text", { x: at[0], y: at[1] + 4, "text-anchor": "middle", "font-size": 17 }, String(number))];
}

/** From above: objects, what carries no marker, the rest of the plan, the arm. */
function table(time, state) {
  const view = s("svg", { viewBox: `${-margin} ${-margin} ${width + 2 * margin} ${height + margin + front}`, role: "img", "aria-label": "The table from above" });
  view.append(s("defs", {}, s("marker", { id: "tip", viewBox: "0 0 8 8", refX: 7, refY: 4, markerWidth: 7, markerHeight: 7, orient: "auto" },
    s("path", { d: "M0 0 L8 4 L0 8 z", fill: "currentColor" }))),
  s("rect", { width, height, fill: "var(--table)", stroke: "currentColor" }));
  for (const outline of run.kept_free) view.append(s("polygon", { points: corners(outline), fill: "none", stroke: "currentColor", "stroke-dasharray": "4 4" }));
  const names = [];
  for (const object of run.objects) {
    const pose = last(object.at, time)?.[1];
    if (!pose) continue;
    const carried = state?.carried === object.id;
    const look = { points: corners(object.outline.map(moved(pose))), fill: object.colour, "fill-opacity": carried ? 0.35 : 0.75, stroke: "currentColor" };
    view.append(s("polygon", carried ? { ...look, "stroke-width": 3, "stroke-dasharray": "2 5" } : look));
    const [x, y] = point(pose);
    names.push(s("text", { x, y: y + 4, "text-anchor": "middle", "font-size": 17 }, carried ? `${object.id} (on the gripper)` : object.id));
  }
  for (const outline of last(run.foreign, time)?.[1] ?? []) view.append(s("polygon", { points: corners(outline), fill: "none", stroke: "var(--wrong)", "stroke-width": 3 }));
  const plan = state?.job ? last(run.plans, time) : null;
  // A plan that was made on the way counts from where it was made.
  const before = plan ? (last(run.states, plan[0])?.[1].moves ?? 0) : 0;
  plan?.[1].forEach(({ from, to }, index) => { if (index >= state.moves - before) view.append(...arrow(from, to, index + 1)); });
  view.append(...names);
  const arm = last(run.arm, time)?.[1];
  if (arm) view.append(s("polyline", { points: corners(arm.map(([x, y]) => [x / 1000, y / 1000])), fill: "none", stroke: "#8a8d93", "stroke-width": 10, "stroke-opacity": 0.55, "stroke-linejoin": "round", "stroke-linecap": "round" }));
  return view;
}

/** From the side, x to the right and z up. */
function side(time) {
  const low = -0.1, high = 0.9;
  const view = s("svg", { viewBox: `${-margin} 0 ${width + 2 * margin} ${(high - low) * scale}`, role: "img", "aria-label": "The arm from the side" });
  const ground = (high) * scale;
  view.append(s("line", { x1: 0, x2: width, y1: ground, y2: ground, stroke: "currentColor", "stroke-width": 3 }));
  const arm = last(run.arm, time)?.[1] ?? [];
  const points = arm.map(([x, , z]) => `${(x / 1000 * scale).toFixed(1)},${(ground - z / 1000 * scale).toFixed(1)}`).join(" ");
  view.append(s("polyline", { points, fill: "none", stroke: "#8a8d93", "stroke-width": 8, "stroke-linejoin": "round", "stroke-linecap": "round" }));
  return view;
}

/** A recording may say anything of its beginning; what is no date is that of time 0. */
const moment = (time) => {
  const date = new Date((run.began_unix_s + time) * 1000);
  return (Number.isNaN(date.getTime()) ? new Date(time * 1000) : date).toISOString();
};
const clock = (time) => `${moment(time).slice(11, 21)} UTC`;
// Who opens a run that ended in a stop looks for that moment; any other begins at its beginning.
const ended = run.states.at(-1)?.[1].stopped;
const stop = ended && run.states.findLast(([, state], index) => state.stopped && index > 0 && !run.states[index - 1][1].stopped);
let now = stop ? Math.min(length, stop[0]) : 0;
let playing = false;
// Its end is a whole number of steps: else the browser stops before the last moment, where a stop is.
const slider = h("input", { type: "range", id: "time", min: 0, max: Math.ceil(length * 20) / 20, step: 0.05, value: 0, "aria-label": "Time of the run", input: () => { now = Math.min(length, Number(slider.value)); draw(); } });
const shown = h("output", { for: "time" });
const speed = h("select", { "aria-label": "Speed" }, ...[1, 2, 5, 10, 30].map((factor) => h("option", { value: factor }, `${factor} x`)));
const play = h("button", { type: "button", id: "play", click: () => { playing = !playing; if (playing && now >= length) now = 0; draw(); } });
const step = (by) => h("button", { type: "button", click: () => to(now + by) }, `${by > 0 ? "+" : ""}${by} s`);
const [drawn, flank, words, picture] = [h("div"), h("div"), h("div", { class: "state", role: "status" }), h("img", { alt: "The last picture of the camera", hidden: "" })];
const age = h("p", { class: "soft" });
const marks = run.sentences.map(({ at, alarm, text }) => ({ at, item: h("li", {}, h("button", { type: "button", class: alarm ? "alarm" : null, click: () => to(at) }, `${moment(at).slice(11, 21)}  ${text}`)) }));

function to(time) {
  now = Math.min(length, Math.max(0, time));
  draw();
}

function draw() {
  slider.value = now;
  shown.textContent = `${now.toFixed(1)} s of ${length.toFixed(1)} s, ${clock(now)}`;
  play.textContent = playing ? "Pause" : "Play";
  const state = last(run.states, now)?.[1];
  drawn.replaceChildren(table(now, state));
  flank.replaceChildren(side(now));
  const mode = !state ? "nothing is known yet" : state.armed ? "armed" : state.moving ? "disarmed, THE ARM MAY STILL MOVE" : "disarmed";
  const lines = [h("div", {}, h("span", { class: state?.armed || state?.moving ? "armed" : "soft" }, mode), state ? `; ${state.text}` : ""),
    h("div", {}, state?.job ? `job ${state.job}, ${state.moves} moves made` : "no job"),
    state?.held ? h("div", {}, `gripper: ${state.held}`) : null,
    state?.stopped ? h("div", { class: "wrong" }, `stopped: ${state.stopped}`) : null,
    state?.hint ? h("div", {}, `to do: ${state.hint}`) : null];
  words.replaceChildren(...lines.filter(Boolean));
  const [taken, latest] = last(run.pictures, now) ?? [0, null];
  age.textContent = !latest ? "no picture yet" : `taken at ${clock(taken)}, ${(now - taken).toFixed(1)} s before this moment`;
  picture.hidden = !latest;
  if (latest && picture.src !== latest) picture.src = latest;
  const present = last(marks, now, ({ at }) => at);
  for (const mark of marks) {
    mark.item.className = mark.at > now ? "later" : "";
    mark.item.firstChild.setAttribute("aria-current", mark === present);
  }
  if (playing) present?.item.scrollIntoView({ block: "nearest" });
}

let before = performance.now();
function turn(at) {
  if (playing) {
    now = Math.min(length, now + (at - before) / 1000 * Number(speed.value));
    if (now >= length) playing = false;
    draw();
  }
  before = at;
  requestAnimationFrame(turn);
}

document.getElementById("run").append(
  h("div", { class: "time" }, play, step(-5), step(5), speed, slider, shown),
  words,
  h("div", { class: "grid" },
    h("section", {}, h("h2", {}, "Table"), drawn),
    h("section", {}, h("h2", {}, "What was said"), h("ol", {}, ...marks.map(({ item }) => item))),
    h("section", {}, h("h2", {}, "Camera"), picture, age),
    h("section", {}, h("h2", {}, "Arm"), flank)));
document.getElementById("began").textContent = `${moment(0).slice(0, 19).replace("T", " ")} UTC`;
draw();
requestAnimationFrame(turn);
