// Texts in the language of the browser, or the one chosen: English is in the scripts, others in one table
// each, built in or from the configuration's files. What the cell itself says (status, reasons, hints) is
// translated phrase by phrase, as far as the table has it.

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
  const unsigned = (text) => text.replaceAll("-#", "#");
  phrases = new Map(Object.entries(table).map(([key, text]) => [unsigned(key), unsigned(text)]));
  document.documentElement.lang = shown;
}

/** The text in the chosen language, `{name}` filled in. */
export function t(text, values = {}) {
  let found = table[text] ?? text;
  for (const [name, value] of Object.entries(values)) found = found.replaceAll(`{${name}}`, value);
  return found;
}

const BUTTONS = { status: "Now", submit: "Set a goal", jobs: "Jobs", why: "Jobs", cancel: "Cancel the job", arm: "Arm", disarm: "Disarm", pause: "Pause", resume: "Resume", step: "One step", abort: "Abort", park: "Park", approve: "Approve", reject: "Reject", recover: "What happened?", release: "Release the vacuum" };
const WAYS = { place: "Put it down", hold: "Keep holding", retreat: "Straight up", release: "Let go (hold it by hand)" };

/** The table for the cell's own phrases: the sign of a number is part of it. */
let phrases = new Map();

/** Names of objects, the longest first: they stand for themselves in what the cell says. */
let names = [];

export function know(ids) {
  names = [...ids].sort((a, b) => b.length - a.length);
}

/** One phrase of the cell: in the table numbers are `#`, objects `OBJECT` and jobs `JOB`, in the same order. */
function phrase(text) {
  const [, lead, rest] = text.match(/^(\s*)([^]*)$/);
  const found = filled(rest, false) ?? filled(rest, true);
  return lead + (found ?? rest.replaceAll("` or `", `\` ${t("or")} \``));
}

/** The phrase of the table with what the text has in its holes. A job is known by the word before its name. */
function filled(text, jobs) {
  const escaped = names.map((name) => name.replace(/[.*+?^${}()|[\]\\]/g, "\\$&"));
  const named = escaped.length ? `(?<![\\w-])(?:${escaped.join("|")})(?![\\w-])|` : "";
  const job = jobs ? "(?<=\\bjob )[^\\s`]+|" : "";
  const found = { "#": [], OBJECT: [], JOB: [] };
  const key = text.replace(new RegExp(`${job}${named}(?:(?<!\\w)-)?\\d+(?:\\.\\d+)*`, "g"), (part, at) => {
    const hole = jobs && text.slice(0, at).endsWith("job ") ? "JOB" : names.includes(part) ? "OBJECT" : "#";
    found[hole].push(part);
    return hole;
  });
  return phrases.get(key)?.replace(/#|OBJECT|JOB/g, (hole) => (hole === "#" ? local(found[hole].shift() ?? hole) : found[hole].shift() ?? hole));
}

/** A number with the decimal mark of the language; names and addresses as they are. */
const local = (text) => (/^-?\d+\.\d+$/.test(text) ? text.replace(".", (1.5).toLocaleString(shown)[1]) : text);

/** A sentence of the cell in the chosen language. */
function said(text) {
  if (shown === "en") return text;
  return text.split(/(; |: |, then |\n|(?:celld recover )?(?<![\w-])--(?:place|hold|retreat|release) +)/).map((part, index) => (index % 2 ? table[part] ?? part : phrase(part))).join("");
}

/** A button's name in the quotation marks of the language. */
const quoted = (name) => t("“{name}”", { name: t(name) });

/** A sentence of the cell, with the names of this page's buttons in the place of the commands that do the same. */
export function here(text) {
  return said(text ?? "")
    .replace(/`?(?:celld recover )?(?<![\w-])--(place|hold|retreat|release)\b`?/g, (_, way) => quoted(WAYS[way]))
    .replace(/`celld ([a-z]+)[^`]*`/g, (whole, word) => (BUTTONS[word] ? quoted(BUTTONS[word]) : whole));
}

export const time = (unix) => new Date(unix * 1000).toLocaleTimeString(language());
export const moment = (unix) => new Date(unix * 1000).toLocaleString(language(), { dateStyle: "short", timeStyle: "medium" });
export const number = (value, digits = 1) => value.toLocaleString(language(), { maximumFractionDigits: digits, minimumFractionDigits: digits });

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const s = Math.max(0, Math.round(seconds));
  return s < 60 ? `${s} s` : `${Math.floor(s / 60)} min ${s % 60} s`;
}
