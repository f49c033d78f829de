// What the cell does now: in words, on the table, in the picture, in space; the job with its moves; trends.

import { h, s, card, fill } from "./dom.js";
import { api, colour, object, on, state } from "./net.js";
import { here, t, time, duration, number } from "./text.js";
import { view, ground, outline, foreign, labels, arrows, numbers, after, at, places, drawnAs, onTheGripper } from "./table.js";
import { picture } from "./picture.js";
import { arm3d } from "./arm.js";
import { orders } from "./orders.js";
import { spark } from "./spark.js";

/** Parts that are drawn anew at changes of these kinds. */
function live(title, kinds, draw, attributes = {}) {
  const body = h("div");
  const element = card(title, body);
  if (attributes.class) element.classList.add(attributes.class);
  const update = () => fill(body, draw() ?? []);
  const stops = kinds.map((kind) => on(kind, update));
  update();
  return { element, stop: () => stops.forEach((stop) => stop()) };
}

/** The job file that was refused last, for a while. */
const REFUSED_FOR_S = 600;

function refusedFile({ refused, written_unix_s: written }) {
  return refused && written - refused.unix_s < REFUSED_FOR_S && h("p", { class: "note wrong", id: "refused" }, h("time", {}, time(refused.unix_s)), " ", t("{name} was refused:", { name: refused.name }), " ", here(refused.message));
}

/** What came of the last job or order. */
function happened() {
  const last = state.sentences.at(-1);
  return last && h("p", { class: "soft", id: "last" }, t("Last:"), " ", h("time", {}, time(last.unix_s)), " ", here(last.text));
}

function now() {
  const status = state.status;
  if (!status) return h("p", { class: "say" }, t("celld is starting"));
  const [made, all] = status.step ?? [0, 0];
  const plan = status.plan;
  const left = plan?.seconds && all ? plan.seconds * (1 - carriedOut(status) / Math.max(1, plan.steps.length)) : null;
  return [
    h("p", { class: "badges" },
      // What is under way is finished: until then the arm moves in a cell that is disarmed or paused.
      h("span", { class: `badge ${status.armed || status.moving ? "warn" : "good"}`, id: "armed" }, status.armed ? (status.paused && !status.moving ? t("ARMED") : t("ARMED: the arm may move")) : status.moving ? t("disarmed, THE ARM MAY STILL MOVE") : t("disarmed")), " ",
      status.paused && h("span", { class: "badge warn", id: "paused" }, status.moving ? t("pausing, THE ARM MAY STILL MOVE") : t("paused")), " ",
      status.holding && h("span", { class: "badge warn", id: "holding" }, t("gripper"), ": ", here(status.holding))),
    h("p", { class: "say", id: "message", role: "status" }, status.stopped && !status.armed && status.message === "idle" ? t("stopped") : here(status.message)),
    status.hint && h("p", { class: "hint", id: "hint" }, "→ ", here(status.hint)),
    !status.hint && status.holding && !status.armed && !status.moving && h("p", { class: "hint" }, "→ ", t("Something hangs, or may hang, on the gripper: the ways back are below the orders.")),
    status.shared && h("p", { class: "soft", id: "shared" }, t("Configuration shared with other cells"), ": ", status.shared),
    status.because && h("p", { class: "soft" }, here(status.because)),
    // Nothing is to be done: where to begin.
    !status.job && !status.stopped && !status.holding && h("p", { class: "soft", id: "begin" }, t("To begin:"), " ", h("a", { href: "#goal" }, t("Set a goal")), ". ", !state.sight && t("Arming switches the arm on and releases its brakes. With a job the arm then moves to look at the table; nothing is picked before there is a plan.")),
    // On a way back it is being left.
    status.stopped && !status.armed && h("p", { class: "note wrong", id: "stopped" }, h("strong", {}, status.stopped.job && status.stopped.job !== status.job ? [t("Job {job}", { job: status.stopped.job }), ": "] : "", here(status.stopped.message)), h("br"), status.hint.includes(status.stopped.hint) ? "" : here(status.stopped.hint)),
    status.job && h("div", {}, h("p", {}, h("strong", {}, t("Job {job}", { job: status.job })), all ? `: ${t("{made} of {all} moves", { made, all })}` : "", left === null ? "" : made < all ? `, ${t("about {time} left, then a last look", { time: duration(left) })}` : `, ${t("a last look at the table")}`),
      all ? h("progress", { value: made, max: all, "aria-label": t("Progress of the job") }) : null),
    refusedFile(status),
    !status.job && happened(),
    h("p", { class: "soft" }, status.job ? t("more jobs that wait: {count}", { count: status.waiting }) : t("jobs that wait: {count}", { count: status.waiting }), status.unread ? `, ${t("files that are not read yet: {count}", { count: status.unread })}` : ""),
  ];
}

/** The job before, where it did not come to its goal: why, and what is to be done. What a stop wants is said as
    long as it is not left. */
function unfinished() {
  const element = h("div", { id: "unfinished" });
  let key = null;
  const update = async () => {
    const { status } = state;
    element.hidden = !status || Boolean(status.job || status.stopped);
    const now = JSON.stringify([status?.job, status?.waiting]);
    if (now === key) return;
    key = now;
    try {
      const [last] = await api("jobs?last=1");
      const job = last && ["failed", "interrupted"].includes(last.state) ? await api("jobs/" + encodeURIComponent(last.id)) : null;
      fill(element, job?.last ? h("p", { class: "note wrong" }, h("a", { href: "#jobs/" + encodeURIComponent(job.id) }, t("Job {job}", { job: job.id })), ": ", h("strong", {}, t(job.state)), ` – ${here(job.result?.message ?? "")}`, job.state === "failed" && job.result?.hint ? [h("br"), "→ ", here(job.result.hint)] : "") : []);
    } catch { /* shown as stale elsewhere */ }
  };
  update();
  return { element, stop: on("status", update) };
}

function devices() {
  const { status, arm, vacuum } = state;
  if (!status) return null;
  const row = ({ name, ready, message, age_s, address, identity }) => [h("dt", {}, t(name)),
    h("dd", {}, h("strong", { class: ready ? "good" : "bad" }, ready ? t("ready") : t("not ready")), ", ", here(message),
      h("br"), h("span", { class: "soft" }, address, identity ? `, ${identity}` : "", age_s !== null && age_s > 2 ? `, ${t("answered {time} ago", { time: duration(age_s) })}` : ""))];
  return h("dl", {}, status.devices.map(row),
    arm && [h("dt", {}, t("safety")), h("dd", { id: "safety" }, arm.safety_mode), h("dt", {}, t("robot mode")), h("dd", {}, arm.robot_mode),
      h("dt", {}, t("program")), h("dd", {}, t(arm.program), arm.guided ? `, ${t("guided by hand")}` : "", arm.remote === false ? `, ${t("not in remote control")}` : ""),
      h("dt", {}, t("speed")), h("dd", {}, `${Math.round(arm.speed * 100)} %`)],
    vacuum && [h("dt", {}, t("vacuum")), h("dd", {}, `A ${vacuum[0]} %, B ${vacuum[1]} %`)]);
}

/** The table now, the goals, the plan; with a plan, as it will be after each move. */
export function tableCard() {
  const holder = h("div");
  const slider = h("input", { type: "range", min: 0, max: 0, value: 0, id: "scrub", "aria-label": t("After so many moves") });
  const words = h("output", { for: "scrub", class: "soft" });
  const scrub = h("div", { hidden: true }, h("label", { for: "scrub" }, t("Step through the plan")), slider, words);
  const sight = h("p", { class: "soft" });
  const element = card(t("Table"), holder, scrub, sight);
  let [plan, follow] = [null, null];
  let before = { made: 0, waiting: 0 };
  const draw = () => {
    if (!state.cell) return;
    const status = state.status;
    if (status?.plan?.unix_s !== plan?.unix_s || Boolean(status?.plan) !== Boolean(plan)) {
      plan = status?.plan ?? null;
      slider.max = plan?.steps.length ?? 0;
      slider.value = 0;
    }
    // What is to come is shown while it is decided; once the arm works, the table is that of now.
    const present = { made: status?.step?.[0] ?? 0, waiting: status?.awaiting_approval.length ?? 0 };
    if (present.made > before.made || present.waiting < before.waiting) slider.value = 0;
    before = present;
    scrub.hidden = !plan?.steps.length;
    const count = Number(slider.value);
    const seen = state.sight;
    const moving = plan && status?.job && !count;
    const known = count ? new Map([...after(plan, count)].map(([id, pose]) => [id, { id, pose }])) : places();
    if (!seen && plan && !count) for (const { id, pose } of plan.table) if (!known.has(id)) known.set(id, { id, pose });
    const hanging = [...known.values()].find(({ held }) => held);
    const lying = [...known.values()].filter((one) => one !== hanging);
    const made = moving ? carriedOut(status) : count;
    const steps = plan?.steps ?? [];
    const goals = new Map(steps.filter(({ kind }) => kind === "goal").map(({ object: id, to }) => [id, to]));
    const buffers = steps.filter(({ kind }) => kind !== "goal");
    const drawing = view();
    drawing.setAttribute("aria-label", t("The table from above: {count} objects, {moves} moves planned", { count: known.size, moves: steps.length }));
    drawing.append(ground(), s("g", {}, lying.map((one) => outline(one.id, one.pose, drawnAs(one)))),
      s("g", {}, [...goals].map(([id, pose]) => outline(id, pose, "goal")), buffers.map(({ object: id, to }) => outline(id, to, "goal"))),
      s("g", {}, (seen?.foreign ?? []).map(foreign)), s("g", {}, arrows(steps, made)),
      labels([...numbers(steps, made), ...lying.map(({ id, pose, lost }) => ({ text: lost ? `${id} ?` : id, at: at(object(id)?.centre ?? [0, 0], pose) }))]));
    follow = hanging ? onTheGripper(drawing, hanging.id) : null;
    follow?.(hanging);
    fill(holder, drawing);
    words.textContent = count ? ` ${t("after move {count}: {object}", { count, object: steps[count - 1].object })}` : ` ${t("now")}`;
    sight.textContent = seen ? `${t("Seen at {time}", { time: time(seen.unix_s) })}${seen.missing.length ? `; ${t("not seen")}: ${seen.missing.join(", ")}` : ""}${seen.doubted.length ? `; ${seen.doubted.map((pair) => pair[1]).join("; ")}` : ""}${seen.foreign.length ? `; ${t("things without a marker: {count}", { count: seen.foreign.length })}` : ""}` : t("The table was not seen yet.");
  };
  slider.addEventListener("input", draw);
  // What hangs on the gripper goes where the arm goes; all else is drawn anew when it changes.
  const along = () => {
    if (Number(slider.value)) return;
    const hanging = state.arm?.carried;
    if (Boolean(hanging) !== Boolean(follow)) draw();
    else if (hanging) follow(hanging);
  };
  const stops = [on("status", draw), on("sight", draw), on("cell", draw), on("carried", draw), on("arm", along)];
  draw();
  return { element, stop: () => stops.forEach((stop) => stop()) };
}

/** Of the present plan's moves those that are over: a plan may have been made in the middle of its job. */
function carriedOut({ plan, step }) {
  return Math.min(plan.steps.length, Math.max(0, (step?.[0] ?? 0) - plan.made));
}

function moves() {
  const { plan, job } = state.status ?? {};
  if (!plan) return h("p", { class: "soft" }, t("No plan at the moment."));
  const made = job ? carriedOut(state.status) : 0;
  return [
    h("p", {}, `${t("moves")}: ${plan.steps.length}, `, t("{count} to a temporary place", { count: plan.steps.filter(({ kind }) => kind !== "goal").length }),
      plan.lower_bound !== null ? `; ${t("at least {bound} are needed", { bound: number(plan.lower_bound, plan.lower_bound % 1 ? 2 : 0) })}` : "",
      plan.seconds ? `; ${t("about {time}", { time: duration(plan.seconds) })}` : ""),
    plan.preview && h("p", { class: "hint" }, t("A preview from a look {time} before: the arm moves to look again before it picks anything.", { time: duration(plan.sight_age_s) })),
    h("ol", { class: "moves" }, plan.steps.map(({ object: id, to, kind }, index) => {
      const swatch = h("span", { class: "swatch" });
      swatch.style.background = colour(id);
      return h("li", { class: index < made ? "done" : index === made && job ? "now" : "" }, `${index + 1}.`, swatch, h("span", {}, id, " → ", kind === "goal" ? t("goal") : t("temporary place"),
        h("span", { class: "soft" }, ` ${Math.round(to[0] * 1000)}, ${Math.round(to[1] * 1000)} mm, ${Math.round(to[2] * 180 / Math.PI)}°`)), index < made ? "✓" : "");
    })),
  ];
}

const log = () => h("ol", { class: "log", tabindex: 0, "aria-label": t("What happened") }, [...state.sentences].reverse().slice(0, 100).map(({ unix_s, alarm, text }) => h("li", { class: alarm ? "warn" : "" }, h("time", {}, time(unix_s)), here(text))));

function trends() {
  const body = h("div");
  const element = card(t("Trends and shift"), body);
  const update = async () => {
    try {
      const [trend, shift] = await Promise.all([api("trends"), api("shift?since=8h")]);
      fill(body, h("h3", {}, t("Reference markers off by")), spark(trend.reference_residual_mm, "mm"),
        h("h3", {}, t("Vacuum while holding")), spark(trend.vacuum_percent, "%"),
        h("h3", {}, t("Last 8 hours")), h("dl", {},
          h("dt", {}, t("jobs done")), h("dd", {}, shift.done), h("dt", {}, t("jobs failed")), h("dd", {}, shift.failed + shift.interrupted),
          h("dt", {}, t("moves")), h("dd", {}, `${shift.moves} (${number(shift.moves_per_hour)} ${t("an hour")}${shift.seconds_per_move ? `, ${number(shift.seconds_per_move)} s ${t("each")}` : ""})`)));
    } catch { /* shown as stale elsewhere */ }
  };
  update();
  const timer = setInterval(update, 10000);
  return { element, stop: () => clearInterval(timer) };
}

export function livePage(main) {
  const [first, before] = [live(t("Now"), ["status", "stale", "sentences"], now), unfinished()];
  first.element.append(before.element);
  const parts = [first, orders(), tableCard(), picture(), arm3d(),
    live(t("Moves"), ["status"], moves), live(t("Devices"), ["status", "arm", "vacuum"], devices), trends(),
    live(t("What happened"), ["sentences"], log)];
  fill(main, h("div", { class: "grid" }, parts.map(({ element }) => element)));
  return () => [...parts, before].forEach(({ stop }) => stop());
}
