// A trend as a line, with its last value and its range in words.

import { h, s } from "./dom.js";
import { t, number } from "./text.js";

/** Points are pairs: a time, a value. */
export function spark(points, unit) {
  if (points.length < 2) return h("p", { class: "soft" }, t("not enough values yet"));
  const values = points.map(([, value]) => value);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const y = (value) => 60 - 56 * (value - low) / (high - low || 1);
  const line = values.map((value, index) => `${(index * 300 / (values.length - 1)).toFixed(1)} ${y(value).toFixed(1)}`).join("L");
  return h("div", {}, s("svg", { class: "spark", viewBox: "-2 0 304 64", preserveAspectRatio: "none", role: "img", "aria-label": `${number(low)} – ${number(high)} ${unit}` }, s("path", { d: "M" + line, "vector-effect": "non-scaling-stroke" })),
    h("p", { class: "soft" }, `${t("last")} ${number(values.at(-1), 2)} ${unit}, ${t("range")} ${number(low, 2)} – ${number(high, 2)} ${unit}`));
}
