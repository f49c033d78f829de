// Orders: what may be ordered now, and what the cell answered. Whatever lets something fall or leaves a stop
// is held for a second.

import { h, card, fill } from "./dom.js";
import { api, on, order, state, mine, may, onAWayBack } from "./net.js";
import { here, t, time } from "./text.js";

const HOLD_MS = 1200;

/** A timer that comes later than this comes from a page that was busy, and is waited for once more. */
const LATE_MS = 100;
const AGAIN_MS = 400;

/** A button that acts when it was held down, by finger, mouse or key. What counts is when finger or key did
    what they did, not when a busy page comes to know of it: a click is a click whatever the page was at. */
export function hold(label, act, attributes = {}) {
  let [timer, since, reminded] = [null, 0, null];
  const button = h("button", { type: "button", class: "hold", "aria-description": t("hold for a second"), ...attributes }, label);
  const begin = (event) => {
    if (timer || button.disabled) return;
    remind(false);
    button.classList.add("holding");
    since = event.timeStamp;
    window.addEventListener("pointerup", end);
    window.addEventListener("pointercancel", end);
    wait(HOLD_MS, since + HOLD_MS);
  };
  const wait = (ms, until) => {
    timer = setTimeout(() => {
      // That the button was let go may still be on its way here.
      if (performance.now() - until > LATE_MS) wait(AGAIN_MS, performance.now() + AGAIN_MS);
      else over(true);
    }, ms);
  };
  const end = (event) => {
    if (!timer) return;
    const letGo = event.type === "pointerup" || event.type === "keyup";
    const held = letGo && event.timeStamp - since >= HOLD_MS;
    // Who only clicks sees why nothing came of it.
    if (letGo && !held) {
      missed(label, t("nothing was ordered: hold the button down for a second"));
      remind(true);
    }
    over(held);
  };
  /** Said where the finger is, too: the answers may be further down than the screen. The size stays. */
  const remind = (on) => {
    const { width, height } = button.getBoundingClientRect();
    Object.assign(button.style, on ? { width: `${width}px`, height: `${height}px` } : { width: "", height: "" });
    button.classList.toggle("reminds", on);
    button.textContent = on ? t("hold for a second") : label;
    clearTimeout(reminded);
    if (on) reminded = setTimeout(() => remind(false), 2000);
  };
  const over = (held) => {
    clearTimeout(timer);
    timer = null;
    window.removeEventListener("pointerup", end);
    window.removeEventListener("pointercancel", end);
    button.classList.remove("holding");
    if (!held) return;
    // A button that was replaced meanwhile is not held any more, whatever the finger does.
    if (button.isConnected && !button.disabled) act();
    else missed(label, t("nothing was ordered: it cannot be done now"));
  };
  button.addEventListener("pointerdown", begin);
  for (const kind of ["pointerup", "pointerleave", "pointercancel", "blur", "keyup"]) button.addEventListener(kind, end);
  button.addEventListener("keydown", (event) => {
    if (event.key === " " || event.key === "Enter") { event.preventDefault(); if (!event.repeat) begin(); }
  });
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  return button;
}

// One place each, so that none takes another's: a stop that was refused, the last answer, a click that was none.
const [refused, latest, note] = [h("div"), h("div"), h("div")];
export const answers = h("div", { role: "status", "aria-live": "polite" }, refused, latest, note);

/** An answer leaves after a minute, with the next one, or when it was to be read (`stays`) with the next alone:
    it is of then, not of now. A refusal stays as long as nothing else was answered, and that of a stop until a
    stop is accepted, the cell rests or is armed: an arm that may still move is not hidden by a later order. */
const OLD_MS = 60000;
const NOTE_MS = 8000;

export function answered(what, { accepted, message }, { stops = false, stays = false } = {}) {
  const kept = stops && !accepted;
  const said = h("p", { class: !accepted ? "note wrong" : stays ? "note" : "note over", id: kept ? "answer-stop" : "answer" }, h("time", { class: "soft" }, time(Date.now() / 1000)), " ", h("strong", {}, what + ": "), here(message));
  note.replaceChildren();
  if (stops) refused.replaceChildren();
  latest.replaceChildren();
  (kept ? refused : latest).replaceChildren(said);
  if (accepted && !stays) setTimeout(() => said.remove(), OLD_MS);
}

/** Who presses a button that is to be held sees why nothing came of it. */
function missed(what, why) {
  const said = h("p", { class: "note wrong", id: "answer-click" }, h("strong", {}, what + ": "), why);
  note.replaceChildren(said);
  setTimeout(() => said.remove(), NOTE_MS);
}

/** Gives an order and shows what came of it. */
export async function give(label, command, more) {
  answered(label, await order(command, more), { stops: command.do === "abort" || command.do === "disarm", stays: command.how === "show" });
}

/** Stop: abort and disarm, from every screen, also where the page is stale. */
export async function stop() {
  const [aborted, disarmed] = await Promise.all([order({ do: "abort" }), order({ do: "disarm" })]);
  const messages = [...new Set([aborted.message, disarmed.message])].join("; ");
  const outcome = { accepted: aborted.accepted && disarmed.accepted, message: messages };
  answered(t("Stop"), outcome, { stops: true });
  return outcome;
}

function button(label, command, enabled, attributes = {}) {
  return h("button", { type: "button", id: "order-" + command.do, disabled: !enabled, click: () => give(label, command), ...attributes }, label);
}

function ways() {
  const way = (how, label) => hold(label, () => give(label, { do: "recover", how }), { id: "recover-" + how, "data-way": how });
  return h("div", {}, h("h3", {}, t("Leave the stop")),
    h("div", { class: "row" },
      h("button", { type: "button", id: "recover-show", disabled: state.stale, click: () => give(t("Leave the stop"), { do: "recover", how: "show" }) }, t("What happened?")),
      way("place", t("Put it down")), way("hold", t("Keep holding")), way("retreat", t("Straight up")), way("release", t("Let go (hold it by hand)"))),
    h("p", { class: "soft" }, t("Hold the button of a way back down for a second. Put it down and Straight up MOVE THE ARM at once, whatever is paused. Each is your word that the cell is safe; afterwards it is disarmed.")));
}

/** What may set the arm in motion can be ordered: by role, from here, of a cell that is seen as it is now. */
const moves = () => Boolean(may("operate") && state.me.moves && !state.stale);

/** The cell says which ways may be taken now, and why it could not be armed; “What happened?” names what is in
    the way of the others. That may change with every reading, so the buttons stay. */
function allow(element, status) {
  for (const button of element.querySelectorAll("[data-way]")) {
    button.disabled = !moves() || !status.ways.includes(button.dataset.way);
  }
  const refused = element.querySelector("#arm-refused span");
  if (refused && refused.dataset.said !== status.arm_refused) {
    refused.dataset.said = status.arm_refused ?? "";
    refused.textContent = here((status.arm_refused ?? "").replace("not armed: ", ""));
  }
}

/** There is a stop to leave, or something may hang on the gripper although the stop was left. */
const leaves = (status) => Boolean(!status.armed && (status.stopped || status.ways.length || (status.holding && !status.moving)));

/** What is there for less cannot have been read: a click that comes sooner meant what was there before. */
const READ_MS = 700;

/** Since when something is shown, on the clock of events: from when it was painted, however busy the page is. */
function shown() {
  let [key, since] = ["", Infinity];
  return {
    is(now) {
      if (now === key) return;
      [key, since] = [now, Infinity];
      requestAnimationFrame(() => requestAnimationFrame(() => { if (key === now) since = performance.now(); }));
    },
    /** Another screen was shown meanwhile. */
    anew() {
      [key, since] = ["", Infinity];
    },
    readAt: (event) => event.timeStamp - since >= READ_MS,
  };
}

const [plans, jobs] = [shown(), shown()];

/** A button whose order is about what is shown, and that says why nothing came of a click that was too soon. */
function about(what, label, command, enabled, tooSoon, attributes = {}) {
  const click = (event) => (what.readAt(event) ? give(label, command) : missed(label, tooSoon));
  // A key that is held down is one press.
  const keydown = (event) => { if (event.repeat && (event.key === "Enter" || event.key === " ")) event.preventDefault(); };
  return button(label, command, enabled, { click, keydown, ...attributes });
}

function approval(status) {
  const [waiting] = status.awaiting_approval;
  const plan = status.plan;
  plans.is(JSON.stringify([waiting, plan?.number]));
  const tooSoon = t("nothing was ordered: the plan had only just come");
  const mayApprove = may("approve");
  const decide = (label, command, can, attributes) => about(plans, label, command, waiting && can && !state.stale && mayApprove, tooSoon, attributes);
  return h("div", {},
    h("div", { class: "row" }, decide(t("Approve"), { do: "approve", id: waiting, plan: plan?.number }, plan, { class: waiting ? "first" : null }), decide(t("Reject"), { do: "reject", id: waiting }, true)),
    waiting && h("p", { class: "note", id: "waits" }, h("strong", {}, t("Job {job} waits for approval", { job: waiting })),
      plan ? `; ${t("moves")}: ${plan.steps.length}` : "", plan?.preview ? ` (${t("preview from an earlier look")})` : "",
      state.me && !mayApprove ? [h("br"), t("Approving takes the role approve.")] : ""));
}

/** It cannot be armed because it finishes what is under way: the status says so. */
const finishes = (status) => (status.arm_refused ?? "").startsWith("not armed: the pick-n-place under way");

let before = {};

/** A stop that was refused is over once the cell is known to rest, or was armed again. What an order began is
    over with a stop, and with its job. */
function settled() {
  const { status, stale } = state;
  const began = latest.querySelector("#answer.over");
  const left = before.message && onAWayBack(before) && !onAWayBack(status);
  if (began && status && ((status.stopped && !before.stopped) || (before.job && status.job !== before.job) || left)) began.remove();
  before = status ?? before;
  if (!stale && status && (status.armed || !status.moving)) refused.replaceChildren();
}

export function orders() {
  [plans, jobs].forEach((what) => what.anew());
  const body = h("div");
  const element = card(t("Orders"), body, answers, explained());
  let drawn = "";
  const draw = () => {
    const status = state.status;
    if (!status) return;
    const key = JSON.stringify([status.armed, status.paused, status.job, status.state, status.stopped, status.awaiting_approval, status.plan?.unix_s, status.holding, leaves(status), Boolean(status.arm_refused), finishes(status), onAWayBack(status), status.moving && (!status.armed || status.paused), state.stale, state.control, state.me]);
    // A button that is held down is not replaced.
    if (key === drawn || body.querySelector(".holding")) return allow(body, status);
    drawn = key;
    const wayBack = onAWayBack(status);
    const can = may("operate") && !state.stale && status.state !== "starting";
    const go = can && moves();
    const holder = state.control;
    // The buttons first, each in its place and there whatever the state is: a second press never means the
    // opposite, and none takes the place of another.
    jobs.is(status.job);
    fill(body,
      h("div", { class: "row" },
        button(t("Arm"), { do: "arm" }, go && !status.armed && !status.arm_refused, { class: status.armed || status.moving || status.stopped || status.holding ? null : "first" }),
        button(t("Disarm"), { do: "disarm" }, true),
        button(t("Pause"), { do: "pause" }, !status.paused && status.state !== "starting" && !wayBack),
        button(t("Resume"), { do: "resume" }, go && status.paused, { class: status.paused && status.armed ? "first" : null }),
        button(t("One step"), { do: "step" }, go && status.paused && status.armed),
        button(t("Abort"), { do: "abort" }, true),
        button(t("Park"), { do: "park" }, go && status.armed && !status.job && !wayBack),
        hold(t("Release the vacuum"), () => give(t("Release"), { do: "release", channel: null }), { id: "order-release", disabled: !go }),
        about(jobs, t("Cancel the job"), { do: "cancel", id: status.job }, can && status.job, t("nothing was ordered: the job had only just begun"), { title: status.job })),
      approval(status),
      leaves(status) && ways(),
      // Beside a move that is finished the cell says what is under way, and nobody has pressed anything.
      !status.armed && status.arm_refused && !finishes(status) && h("p", { class: "soft", id: "arm-refused" }, h("strong", {}, t("It cannot be armed now:"), " "), h("span")),
      h("p", { class: "soft" }, holder ? (mine() ? t("You have control.") : t("{name} has control.", { name: holder.name })) : t("Nobody has control: the first order takes it."), " ",
        may("operate") && (mine()
          ? h("button", { type: "button", id: "control", click: () => control(false) }, t("Give back"))
          : h("button", { type: "button", id: "control", click: () => control(true) }, t("Take control")))),
      state.me && !state.me.moves && h("p", { class: "note" }, t("From this computer the arm cannot be moved: see page.control_from.")));
    allow(body, status);
  };
  const stops = [on("status", settled), on("status", draw), on("stale", () => { drawn = ""; draw(); }), on("control", draw), on("me", draw)];
  draw();
  return { element, stop: () => stops.forEach((stop) => stop()) };
}

/** What each order does, for who is about to press one for the first time. */
function explained() {
  const words = [
    [t("Arm"), t("switches the arm on, releases its brakes and lets it move: a job that waits begins at once, with a look at the table")],
    [t("Disarm"), t("finishes the pick-n-place under way; then nothing moves until the cell is armed, or a way back is ordered")],
    [t("Pause"), t("finishes the pick-n-place under way, then jobs wait for Resume; Park and the ways back still MOVE THE ARM")],
    [t("One step"), t("one pick-n-place, then a pause")],
    [t("Abort"), t("stops the arm now and disarms: the job ends, what is held stays held")],
    [t("Stop"), t("Abort and Disarm in one, on every screen; it is not the emergency stop")],
    [t("Park"), t("MOVES THE ARM to its park pose")],
    [t("Cancel the job"), t("ends the job after the pick-n-place or look under way; the cell stays armed, and a job that waits begins: THE ARM MOVES")],
    [t("Approve"), t("agrees to the plan that is shown; in an armed cell that is not paused THE ARM MOVES at once")],
    [t("Reject"), t("ends the job whose plan waits; in an armed cell a job that waits behind it begins: THE ARM MOVES")],
    [t("Release the vacuum"), t("stops and disarms, and lets go of what hangs: hold it by hand")],
  ];
  return h("details", { id: "explained" }, h("summary", {}, t("What the orders do")), h("dl", {}, words.map(([name, what]) => [h("dt", {}, name), h("dd", {}, what)])));
}

async function control(take) {
  try {
    await api("control", { body: { take, force: take } });
  } catch (error) {
    answered(t("Control"), { accepted: false, message: error.message });
  }
}
