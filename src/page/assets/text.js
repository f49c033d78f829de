// Texts in the language of the browser, or the one chosen: English is in the scripts, others in one table
// each. What the cell itself says (status, reasons) stays in its own words.

let table = {};
export const languages = { en: "English", de: "Deutsch" };

export function language() {
  const chosen = localStorage.getItem("language");
  if (chosen && languages[chosen]) return chosen;
  return navigator.language.toLowerCase().startsWith("de") ? "de" : "en";
}

export async function load() {
  const chosen = language();
  document.documentElement.lang = chosen;
  if (chosen === "en") return;
  const answer = await fetch(`/text-${chosen}.json`);
  table = answer.ok ? await answer.json() : {};
}

/** The text in the chosen language, `{name}` filled in. */
export function t(text, values = {}) {
  let found = table[text] ?? text;
  for (const [name, value] of Object.entries(values)) found = found.replaceAll(`{${name}}`, value);
  return found;
}

export const time = (unix) => new Date(unix * 1000).toLocaleTimeString(language());
export const moment = (unix) => new Date(unix * 1000).toLocaleString(language(), { dateStyle: "short", timeStyle: "medium" });
export const number = (value, digits = 1) => value.toLocaleString(language(), { maximumFractionDigits: digits, minimumFractionDigits: digits });

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const s = Math.max(0, Math.round(seconds));
  return s < 60 ? `${s} s` : `${Math.floor(s / 60)} min ${s % 60} s`;
}
