// The frame: signing in, the bar with Stop, which screen is shown.

import { h, fill } from "./dom.js";
import { connect, on, reload, signIn, state } from "./net.js";
import { here, know, load, t } from "./text.js";
import { livePage } from "./live.js";
import { goalPage } from "./goal.js";
import { jobsPage } from "./jobs.js";
import { setupPage } from "./setup.js";
import { calibratePage } from "./calibrate.js";
import { stop } from "./orders.js";

const main = document.getElementById("main");
const bar = document.getElementById("bar");
const screens = { live: ["Now", livePage], goal: ["Set a goal", goalPage], jobs: ["Jobs", jobsPage], calibrate: ["Calibrate", calibratePage], setup: ["Setup", setupPage] };
let leave = () => {};

function gate(message) {
  // A link that is pasted into this window changes what is behind its # alone.
  window.addEventListener("hashchange", () => location.reload());
  fill(bar, h("h1", {}, "celld"));
  fill(main, h("section", { class: "card gate" }, h("h2", {}, t("Sign in")), message && h("p", { class: "note wrong" }, message),
    h("p", {}, t("On the cell's computer, run:")), h("pre", {}, "celld open"), h("p", { class: "soft" }, t("with the --state or --config of celld itself, where it was started with one")),
    h("p", { class: "soft" }, t("It opens this page with a link that counts once. For another computer: celld open --print, and open the link there."))));
}

/** A ticket in the address becomes a session, and leaves the address and the history. */
async function redeem() {
  const ticket = new URLSearchParams(location.hash.slice(1)).get("ticket");
  if (!ticket) return null;
  history.replaceState(null, "", location.pathname + "#live");
  try {
    await signIn(ticket);
    return null;
  } catch (error) {
    return error.message;
  }
}

/** Stop, and on every screen what came of it. */
async function pressed() {
  const said = document.getElementById("stopping");
  said.hidden = false;
  said.className = "note";
  said.textContent = t("Stop is sent …");
  const { accepted, message } = await stop();
  said.className = accepted ? "note" : "note wrong";
  said.textContent = `${t("Stop")}: ${here(message)}${accepted ? "" : `. ${t("If the arm moves, press the red button at the cell.")}`}`;
  setTimeout(() => { said.hidden = true; }, accepted ? 8000 : 60000);
}

/** Whether the arm may move, on every screen and wherever it is scrolled to. */
function drawMode() {
  const badge = document.getElementById("bar-mode");
  if (!badge || !state.status) return;
  const { armed, paused, moving, stopped, holding } = state.status;
  badge.className = `badge ${armed || moving || stopped || holding ? "warn" : "good"}`;
  badge.textContent = [armed ? t("ARMED") : moving ? t("MAY STILL MOVE") : t("disarmed"), paused && (armed && moving ? t("pausing, MAY STILL MOVE") : t("paused")), stopped && !armed && t("stopped")].filter(Boolean).join(", ");
}

function drawBar() {
  const [screen] = location.hash.slice(1).split("/");
  const shown = screens[screen] ? screen : "live";
  fill(bar,
    h("h1", {}, h("img", { src: "/icon.svg", alt: "", width: 28, height: 28 }), h("span", { class: "name" }, state.cell.name), state.cell.simulated && h("span", { class: "simulated" }, `(${t("simulated")})`)),
    h("nav", { "aria-label": t("Screens") }, Object.entries(screens).map(([name, [title]]) => h("a", { href: "#" + name, "aria-current": name === shown ? "page" : null }, t(title)))),
    h("span", { id: "bar-mode" }),
    h("span", { class: "fill" }),
    h("span", { class: "who" }, `${state.me.name}, ${t(state.me.role)}`),
    h("div", { class: "stop" }, h("button", { type: "button", class: "halt", id: "stop", click: pressed }, t("Stop")), h("small", {}, t("stops and disarms; not the emergency stop"))),
    h("p", { id: "stopping", role: "alert", hidden: true }),
    h("p", { id: "stale", role: "alert", hidden: !state.stale }, t("No connection to celld: what is shown is old. Only Stop, Disarm, Pause and Abort are sent.")));
  drawMode();
}

function show() {
  leave();
  const [screen, ...rest] = location.hash.slice(1).split("/");
  const [title, page] = screens[screen] ?? screens.live;
  document.title = `${t(title)} – celld`;
  drawBar();
  leave = page(main, rest.length ? decodeURIComponent(rest.join("/")) : null);
  window.scrollTo(0, 0);
}

async function start() {
  const theme = localStorage.getItem("theme");
  if (theme) document.documentElement.dataset.theme = theme;
  const [message] = await Promise.all([redeem(), load()]);
  try {
    await reload();
  } catch (error) {
    return gate(message ?? (error.status === 401 ? null : error.message));
  }
  know(state.cell.objects.map(({ id }) => id));
  document.querySelector(".skip").textContent = t("To the content");
  connect();
  show();
  window.addEventListener("hashchange", async () => {
    if (location.hash.startsWith("#ticket=")) { await redeem(); location.reload(); return; }
    show();
  });
  on("status", drawMode);
  on("stale", () => {
    document.getElementById("stale").hidden = !state.stale;
    document.body.classList.toggle("stale", state.stale);
  });
}

// What is there is painted before anything is computed; a page in the background does not paint.
if (document.hidden) start();
else requestAnimationFrame(() => setTimeout(start));
