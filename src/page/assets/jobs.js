// Jobs: what became of each, and why.

import { h, card, fill } from "./dom.js";
import { api, handIn, may, on, state } from "./net.js";
import { submitted, whatSubmitStarts } from "./goal.js";
import { here, t, moment, duration, number } from "./text.js";

/** Report and played-back run in the light of this page. */
const light = () => (localStorage.getItem("theme") ? `?theme=${localStorage.getItem("theme")}` : "");

const word = (stateOf) => h("strong", { class: { done: "good", failed: "bad", interrupted: "bad", cancelled: "warn" }[stateOf] ?? "" }, t(stateOf));

function row(job, open) {
  return h("tr", { class: "pick", click: () => open(job.id) },
    h("td", {}, h("button", { type: "button", class: "link" }, job.id)), h("td", {}, word(job.state)), h("td", {}, moment(job.claimed_unix_s)),
    h("td", {}, job.moves === null ? "–" : `${job.moves}${job.lower_bound !== null ? ` / ≥ ${number(job.lower_bound, job.lower_bound % 1 ? 2 : 0)}` : ""}`),
    h("td", {}, job.seconds === null ? "–" : duration(job.seconds)), h("td", {}, here(job.message ?? "")));
}

/** The same goal as a job of its own; what that lets begin is said before. `starting` is kept of now, and
    `said`, where the answer goes, stays when this job is drawn anew. */
function onceMore(job, { said, starting }) {
  const submit = async () => {
    // One job a click, however long the cell takes to read it and whatever is drawn anew meanwhile.
    if (said.dataset.busy) return;
    said.dataset.busy = "yes";
    fill(said, h("p", { class: "note" }, t("submitting …")));
    try {
      fill(said, submitted(await handIn(`jobs/${encodeURIComponent(job.id)}/again`)));
    } catch (error) {
      fill(said, h("p", { class: "note wrong" }, here(error.message)));
    }
    delete said.dataset.busy;
  };
  const button = h("button", { type: "button", id: "again", disabled: !may("operate"), click: submit }, t("Submit again"));
  return [button, starting];
}

/** The hint of the last job is still to be followed; that of a stop until the stop is left. */
const ofNow = (job) => job.last && (job.state !== "interrupted" || Boolean(state.status?.stopped));

function detail(job, parts) {
  const id = encodeURIComponent(job.id);
  const result = job.result;
  const times = Object.entries(result?.times ?? {}).filter(([, seconds]) => seconds > 0.05).sort((a, b) => b[1] - a[1]);
  const image = (name, words) => job.files.includes(name) && h("figure", {}, h("img", { src: `/api/v1/jobs/${id}/files/${name}`, alt: words, width: "100%" }), h("figcaption", { class: "soft" }, words));
  return [
    h("p", { class: "say" }, word(job.state), job.ended_unix_s ? h("span", { class: "soft" }, `, ${moment(job.ended_unix_s)}`) : "", result ? ` – ${here(result.message)}` : ""),
    result?.hint && h("p", { class: "hint" }, ofNow(job) ? "→ " : `${t("what was to be done")}: `, here(result.hint)),
    h("div", { class: "row" }, h("a", { class: "button", href: `/api/v1/jobs/${id}/report${light()}`, target: "_blank" }, t("Report")), job.recorded && h("a", { class: "button", id: "playback", href: `/api/v1/jobs/${id}/playback${light()}`, target: "_blank" }, t("Play back")), job.ended_unix_s && onceMore(job, parts)),
    h("div", { class: "grid" },
      h("div", {}, h("h3", {}, t("Story")), h("div", { class: "scroll" }, h("table", { id: "story" }, job.lines.map(({ unix_s, text }) => h("tr", {}, h("td", { class: "when soft" }, unix_s === null ? "" : moment(unix_s)), h("td", {}, here(text)))))),
        times.length ? [h("h3", {}, t("Where the time went")), h("table", {}, times.map(([what, seconds]) => h("tr", {}, h("td", {}, t(what)), h("td", {}, `${number(seconds)} s`))))] : null,
        !result && job.goals.length ? [h("h3", {}, t("Objects with a goal")), h("table", {}, job.goals.map(({ id: object, pose }) => h("tr", {}, h("td", {}, object), h("td", {}, `${Math.round(pose[0] * 1000)}, ${Math.round(pose[1] * 1000)} mm, ${Math.round(pose[2] * 180 / Math.PI)}°`))))] : null,
        result?.objects.length ? [h("h3", {}, t("Objects")), h("table", {}, h("tr", {}, h("th", {}, t("object")), h("th", {}, t("off by"))),
          result.objects.map((object) => h("tr", {}, h("td", {}, object.id), h("td", {}, object.error_mm === null ? here(job.unseen[object.id] ?? "not seen") : `${number(object.error_mm)} mm, ${number(object.error_deg)}°`))))] : null),
      h("div", {}, image("plan.jpg", t("When the plan was made")), image("end.jpg", t("The last picture")), image("plan.svg", t("The plan")))),
  ];
}

export function jobsPage(main, chosen) {
  const failed = h("input", { type: "checkbox", id: "failed", change: () => update() });
  const wanted = h("input", { type: "search", id: "object", placeholder: t("object"), "aria-label": t("only jobs with this object"), change: () => update() });
  const list = h("tbody");
  const none = h("p", { class: "soft" });
  const [said, starting] = [h("div", { role: "status", "aria-live": "polite" }), h("span", { class: "soft", id: "starts" })];
  const one = h("div", { role: "region", "aria-live": "polite", "aria-label": t("The chosen job") });
  const open = async (id) => {
    location.hash = "#jobs/" + encodeURIComponent(id);
  };
  const show = async (id) => {
    try {
      fill(one, card(t("Job {job}", { job: id }), detail(await api("jobs/" + encodeURIComponent(id)), { said, starting })));
    } catch (error) {
      fill(one, h("p", { class: "note wrong" }, error.message));
    }
  };
  const update = async () => {
    const query = new URLSearchParams({ last: "100", failed: String(failed.checked) });
    if (wanted.value.trim()) query.set("object", wanted.value.trim());
    try {
      const jobs = await api("jobs?" + query);
      fill(list, jobs.map((job) => row(job, open)));
      none.textContent = jobs.length ? "" : t("no such jobs");
    } catch (error) {
      none.textContent = error.message;
    }
  };
  fill(main, said, one, h("div", { class: "gap" }), card(t("Jobs"), h("div", { class: "row" }, h("label", { for: "failed" }, failed, " ", t("only failed ones")), wanted),
    h("div", { class: "scroll" }, h("table", { id: "jobs" }, h("thead", {}, h("tr", {}, ["job", "state", "came", "moves / bound", "time", "what"].map((title) => h("th", { scope: "col" }, t(title))))), list)), none));
  let key = "";
  const warn = () => {
    const words = whatSubmitStarts() ?? "";
    if (starting.textContent !== words) starting.textContent = words;
  };
  warn();
  const stop = on("status", () => {
    warn();
    const now = JSON.stringify([state.status?.job, state.status?.waiting, Boolean(state.status?.stopped)]);
    if (now !== key) { key = now; update(); if (chosen) show(chosen); }
  });
  update();
  if (chosen) show(chosen);
  return stop;
}
