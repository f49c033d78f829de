// A goal set by hand: outlines are dragged and turned, the checker says what collides, a plan is made at
// once, and the job is submitted. Keys move too: arrows by a millimetre (with shift ten), q and e turn.

import { h, s, card, fill } from "./dom.js";
import { api, handIn, on, state, may, onAWayBack } from "./net.js";
import { here, t, duration, number } from "./text.js";
import { view, ground, outline, foreign, labels, arrows, numbers, at, places, drawnAs } from "./table.js";

const draft = { poses: new Map(), chosen: null, troubles: [], plan: null, rule: null };
const round = (value, digits) => Number(value.toFixed(digits));
const movable = () => state.cell.objects.filter((known) => !known.fixed);

/** Where each object lies that lies somewhere: not what hangs on the gripper, nor what was lost. */
function lying() {
  return new Map([...places()].filter(([, { held, lost }]) => !held && !lost).map(([id, { pose }]) => [id, pose]));
}

const objects = () => [...draft.poses].map(([id, pose]) => ({ id, pose: pose.map((value) => round(value, 5)) }));

/** The job as it would be submitted, in the words of a job file. */
function jobText() {
  const goal = draft.rule ?? { objects: objects() };
  const job = { version: 1, goal, rerun: true };
  // A person writes words, a job has a name.
  const id = document.getElementById("job-id")?.value.trim().replace(/[^A-Za-z0-9._-]+/g, "-");
  const approval = document.getElementById("approval")?.value;
  if (id) job.id = id;
  if (approval) job.approval = approval;
  return JSON.stringify(job);
}

/** What is wrong, without where in the text that this page has written. */
const plain = (message) => message.replace(/^job:\d+:\d+: /gm, "").replace(/ \(line \d+\)/g, "");

/** What submitting lets begin at once; null where the cell has to be armed first. */
export function whatSubmitStarts() {
  const { status } = state;
  if (!status?.armed) return null;
  if (status.job) return t("The cell is armed: a job that is submitted now begins behind {job}.", { job: status.job });
  if (status.paused) return t("The cell is armed and paused: a job that is submitted begins after Resume.");
  return t("The cell is armed: the arm moves as soon as a job is submitted, to look at the table; “Look at the table” is such a job.");
}

/** That a job was submitted, and what it does, as long as that is shown. */
export function submitted({ id, state: word, message }) {
  return h("p", { class: "note", id: "submitted" }, t("Submitted: job {job}, {state}.", { job: id, state: t(word) }), message ? ` ${here(message)}` : "", " ", begins(id), " ", h("a", { href: "#live" }, t("To the cell")));
}

/** What a job that was just submitted does: kept of now. */
function begins(id) {
  const element = h("strong");
  let active = false;
  const words = () => {
    const { status } = state;
    if (active && status.job !== id) return t("It is over.");
    active ||= status.job === id;
    if (status.awaiting_approval.includes(id)) return t("Its plan waits for approval, under Now.");
    // Also in a cell that was disarmed or paused meanwhile: what is under way is finished.
    if (active && status.moving) return t("THE ARM MOVES NOW.");
    if (!status.armed || onAWayBack(status)) return status.paused ? t("It begins once the cell is armed, after Resume.") : t("It begins once the cell is armed.");
    if (!active && status.job) return t("It begins behind {job}.", { job: status.job });
    if (status.paused && !status.moving) return t("It begins after Resume.");
    // Between two motions it may wait for a plan or a gate; what follows begins without another word.
    return t("It begins: THE ARM MAY MOVE AT ANY MOMENT.");
  };
  const update = () => {
    const now = state.status ? words() : "";
    if (element.textContent !== now) element.textContent = now;
  };
  update();
  const stop = on("status", () => (element.isConnected ? update() : stop()));
  return element;
}

export function goalPage(main) {
  const holder = h("div", { id: "goal-table" });
  const troubles = h("div", { role: "status", "aria-live": "polite", id: "troubles" });
  const list = h("div");
  const result = h("div", { role: "status", "aria-live": "polite", id: "preview" });
  const starting = h("p", { class: "note", id: "starts" });
  let drawing = null;
  // One job a click, however long the cell takes to read it.
  let handing = false;
  let asking = 0;

  const wrong = (id) => draft.troubles.some((trouble) => trouble.objects.includes(id));

  const point = (event) => {
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(drawing.getScreenCTM().inverse());
    return [x / 1000, state.cell.table[1] - y / 1000];
  };

  // One question at a time, and the last one always: a pointer moves faster than a checker.
  let busy = false;
  let next = null;
  const check = async (moved) => {
    next = { moved };
    holder.setAttribute("aria-busy", "true");
    if (busy) return;
    busy = true;
    while (next) {
      const one = next;
      next = null;
      await asked(one.moved);
    }
    busy = false;
    holder.setAttribute("aria-busy", "false");
  };

  const asked = async (moved) => {
    const number = ++asking;
    try {
      const body = { objects: objects(), ...(moved ? { moved } : {}) };
      const answer = await api("goals/check", { body });
      if (number !== asking) return;
      if (moved && answer.free) {
        const before = draft.poses.get(moved);
        draft.poses.set(moved, answer.free);
        if (Math.hypot(before[0] - answer.free[0], before[1] - answer.free[1]) > 1e-6) { next ??= { moved: null }; return draw(); }
      }
      draft.troubles = answer.troubles;
    } catch (error) {
      draft.troubles = [{ objects: [], message: error.message }];
    }
    fill(troubles, draft.troubles.map(({ message }) => h("p", { class: "note wrong" }, message)));
    draw();
  };

  const changed = (moved) => {
    draft.plan = null;
    draft.rule = null;
    fill(result);
    draw();
    check(moved);
  };

  const grip = (event, id, turn) => {
    event.preventDefault();
    draft.chosen = id;
    const from = point(event);
    const begun = [...draft.poses.get(id)];
    const angle = ([x, y]) => Math.atan2(y - begun[1], x - begun[0]);
    const first = angle(from);
    const moveTo = (moving) => {
      const now = point(moving);
      if (turn) {
        let theta = begun[2] + angle(now) - first;
        const snapped = Math.round(theta / (Math.PI / 12)) * (Math.PI / 12);
        if (Math.abs(theta - snapped) < 0.04) theta = snapped;
        draft.poses.set(id, [begun[0], begun[1], theta]);
      } else {
        draft.poses.set(id, [begun[0] + now[0] - from[0], begun[1] + now[1] - from[1], begun[2]]);
      }
      draft.plan = null;
      draw();
      check(null);
    };
    const end = () => {
      window.removeEventListener("pointermove", moveTo);
      window.removeEventListener("pointerup", end);
      window.removeEventListener("pointercancel", end);
      changed(id);
    };
    window.addEventListener("pointermove", moveTo);
    window.addEventListener("pointerup", end);
    window.addEventListener("pointercancel", end);
  };

  const keys = (event, id) => {
    const step = event.shiftKey ? 0.01 : 0.001;
    const turn = (event.shiftKey ? 15 : 1) * Math.PI / 180;
    const by = { ArrowLeft: [-step, 0, 0], ArrowRight: [step, 0, 0], ArrowUp: [0, step, 0], ArrowDown: [0, -step, 0], q: [0, 0, turn], e: [0, 0, -turn], Q: [0, 0, turn], E: [0, 0, -turn] }[event.key];
    if (event.key === "Delete") { draft.poses.delete(id); return changed(null); }
    if (!by) return;
    event.preventDefault();
    draft.poses.set(id, draft.poses.get(id).map((value, index) => value + by[index]));
    changed(null);
  };

  const handle = ([id, pose]) => {
    const known = state.cell.objects.find((other) => other.id === id);
    if (!known) return null;
    const reach = Math.max(...known.outline.map(([x, y]) => Math.hypot(x, y))) + 0.018;
    const [x, y] = at([reach, 0], pose);
    const shape = outline(id, pose, "goal", wrong(id));
    shape.style.fill = known.colour;
    shape.style.fillOpacity = draft.chosen === id ? 0.35 : 0.15;
    return s("g", { class: "t-drag", tabindex: 0, role: "button", id: "goal-" + id, "aria-label": `${id}: ${round(pose[0] * 1000, 0)}, ${round(pose[1] * 1000, 0)} mm, ${round(pose[2] * 180 / Math.PI, 0)}°`,
      pointerdown: (event) => grip(event, id, false), keydown: (event) => keys(event, id), focus: () => { draft.chosen = id; } }, shape,
    s("circle", { class: "t-turn", cx: x * 1000, cy: (state.cell.table[1] - y) * 1000, r: 11, "data-turn": id, pointerdown: (event) => { event.stopPropagation(); grip(event, id, true); } }, s("title", {}, t("turn"))));
  };

  function draw() {
    const focused = document.activeElement?.id;
    drawing = view();
    drawing.setAttribute("role", "group");
    drawing.setAttribute("aria-label", t("The goal; drag outlines, or move the chosen one with arrow keys, q and e turn it"));
    const steps = draft.plan?.steps ?? [];
    drawing.append(ground(), s("g", {}, [...places().values()].map((one) => { const now = outline(one.id, one.pose, one.held ? "now t-held" : drawnAs(one)); if (now) now.style.opacity = 0.45; return now; })),
      s("g", {}, (state.sight?.foreign ?? []).map(foreign)),
      s("g", {}, steps.filter(({ kind }) => kind !== "goal").map(({ object: id, to }) => outline(id, to, "goal"))), s("g", {}, [...draft.poses].map(handle)),
      s("g", {}, arrows(steps)),
      labels([...numbers(steps), ...[...draft.poses].map(([id, pose]) => ({ text: id, at: at(state.cell.objects.find((known) => known.id === id)?.centre ?? [0, 0], pose) }))]));
    fill(holder, drawing);
    if (focused?.startsWith("goal-")) document.getElementById(focused)?.focus({ preventScroll: true });
    rows();
  }

  let shownRows = "";
  function rows() {
    const key = JSON.stringify([[...draft.poses.keys()], movable().map(({ id }) => id)]);
    const values = (id) => { const pose = draft.poses.get(id); return [round(pose[0] * 1000, 1), round(pose[1] * 1000, 1), round(pose[2] * 180 / Math.PI, 1)]; };
    if (key === shownRows) {
      for (const id of draft.poses.keys()) values(id).forEach((value, index) => {
        const input = document.getElementById(`n-${id}-${index}`);
        if (input && input !== document.activeElement) input.value = value;
      });
      return;
    }
    shownRows = key;
    const typed = (id, index, value) => {
      const pose = [...draft.poses.get(id)];
      pose[index] = index < 2 ? value / 1000 : value * Math.PI / 180;
      if (pose.every(Number.isFinite)) { draft.poses.set(id, pose); changed(null); }
    };
    const numbersOf = (id) => values(id).map((value, index) => h("td", {}, h("input", { type: "number", step: index < 2 ? 1 : 5, id: `n-${id}-${index}`, value, "aria-label": `${id} ${["x mm", "y mm", t("angle, degrees")][index]}`, change: (event) => typed(id, index, event.target.valueAsNumber) })));
    const line = ({ id, colour }) => {
      const swatch = h("span", { class: "swatch" });
      swatch.style.background = colour;
      const wanted = h("input", { type: "checkbox", id: "want-" + id, checked: draft.poses.has(id), change: (event) => { if (event.target.checked) draft.poses.set(id, [...(lying().get(id) ?? [state.cell.table[0] / 2, state.cell.table[1] / 2, 0])]); else draft.poses.delete(id); changed(event.target.checked ? id : null); } });
      return h("tr", {}, h("td", {}, h("label", { for: "want-" + id }, wanted, " ", swatch, " ", id)), draft.poses.has(id) ? numbersOf(id) : h("td", { colspan: 3, class: "soft" }, t("may end anywhere")));
    };
    fill(list, h("table", { id: "wanted" }, h("thead", {}, h("tr", {}, [t("object"), "x mm", "y mm", t("angle")].map((title) => h("th", { scope: "col" }, title)))), h("tbody", {}, movable().map(line))));
  }

  const take = () => {
    draft.poses = new Map([...lying()].filter(([id]) => movable().some((known) => known.id === id)).map(([id, pose]) => [id, [...pose]]));
    changed(null);
  };

  const inRows = () => {
    if (nothingYet()) return;
    const ids = [...draft.poses.keys()];
    const [width, height] = state.cell.table;
    let [x, y, tall] = [0.02, height - 0.02, 0];
    for (const id of ids) {
      const known = state.cell.objects.find((other) => other.id === id);
      const [xs, ys] = [known.outline.map(([u]) => u), known.outline.map(([, v]) => v)];
      const [w, d] = [Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys)];
      const gap = state.cell.clearance + 0.012;
      if (x + w > width - 0.01) [x, y, tall] = [0.02, y - tall - gap, 0];
      draft.poses.set(id, [x - Math.min(...xs), y - Math.max(...ys), 0]);
      x += w + gap;
      tall = Math.max(tall, d);
    }
    changed(null);
  };

  const swapped = () => {
    const [a, b] = ["swap-a", "swap-b"].map((id) => document.getElementById(id).value);
    const there = lying();
    const [pa, pb] = [a, b].map((id) => draft.poses.get(id) ?? there.get(id));
    if (!pa || !pb) return void nothingYet();
    if (a === b) return;
    draft.poses.set(a, [...pb]);
    draft.poses.set(b, [...pa]);
    changed(null);
  };

  const measure = (id, value, label) => h("label", {}, label, " ", h("input", { type: "number", id, value, step: 10 }));
  const value = (id) => document.getElementById(id).valueAsNumber;

  const inGrid = () => {
    if (nothingYet()) return;
    const [columns, dx, dy, x0, y0] = ["grid-columns", "grid-x", "grid-y", "grid-left", "grid-low"].map(value);
    if (!(columns >= 1)) return;
    [...draft.poses.keys()].forEach((id, index) => draft.poses.set(id, [(x0 + (index % columns) * dx) / 1000, (y0 + Math.floor(index / columns) * dy) / 1000, 0]));
    changed(null);
  };

  // Where in the region each lies best is not for the page to say: the cell finds it, as for a job.
  const inRegion = async () => {
    const [x0, y0, x1, y1] = ["region-left", "region-low", "region-right", "region-high"].map((id) => value(id) / 1000);
    const rule = { region: { objects: [...draft.poses.keys()], polygon: [[x0, y0], [x1, y0], [x1, y1], [x0, y1]] } };
    draft.rule = rule;
    const answer = await preview();
    if (!answer) { draft.rule = null; return; }
    for (const { id, pose } of answer.goals) draft.poses.set(id, pose);
    await check(null);
  };

  // Without an object there is nothing to preview, to put in rows or to submit.
  const nothingYet = () => {
    if (draft.poses.size || draft.rule) return false;
    fill(result, h("p", { class: "note wrong", id: "nothing-yet" }, t("No object has a goal yet."), " ", state.sight ? t("“As it lies now” takes the table as it is.") : t("The table was not seen yet: “Look at the table” first.")));
    return true;
  };

  const preview = async () => {
    if (nothingYet()) return;
    fill(result, h("p", { class: "soft" }, t("planning …")));
    draft.plan = null;
    draw();
    try {
      const answer = await api("preview", { body: { text: jobText() } });
      draft.plan = answer.plan;
      fill(result, h("p", { class: "note", id: "planned" }, h("strong", {}, `${t("moves")}: ${answer.plan.steps.length}`), `, ${t("{count} to a temporary place", { count: answer.buffers })}`,
        answer.plan.lower_bound !== null ? `; ${t("at least {bound} are needed", { bound: number(answer.plan.lower_bound, answer.plan.lower_bound % 1 ? 2 : 0) })}` : "",
        answer.plan.seconds ? `; ${t("about {time}", { time: duration(answer.plan.seconds) })}` : "", `. ${t("From a look {time} ago.", { time: duration(answer.plan.sight_age_s) })}`),
        answer.doubt && h("p", { class: "note wrong", id: "doubt" }, t("As the table was seen last, the cell would refuse this job:"), " ", here(answer.doubt.message), answer.doubt.hint ? [h("br"), "→ ", here(answer.doubt.hint)] : null));
      draw();
      return answer;
    } catch (error) {
      fill(result, h("p", { class: "note wrong" }, here(plain(error.message)), error.hint ? h("span", {}, h("br"), "→ ", here(error.hint)) : null));
    }
  };

  const submit = async () => {
    if (nothingYet() || handing) return;
    handing = true;
    try {
      const job = await handIn("jobs", { text: jobText(), name: "page" });
      // From now on the plan is the job's own.
      draft.plan = null;
      draw();
      fill(result, submitted(job));
    } catch (error) {
      fill(result, h("p", { class: "note wrong" }, here(plain(error.message))));
    }
    handing = false;
  };

  const lookAround = async () => {
    if (handing) return;
    handing = true;
    try {
      const { id } = await handIn("jobs", { text: JSON.stringify({ version: 1, goal: { look: true }, rerun: true }), name: "look" });
      fill(result, h("p", { class: "note", id: "looking" }, t("Job {job} looks at the table.", { job: id }), " ", begins(id), " ", h("a", { href: "#live" }, t("To the cell"))));
    } catch (error) {
      fill(result, h("p", { class: "note wrong" }, here(plain(error.message))));
    }
    handing = false;
  };

  const files = h("select", { id: "goal-files", "aria-label": t("goal files") });
  const listFiles = async () => {
    const names = await api("goals").catch(() => []);
    fill(files, h("option", { value: "" }, t("choose a goal file")), names.map((name) => h("option", { value: name }, name)));
  };
  files.addEventListener("change", async () => {
    if (!files.value) return;
    try {
      const { objects: wanted } = await api("goals/" + encodeURIComponent(files.value));
      draft.poses = new Map(wanted.map(({ id, pose }) => [id, pose]));
      changed(null);
    } catch (error) {
      fill(result, h("p", { class: "note wrong" }, here(plain(error.message))));
    }
  });
  const save = async () => {
    let name = document.getElementById("goal-name").value.trim();
    if (!name.endsWith(".yaml")) name += ".yaml";
    try {
      await api("goals/" + encodeURIComponent(name), { method: "PUT", body: { objects: objects(), replace: document.getElementById("replace").checked } });
      fill(result, h("p", { class: "note" }, t("Saved as {name}.", { name })));
      listFiles();
    } catch (error) {
      fill(result, h("p", { class: "note wrong" }, here(plain(error.message))));
    }
  };

  const choose = (id, label) => h("select", { id, "aria-label": label }, movable().map((known) => h("option", { value: known.id }, known.id)));
  const second = choose("swap-b", t("second object"));
  if (movable().length > 1) second.value = movable()[1].id;
  fill(main, h("div", { class: "grid" },
    card(t("Goal"), h("div", { class: "row" }, h("button", { type: "button", id: "look", disabled: !may("operate"), click: lookAround }, t("Look at the table")), h("button", { type: "button", id: "take", click: () => { take(); nothingYet(); } }, t("As it lies now")), h("button", { type: "button", id: "rows", click: inRows }, t("In rows")), files), holder, troubles,
      h("p", { class: "soft" }, t("Solid: where things lie. Dashed: where they are to go. Drag an outline, turn it by its circle."))),
    h("div", { class: "grid" },
      card(t("Plan and submit"), h("div", { class: "row" },
        h("button", { type: "button", id: "plan", class: "first", click: preview }, t("Preview")),
        h("input", { id: "job-id", placeholder: t("name of the job (optional)"), "aria-label": t("name of the job (optional)") }),
        h("label", {}, t("approval"), " ", h("select", { id: "approval" }, h("option", { value: "" }, t("as the cell")), ["never", "job", "always"].slice(["never", "job", "always"].indexOf(state.cell.approval)).map((word) => h("option", { value: word }, t(word))))),
        h("button", { type: "button", id: "submit", class: "first", disabled: !may("operate"), click: submit }, t("Submit"))), starting, result),
      card(t("Objects with a goal"), h("div", { class: "scroll" }, list)),
      card(t("Swap two"), h("div", { class: "row" }, choose("swap-a", t("first object")), second, h("button", { type: "button", id: "swap", click: swapped }, t("Swap")))),
      card(t("Grid or region"), h("p", { class: "soft" }, t("For the objects with a goal, mm.")),
        h("div", { class: "row" }, measure("grid-columns", 3, t("columns")), measure("grid-x", 150, t("pitch x")), measure("grid-y", 100, t("pitch y")), measure("grid-left", 90, t("from x")), measure("grid-low", 60, t("from y")),
          h("button", { type: "button", id: "grid", click: inGrid }, t("In a grid"))),
        h("div", { class: "row" }, measure("region-left", 0, t("from x")), measure("region-low", 0, t("from y")), measure("region-right", Math.round(state.cell.table[0] * 500), t("to x")), measure("region-high", Math.round(state.cell.table[1] * 1000), t("to y")),
          h("button", { type: "button", id: "region", click: inRegion }, t("Into the region")))),
      card(t("Save as a goal file"), h("div", { class: "row" }, h("input", { id: "goal-name", "aria-label": t("name of the file"), placeholder: "tidy.yaml" }),
        h("label", { for: "replace" }, h("input", { type: "checkbox", id: "replace" }), " ", t("replace")), h("button", { type: "button", id: "save", disabled: !may("operate"), click: save }, t("Save")))))));
  const warn = () => {
    const words = whatSubmitStarts();
    starting.hidden = !words;
    starting.textContent = words ?? "";
  };
  warn();
  listFiles();
  if (!draft.poses.size && state.sight) take(); else { draw(); check(null); }
  const stops = [on("sight", () => (draft.poses.size ? draw() : take())), on("carried", () => draw()), on("status", warn)];
  return () => stops.forEach((stop) => stop());
}
