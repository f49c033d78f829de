// The page of all cells: what each does, its counts and trends; the jobs; what happened. It gives no order:
// what arms, resumes, recovers or releases needs eyes on the cell, and the rest is `celld fleet`.
//
// In: the fleet as JSON, once a second. A card is drawn anew when its cell has changed.

import { h, card, fill } from "./dom.js";
import { load, t, time, moment, duration, number } from "./text.js";
import { spark } from "./spark.js";

const bar = document.getElementById("bar");
const main = document.getElementById("main");
const cards = new Map();

/** The key of the link: out of the address, and kept for this tab. */
function key() {
  const given = new URLSearchParams(location.hash.slice(1)).get("key");
  if (given) {
    sessionStorage.setItem("fleet", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("fleet") ?? "";
}

const stateWord = (cell) => {
  if (cell.away) return h("span", { class: "badge bad" }, t("away for {time}", { time: duration(cell.age_s) }));
  if (!cell.state.armed && cell.state.moving) return h("span", { class: "badge warn" }, t("disarmed, THE ARM MAY STILL MOVE"));
  return h("span", { class: `badge ${cell.state.armed ? "warn" : "good"}` }, cell.state.armed ? t("armed") : t("disarmed"));
};

function approvals(cell) {
  return cell.state.awaiting_approval.map((job) => h("p", { class: "note" }, t("The plan of {job} waits for approval:", { job }), h("br"),
    h("code", {}, `celld fleet approve ${job}${cell.state.job === job && cell.state.plan ? ` --plan ${cell.state.plan}` : ""}`)));
}

function progress({ job, step }) {
  if (!job) return h("p", { class: "soft" }, t("no job"));
  const [made, all] = step ?? [0, 0];
  return [h("p", {}, h("strong", {}, job), all ? `: ${t("{made} of {all} moves", { made, all })}` : ""),
    all ? h("progress", { value: made, max: all, "aria-label": t("Progress of the job") }) : null];
}

const bound = (moves, least) => `${moves} / ≥ ${number(least, least % 1 ? 2 : 0)}`;

function drawCell(cell) {
  const { state, counts } = cell;
  const alarm = state.complaints.map((complaint) => h("p", { class: "note wrong" }, complaint));
  return [
    h("p", {}, stateWord(cell), " ", cell.away ? "" : h("strong", {}, state.state), state.labels.length ? h("span", { class: "soft" }, ` ${state.labels.join(", ")}`) : ""),
    h("p", { class: cell.away ? "soft" : "" }, cell.away ? `${t("before that")}: ` : "", state.message),
    state.hint && !cell.away && h("p", { class: "hint" }, "→ ", state.hint),
    alarm, approvals(cell), progress(state),
    state.fragment ? h("p", { class: "soft" }, t("shared configuration {number}", { number: state.fragment })) : null,
    // Some are always on their way.
    state.undelivered > 20 ? h("p", { class: "soft" }, t("{count} events wait for the network", { count: state.undelivered })) : null,
    h("dl", {},
      h("dt", {}, t("jobs")), h("dd", {}, t("{done} done, {failed} failed", counts)),
      h("dt", {}, t("moves / bound")), h("dd", {}, bound(counts.moves, counts.bound)),
      h("dt", {}, t("throughput")), h("dd", {}, `${number(counts.moves_per_hour)} ${t("moves an hour")}`),
      h("dt", {}, t("cycle time")), h("dd", {}, counts.moves ? `${number(counts.seconds / counts.moves)} s` : "–")),
    h("div", { class: "trends" },
      h("div", {}, h("h3", {}, t("Markers off by")), spark(cell.drift_mm, "mm")),
      h("div", {}, h("h3", {}, t("Vacuum")), spark(cell.vacuum_percent, "%")),
      h("div", {}, h("h3", {}, t("Time of a move")), spark(cell.cycle_s, "s"))),
    cell.faults.length ? h("details", { open: opened.has(cell.name), toggle: (event) => { opened[event.target.open ? "add" : "delete"](cell.name); } },
      h("summary", {}, t("{count} faults, the last at {time}", { count: cell.faults.length, time: time(cell.faults[0].unix_s) })),
      h("ol", { class: "log" }, cell.faults.map(happened))) : null,
  ];
}
const opened = new Set();

const happened = ({ unix_s, cell, job, alarm, text }) => h("li", { class: alarm ? "warn" : "" }, h("time", {}, time(unix_s)), h("strong", {}, cell), job ? ` ${job}` : "", `: ${text}`);

function jobRow(job) {
  const { outcome } = job;
  const ended = { done: "good", failed: "bad", rejected: "bad", interrupted: "bad", cancelled: "warn" };
  const reasons = Object.entries(job.reasons).map(([name, reason]) => `${name}: ${reason}`).join("; ");
  return h("tr", {}, h("td", {}, job.id, job.campaign ? h("span", { class: "soft" }, ` (${job.campaign})`) : ""), h("td", {}, moment(job.submitted_unix_s)), h("td", {}, job.by), h("td", {}, job.target),
    h("td", {}, job.stranded ? h("strong", { class: "bad" }, t("stranded: its cell is away")) : outcome ? h("strong", { class: ended[outcome.status] ?? "" }, t(outcome.status)) : t(job.state)),
    h("td", {}, job.cell || "–"), h("td", {}, outcome ? (outcome.lower_bound === null ? outcome.moves : bound(outcome.moves, outcome.lower_bound)) : "–"),
    h("td", {}, outcome ? duration(outcome.seconds) : "–"), h("td", {}, outcome?.message || reasons));
}

function drawBar(fleet) {
  const waiting = Object.values(fleet.queued).reduce((sum, count) => sum + count, 0);
  const sum = (of) => fleet.cells.reduce((total, cell) => total + of(cell), 0);
  const wrong = fleet.connected ? "" : t("No answer from the server of the fleet: what is shown is old.");
  fill(bar, h("h1", {}, h("img", { src: "/icon.svg", alt: "", width: 28, height: 28 }), h("span", { class: "name" }, t("Fleet {name}", { name: fleet.fleet }))),
    h("span", { id: "sums" },
      h("span", {}, t("{count} cells", { count: fleet.cells.length }), `, ${t("{count} away", { count: sum((cell) => cell.away ? 1 : 0) })}`),
      h("span", {}, t("{count} jobs wait", { count: waiting })),
      h("span", {}, `${t("last {hours} h", { hours: number(fleet.window_s / 3600, 0) })}: ${t("{done} done, {failed} failed", { done: sum((cell) => cell.counts.done), failed: sum((cell) => cell.counts.failed) })}, ${number(sum((cell) => cell.away ? 0 : cell.counts.moves_per_hour))} ${t("moves an hour")}`)),
    h("p", { id: "stale", role: "alert", hidden: !wrong }, wrong));
}

const cells = h("div", { class: "cells" });
const jobs = h("tbody");
const log = h("ol", { class: "log", tabindex: 0 });
const none = h("p", { class: "soft" });
const queue = h("p", { class: "soft" });
let drawn = "";

function frame() {
  log.setAttribute("aria-label", t("What happened"));
  const titles = ["job", "submitted", "by", "for", "state", "cell", "moves / bound", "time", "what"];
  fill(main, cells, none,
    card(t("Jobs"), queue, h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("List of jobs") }, h("table", {}, h("thead", {}, h("tr", {}, titles.map((title) => h("th", { scope: "col" }, t(title))))), jobs))),
    h("div", { class: "gap" }), card(t("What happened"), log));
}

function draw(fleet) {
  drawBar(fleet);
  document.title = `${fleet.fleet} – celld`;
  const names = new Set(fleet.cells.map(({ name }) => name));
  for (const [name, { element }] of cards) if (!names.has(name)) { element.remove(); cards.delete(name); }
  for (const cell of fleet.cells) {
    const known = cards.get(cell.name);
    // An age that only grows is no change, but of a cell that is away it is what counts.
    const key = JSON.stringify(cell.away ? cell : { ...cell, age_s: 0, state: { ...cell.state, unix_s: 0, clock_ahead_s: 0 } });
    if (known?.key === key) continue;
    const body = known?.body ?? h("div");
    fill(body, drawCell(cell));
    const element = known?.element ?? card(cell.name, body);
    element.classList.toggle("away", cell.away);
    cards.set(cell.name, { key, body, element });
    if (!known) cells.append(element);
  }
  none.textContent = fleet.cells.length ? "" : t("No cell has joined the fleet yet.");
  const lanes = Object.entries(fleet.queued).map(([lane, count]) => `${lane}: ${count}`);
  queue.textContent = lanes.length ? `${t("In the queue")}: ${lanes.join(", ")}` : t("No job waits.");
  const rest = JSON.stringify([fleet.jobs, fleet.happened]);
  if (rest === drawn) return;
  drawn = rest;
  fill(jobs, fleet.jobs.map(jobRow));
  fill(log, fleet.happened.map(happened));
}

function fault(message) {
  document.getElementById("stale")?.remove();
  bar.append(h("p", { id: "stale", role: "alert" }, message));
}

async function look() {
  try {
    const answer = await fetch("/api/v1/fleet", { headers: { authorization: `Bearer ${key()}` }, signal: AbortSignal.timeout(3000) });
    if (answer.status === 401) return fault(t("Open the link that celld fleet page prints."));
    if (!answer.ok) return fault(`HTTP ${answer.status}`);
    draw(await answer.json());
  } catch {
    fault(t("No answer from celld fleet page: what is shown is old."));
  }
}

const theme = localStorage.getItem("theme");
if (theme) document.documentElement.dataset.theme = theme;
await load();
frame();
await look();
setInterval(look, 1000);
