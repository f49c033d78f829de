// Texts in the language of the browser, or the one chosen: English is in the scripts, others in one table
// each, built in or from the configuration's files. What the cell itself says (status, reasons) stays in its
// own words.

let table = {};
let shown = "en";

export function language() {
  return shown;
}

/** All languages by their codes. */
export async function languages() {
  try {
    return await (await fetch("/texts.json")).json();
  } catch {
    return { en: "English" };
  }
}

export async function load() {
  const wanted = localStorage.getItem("language") || navigator.language.toLowerCase().split("-")[0];
  if (wanted !== "en" && /^[a-z]{2,3}$/.test(wanted)) {
    try {
      const answer = await fetch(`/text-${wanted}.json`);
      if (answer.ok) [table, shown] = [await answer.json(), wanted];
    } catch { /* English, then */ }
  }
  document.documentElement.lang = shown;
}

/** The text in the chosen language, `{name}` filled in. */
export function t(text, values = {}) {
  let found = table[text] ?? text;
  for (const [name, value] of Object.entries(values)) found = found.replaceAll(`{${name}}`, value);
  return found;
}

const BUTTONS = { status: "Now", submit: "Set a goal", jobs: "Jobs", why: "Jobs", calibrate: "Calibrate", cancel: "Cancel the job", arm: "Arm", disarm: "Disarm", pause: "Pause", resume: "Resume", step: "One step", abort: "Abort", park: "Park", approve: "Approve", reject: "Reject", recover: "What happened?", release: "Release the vacuum" };
const WAYS = { place: "Put it down", hold: "Keep holding", retreat: "Straight up", release: "Let go (hold it by hand)" };

/** A sentence of the cell with the names of this page's buttons in the place of the commands that do the same. */
export function here(text) {
  return text
    .replace(/`?(?:celld recover )?--(place|hold|retreat|release)\b`?/g, (_, way) => `“${t(WAYS[way])}”`)
    .replace(/`celld ([a-z]+)[^`]*`/g, (whole, word) => (BUTTONS[word] ? `“${t(BUTTONS[word])}”` : whole));
}

export const time = (unix) => new Date(unix * 1000).toLocaleTimeString(language());
export const moment = (unix) => new Date(unix * 1000).toLocaleString(language(), { dateStyle: "short", timeStyle: "medium" });
export const number = (value, digits = 1) => value.toLocaleString(language(), { maximumFractionDigits: digits, minimumFractionDigits: digits });

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const s = Math.max(0, Math.round(seconds));
  return s < 60 ? `${s} s` : `${Math.floor(s / 60)} min ${s % 60} s`;
}
