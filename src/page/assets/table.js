// The table from above: objects where they are and should be, moves with their numbers, places that stay
// free. Millimetres, y up as in the table frame; the robot is below the lower edge.

import { s } from "./dom.js";
import { state, object } from "./net.js";

const MARGIN = 62;

/** Corners of an outline at a pose, as an SVG path. */
export function path(outline, [x, y, theta], height) {
  const [c, n] = [Math.cos(theta), Math.sin(theta)];
  const corners = outline.map(([u, v]) => [x + c * u - n * v, y + n * u + c * v]);
  return "M" + corners.map(([u, v]) => `${(u * 1000).toFixed(1)} ${((height - v) * 1000).toFixed(1)}`).join("L") + "Z";
}

/** Where a point of an object is at a pose. */
export function at([u, v], [x, y, theta]) {
  const [c, n] = [Math.cos(theta), Math.sin(theta)];
  return [x + c * u - n * v, y + n * u + c * v];
}

export function view() {
  const [width, height] = state.cell.table;
  const drawing = s("svg", {
    class: "table", viewBox: `${-MARGIN} ${-MARGIN} ${width * 1000 + 2 * MARGIN} ${height * 1000 + 2 * MARGIN}`, role: "img",
  });
  drawing.append(s("defs", {}, s("marker", { id: "head", viewBox: "0 0 10 10", refX: 8, refY: 5, markerWidth: 14, markerHeight: 14, orient: "auto-start-reverse", markerUnits: "userSpaceOnUse", class: "t-head" }, s("path", { d: "M0 0L10 5L0 10Z" }))));
  return drawing;
}

/** Grid, edge, reference markers, places that stay free, what never moves. */
export function ground() {
  const [width, height] = state.cell.table;
  const parts = [];
  for (let x = 0.1; x < width - 1e-9; x += 0.1) parts.push(s("path", { class: "t-grid", d: `M${x * 1000} 0V${height * 1000}` }));
  for (let y = 0.1; y < height - 1e-9; y += 0.1) parts.push(s("path", { class: "t-grid", d: `M0 ${(height - y) * 1000}H${width * 1000}` }));
  for (const outline of state.cell.keep_out) parts.push(s("path", { class: "t-keep", d: path(outline, [0, 0, 0], height) }));
  for (const known of state.cell.objects.filter((known) => known.fixed && known.pose)) {
    parts.push(s("path", { class: "t-keep", d: path(known.outline, known.pose, height) }));
  }
  for (const { pose, size, id } of state.cell.references) {
    const square = (half) => [[-half, -half], [half, -half], [half, half], [-half, half]];
    parts.push(s("g", {}, s("title", {}, `reference marker ${id}`),
      s("path", { class: "t-ref", d: path(square(size / 2), pose, height) }),
      s("path", { class: "t-ref-in", d: path(square(size / 5), pose, height) })));
  }
  parts.push(s("rect", { class: "t-edge", width: width * 1000, height: height * 1000 }));
  return s("g", {}, parts);
}

/** One object's outline: `now` filled, `goal` dashed. */
export function outline(id, pose, kind, wrong = false) {
  const known = object(id);
  if (!known) return null;
  const drawn = s("path", { class: `t-${kind}${wrong ? " t-wrong" : ""}`, d: path(known.outline, pose, state.cell.table[1]) }, s("title", {}, id));
  drawn.style.stroke = known.colour;
  if (kind.startsWith("now")) drawn.style.fill = known.colour;
  return drawn;
}

/** Objects that the arm has carried since they were seen, each where it is now. */
export function carried() {
  const hanging = state.arm?.carried;
  const others = (state.sight?.carried ?? []).filter(({ id, held }) => id !== hanging?.id && !held);
  return hanging ? [...others, hanging] : others;
}

/** Where each object is as far as is known: as it was seen last, or where the arm has carried it since. */
export function places() {
  const found = new Map((state.sight?.objects ?? []).map(({ id, pose }) => [id, { id, pose }]));
  for (const one of carried()) found.set(one.id, { ...one, unseen: true });
  return found;
}

/** How an object that is at such a place is drawn. */
export const drawnAs = ({ unseen, lost }) => (lost ? "now t-lost" : unseen ? "now t-unseen" : "now");

/** An object that hangs on the gripper; what is returned moves it. */
export function onTheGripper(drawing, id) {
  const known = object(id);
  const drawn = outline(id, [0, 0, 0], "now t-held");
  if (!drawn) return () => {};
  const label = s("text", { class: "t-label" }, id);
  drawing.append(s("g", { id: "carried" }, drawn, label));
  return ({ pose }) => {
    drawn.setAttribute("d", path(known.outline, pose, state.cell.table[1]));
    const [x, y] = at(known.centre ?? [0, 0], pose);
    label.setAttribute("x", (x * 1000).toFixed(1));
    label.setAttribute("y", ((state.cell.table[1] - y) * 1000).toFixed(1));
  };
}

export function foreign(corners) {
  return s("path", { class: "t-foreign", d: path(corners, [0, 0, 0], state.cell.table[1]) }, s("title", {}, "no marker"));
}

/** Where texts are drawn that belong to places, in the units of the drawing: each takes the first free place
    round its own, so that none hides another. */
export function spread(list, size) {
  const taken = [];
  return list.map(({ text, at: [u, v] }) => {
    const half = [0.31 * size * String(text).length + 2, size * 0.62];
    const shifts = [[0, 0]];
    for (let ring = 1; ring < 6; ring++) for (const [dx, dy] of [[0, -1], [0, 1], [1, 0], [-1, 0], [0.8, -0.8], [-0.8, 0.8]]) shifts.push([dx * ring * size, dy * ring * size]);
    const free = ([dx, dy]) => taken.every(([a, b, w, h]) => Math.abs(a - u - dx) > w + half[0] || Math.abs(b - v - dy) > h + half[1]);
    const [dx, dy] = shifts.find(free) ?? [0, 0];
    taken.push([u + dx, v + dy, ...half]);
    return [u + dx, v + dy];
  });
}

/** Labels on the table. */
export function labels(list, size = 13) {
  const height = state.cell.table[1];
  const places = spread(list.map(({ text, at: [x, y] }) => ({ text, at: [x * 1000, (height - y) * 1000] })), size);
  return s("g", {}, list.map(({ text, kind }, index) => s("text", { class: kind === "number" ? "t-number" : "t-label", x: places[index][0].toFixed(1), y: places[index][1].toFixed(1) }, String(text))));
}

/** Arrows with numbers; the numbers keep apart with the labels. */
export function arrows(steps, from = 0) {
  const height = state.cell.table[1];
  return steps.slice(from).map((step) => {
    const centre = object(step.object)?.centre ?? [0, 0];
    const [a, b] = [at(centre, step.from), at(centre, step.to)].map(([x, y]) => [x * 1000, (height - y) * 1000]);
    return s("path", { class: "t-move", d: `M${a[0].toFixed(1)} ${a[1].toFixed(1)}L${b[0].toFixed(1)} ${b[1].toFixed(1)}`, "marker-end": "url(#head)" });
  });
}

export function numbers(steps, from = 0) {
  return steps.slice(from).map((step, index) => {
    const centre = object(step.object)?.centre ?? [0, 0];
    const [a, b] = [at(centre, step.from), at(centre, step.to)];
    return { text: from + index + 1, at: [a[0] + 0.35 * (b[0] - a[0]), a[1] + 0.35 * (b[1] - a[1])], kind: "number" };
  });
}

/** Where everything lies after the first moves of a plan. */
export function after(plan, count) {
  const poses = new Map(plan.table.map(({ id, pose }) => [id, pose]));
  for (const step of plan.steps.slice(0, count)) poses.set(step.object, step.to);
  return poses;
}
