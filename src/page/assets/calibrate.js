// Calibration step by step: what the camera shows now, pictures of a board, a round of the arm, touches, and
// what comes of them. Only the order to go round moves the arm, and it takes what every motion takes.

import { h, s, card, fill } from "./dom.js";
import { api, on, state, may } from "./net.js";
import { t, time, number } from "./text.js";
import { film } from "./film.js";
import { answers, answered, give, hold } from "./orders.js";

const options = { dropped: new Set(), tableOnly: false, tie: false, shown: 1 };

/** What the camera shows now, with the markers that are found. */
function live() {
  const shown = film();
  const over = s("svg", { "aria-hidden": "true" });
  const words = h("p", { class: "soft", role: "status", id: "found" }, t("Markers are looked for …"));
  const draw = () => {
    const found = state.found;
    if (!found) return;
    over.setAttribute("viewBox", `0 0 ${found.width} ${found.height}`);
    fill(over, found.markers.map(({ corners, kind }) => s("path", { class: `c-${kind}`, d: "M" + corners.map((corner) => corner.join(" ")).join("L") + "Z" })));
    const count = (kind) => found.markers.filter((marker) => marker.kind === kind).length;
    words.textContent = t("{reference} reference markers, {board} of the board, {object} of objects, {other} others", { reference: count("reference"), board: count("board"), object: count("object"), other: count("other") });
  };
  shown.turn(true);
  const stops = [on("found", draw), shown.stop];
  return { element: card(t("The camera now"), h("div", { class: "picture" }, shown.image, over), words), stop: () => stops.forEach((stop) => stop()) };
}

const value = (id) => document.getElementById(id).valueAsNumber;
const field = (id, label, first, step) => h("label", {}, label, " ", h("input", { type: "number", id, value: first, step, min: 0 }));
const fault = (text) => text && h("p", { class: "note wrong" }, text);
const flat = (cells, tag = "td") => h("tr", {}, cells.map((cell) => h(tag, tag === "th" ? { scope: "col" } : {}, cell)));

export function calibratePage(main) {
  const camera = live();
  const parts = Object.fromEntries(["lens", "round", "touches", "result", "drift"].map((name) => [name, h("div", { "aria-live": "polite" })]));
  let known = null;
  const drawn = {};
  const engineer = may("engineer");

  const take = async (body) => {
    try {
      show(await api("calibration", { body }));
      return true;
    } catch (error) {
      answered(t("Calibration"), { accepted: false, message: error.message });
      return false;
    }
  };
  const button = (id, label, act, attributes = {}) => h("button", { type: "button", id, disabled: !engineer, click: act, ...attributes }, label);

  const lens = ({ lens: work, cell }) => [
    h("p", {}, cell.lens ? t("In use: {source}, {date}", { source: cell.lens.source, date: cell.lens.date }) : t("celld waits for the robot")),
    work && [
      h("div", { class: "row" }, button("lens-picture", t("Take a picture"), () => take({ do: "picture" })),
        button("lens-auto", t("Take by itself"), () => take({ do: "auto", on: !work.auto }), { "aria-pressed": String(work.auto), class: work.auto ? "first" : null })),
      work.said && h("p", { class: "note", id: "lens-said" }, work.said),
      h("p", {}, t("{count} pictures, at least {least} are needed.", { count: work.pictures.length, least: work.least }), " ",
        work.pictures.length ? (work.uncovered.length ? `${t("No marker yet")}: ${work.uncovered.join(", ")}` : t("The whole picture is covered.")) : ""),
      h("div", { class: "thumbs" }, work.pictures.map(({ name, markers }, index) => thumb(`lens-${index + 1}`, `${name}, ${markers}`))),
      button("lens-solve", t("Compute the lens"), () => take({ do: "lens" }), { class: "first", disabled: !engineer || work.pictures.length < work.least }),
      fault(work.fault),
      work.solved && [h("p", { class: "note", id: "lens-solved" }, t("{px} px, {held} px in pictures that were held out; under 0.3 px is good", { px: number(work.solved.px, 3), held: number(work.solved.held_out_px, 3) })),
        h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("Pictures of the board") }, h("table", {}, h("thead", {}, flat([t("picture"), t("corners"), "px", t("held out")], "th")), h("tbody", {}, work.solved.samples.map((sample) => flat([sample.name, sample.corners, number(sample.px, 3), sample.rejected ? t("left out") : sample.held_out_px === null ? "–" : number(sample.held_out_px, 3)])))))],
    ],
  ];

  const thumb = (name, label) => h("a", { href: `/api/v1/calibration/pictures/${name}?${Date.now()}`, target: "_blank" }, h("img", { src: `/api/v1/calibration/pictures/${name}`, alt: label, width: 96, height: 54, loading: "lazy" }));

  const round = ({ round: work, cell }) => [
    h("p", {}, cell.poses ? t("The arm goes slowly to {count} taught poses and takes a picture at each. Keep its whole reach free of people and things.", { count: cell.poses }) : t("The configuration names no calibration_poses_deg: teach some, or see `celld calibrate hand-eye --propose`.")),
    cell.mount === "fixed" && h("p", {}, t("The camera stands: the hand carries the board.")),
    h("div", { class: "row" }, hold(t("Go round (hold)"), () => give(t("Calibration round"), { do: "calibrate" }), { id: "round", disabled: !engineer || !cell.poses }),
      h("span", { class: "soft" }, state.status?.armed ? t("ARMED: the arm may move") : t("Arm the cell on the first screen before."))),
    work && [h("p", { id: "round-state" }, t("{made} of {all} pictures", { made: work.markers.length, all: cell.poses }), work.over && !work.fault ? ` – ${t("the round is complete")}` : ""), fault(work.fault),
      h("div", { class: "thumbs" }, work.markers.map((count, index) => thumb(`round-${index + 1}`, t("pose {pose}: {count} markers", { pose: index + 1, count }))))],
  ];

  const touches = ({ touches: work, cell }) => work && [
    work.wanted ? h("p", { class: "say", id: "touch-wanted" }, t("{number} of {all}: bring the tip onto {target}, let go of the arm", { number: work.wanted.number, all: work.of, target: work.wanted.target })) : h("p", {}, t("All points are touched.")),
    h("div", { class: "row" }, button("touch", t("The tip is there"), () => take({ do: "touch" }), { class: "first", disabled: !engineer || !work.wanted }), button("untouch", t("Take the last one back"), () => take({ do: "untouch" }), { disabled: !engineer || !work.touches.length })),
    work.said && h("p", { class: "note" }, work.said), fault(work.fault),
    h("table", {}, h("thead", {}, flat([t("point"), "mm", t("held out")], "th")), h("tbody", {}, work.touches.map((touch) => flat([touch.target, touch.mm === null ? "–" : number(touch.mm, 2), touch.held_out_mm === null ? "–" : number(touch.held_out_mm, 2)])))),
    work.rms_mm !== null && h("p", {}, `${number(work.rms_mm, 2)} mm rms`),
  ];

  /** A picture of the round with an arrow at each marker, fifty times as long as it is off. */
  const picture = (solved) => {
    const marks = solved.marks[options.shown - 1] ?? [];
    const name = `/api/v1/calibration/pictures/round-${options.shown}`;
    const image = h("img", { src: name, alt: t("pose {pose}: {count} markers", { pose: options.shown, count: marks.length }), width: 1280, height: 720 });
    const over = s("svg", { "aria-hidden": "true" });
    const fit = () => over.setAttribute("viewBox", `0 0 ${image.naturalWidth || 1280} ${image.naturalHeight || 720}`);
    image.addEventListener("load", fit);
    fit();
    over.append(...marks.flatMap(([x, y, dx, dy]) => ["p-under", "c-off"].map((kind) => s("path", { class: kind, d: `M${x} ${y}l${50 * dx} ${50 * dy}` }))));
    return h("div", { class: "picture" }, image, over);
  };

  const result = ({ solved, fault: why, kept, round: work, touches: touched }) => [
    h("div", { class: "row" }, h("label", { for: "table-only" }, h("input", { type: "checkbox", id: "table-only", checked: options.tableOnly, change: (event) => { options.tableOnly = event.target.checked; } }), " ", t("the table alone: the camera's place is kept")),
      h("label", { for: "tie" }, h("input", { type: "checkbox", id: "tie", checked: options.tie, disabled: !touched?.touches.length, change: (event) => { options.tie = event.target.checked; } }), " ", t("tied to the touches")),
      button("solve", t("Compute"), () => take({ do: "solve", table_only: options.tableOnly, drop: [...options.dropped], tie: options.tie }), { class: "first", disabled: !engineer || !work?.over })),
    fault(why),
    solved && [
      h("dl", { id: "solved" }, [
        [t("corners"), `${number(solved.table.px, 3)} px`], [t("held-out samples"), solved.table.held_out_mm === null ? "–" : `${number(solved.table.held_out_mm, 2)} mm, ${t("at most")} ${number(solved.table.held_out_most_mm, 2)} mm`],
        [t("camera known within"), `${number(solved.camera_std.mm, 2)} mm, ${number(solved.camera_std.deg, 3)}°`], [t("table known within"), `${number(solved.table_std.mm, 2)} mm, ${number(solved.table_std.deg, 3)}°`],
        solved.camera_moved && [t("camera against what is in use"), `${number(solved.camera_moved.mm, 2)} mm, ${number(solved.camera_moved.deg, 3)}°`],
        [t("table against what is in use"), `${number(solved.table_moved.mm, 2)} mm, ${number(solved.table_moved.deg, 3)}°`],
        solved.tie && [t("touch less camera"), `${solved.tie.shift_mm.map((mm) => number(mm, 2)).join(", ")} mm, ${number(solved.tie.turn_deg, 3)}°`],
      ].filter(Boolean).map(([term, words]) => [h("dt", {}, term), h("dd", {}, words)])),
      picture(solved), h("p", { class: "soft" }, t("Arrows: how far each marker is off, fifty times as long.")),
      h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("Samples") }, h("table", {}, h("thead", {}, flat([t("pose"), t("markers"), "px", "mm", t("leave out")], "th")), h("tbody", {}, solved.table.samples.map((sample) => flat([
        h("button", { type: "button", id: `show-${sample.pose}`, "aria-pressed": String(sample.pose === options.shown), click: () => { options.shown = sample.pose; drawn.result = ""; show(known); } }, sample.pose),
        sample.markers, number(sample.px, 3), number(sample.mm, 2) + (sample.rejected ? ` (${t("left out")})` : ""),
        h("label", { for: `drop-${sample.pose}`, class: "tick" }, h("input", { type: "checkbox", id: `drop-${sample.pose}`, "aria-label": `${t("leave out")} ${sample.pose}`, checked: options.dropped.has(sample.pose), change: (event) => { if (event.target.checked) options.dropped.add(sample.pose); else options.dropped.delete(sample.pose); } }))]))))),
      h("div", { class: "row" }, hold(t("Keep (hold)"), () => take({ do: "keep", number: solved.number }), { id: "keep", disabled: !engineer || Boolean(kept) }), h("span", { class: "soft" }, t("Held-out samples under 0.5 mm are good. What is kept counts from celld's next start.")))],
    kept && h("p", { class: "note", id: "kept" }, kept),
  ];

  const drift = ({ drift: seen, cell }) => (seen ? [
    h("p", {}, t("Seen at {time}", { time: time(seen.unix_s) })),
    bar(t("reference markers"), seen.residual_mm, cell.limits.residual_mm, "mm"),
    seen.looks.map((look, index) => [bar(t("look {number}: shift", { number: index + 1 }), Math.hypot(...look.shift_mm), cell.limits.shift_mm, "mm"), bar(t("look {number}: height", { number: index + 1 }), Math.abs(look.lift_mm), cell.limits.shift_mm, "mm"), bar(t("look {number}: turn", { number: index + 1 }), Math.abs(look.turn_deg), cell.limits.turn_deg, "°")]),
    h("p", { class: "soft" }, t("At its limit a job stops with calibration_invalid: see whether camera or table was moved, then calibrate."))] : h("p", { class: "soft" }, t("The table was not seen yet.")));

  const bar = (label, is, limit, unit) => h("div", { class: "row" }, h("label", {}, `${label}: ${number(is, 2)} / ${number(limit, 2)} ${unit} `, h("meter", { min: 0, max: limit, low: limit / 2, high: limit * 0.8, optimum: 0, value: Math.min(is, limit) })));

  const show = (view) => {
    known = view;
    const { cell } = view;
    const of = { lens: [lens, view.lens, cell.lens], round: [round, view.round, cell.poses, state.status?.armed], touches: [touches, view.touches], result: [result, view.solved, view.fault, view.kept, view.round?.over, view.touches?.touches.length], drift: [drift, view.drift] };
    for (const [name, [draw, ...key]] of Object.entries(of)) {
      const now = JSON.stringify(key);
      if (now === drawn[name]) continue;
      drawn[name] = now;
      fill(parts[name], draw(view) ?? []);
    }
    const points = document.getElementById("points");
    if (points && !points.value) points.value = cell.references.slice(0, 4).join(", ");
    const tip = document.getElementById("tip");
    if (tip && !tip.value) tip.value = cell.tip_mm.map((mm) => Math.round(mm * 10) / 10).join(", ");
  };

  const board = h("div", { class: "row" }, field("columns", t("columns"), 7, 1), field("rows-of", t("rows"), 5, 1), field("edge", t("edge, mm"), 27, 0.1), field("first-id", t("lowest number"), 0, 1),
    button("board", t("Begin with this board"), () => take({ do: "board", columns: value("columns"), rows: value("rows-of"), size_mm: value("edge"), first_id: value("first-id") })));
  const list = (id) => document.getElementById(id).value.split(",").map((part) => part.trim()).filter(Boolean);
  const points = h("div", { class: "row" }, h("label", {}, t("points"), " ", h("input", { id: "points" })), h("label", {}, t("tip, mm from the flange"), " ", h("input", { id: "tip" })),
    button("touches", t("Begin to touch"), () => take({ do: "touches", points: list("points"), tip_mm: list("tip").map(Number) })));

  fill(main, !engineer && h("p", { class: "note" }, t("Calibrating takes the role engineer; you may look.")), answers, h("div", { class: "grid" }, camera.element,
    card(t("How far it is off now"), parts.drift),
    card(t("1. The lens"), h("p", {}, t("Hold a printed board (celld markers --board) before the camera: near, far, tilted, in every corner. Measure a black square.")), board, parts.lens),
    card(t("2. Camera and table"), parts.round),
    card(t("3. Touches (optional)"), h("p", {}, t("Mount a pointed tip and bring it onto points of the table with freedrive or by jogging, at the pendant in Local Control: marker numbers, 500:lower_left, or x/y in m. celld moves nothing. Switch the pendant back to Remote Control afterwards.")), points, parts.touches),
    card(t("4. What comes of it"), parts.result)));
  let gone = false;
  const update = async () => {
    try {
      const view = await api("calibration");
      if (!gone) show(view);
    } catch { /* shown as stale elsewhere */ }
  };
  update();
  const timer = setInterval(update, 1000);
  const stops = [camera.stop, on("status", () => { if (known) show(known); })];
  return () => { gone = true; clearInterval(timer); stops.forEach((stop) => stop()); };
}
