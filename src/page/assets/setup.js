// What is set once: language and light, markers to print, who is signed in.

import { h, card, fill } from "./dom.js";
import { api, state } from "./net.js";
import { t, language, languages, moment } from "./text.js";

function markers() {
  // Each size of the configuration by itself: a marker of another size is seen where it is not.
  const sizes = new Map();
  const known = [...state.cell.objects.map(({ marker, marker_size }) => [marker, marker_size]), ...state.cell.references.map(({ id, size }) => [id, size])];
  for (const [marker, edge] of known.filter(([marker]) => marker !== null)) {
    const mm = Math.round(edge * 1e5) / 100;
    sizes.set(mm, [...(sizes.get(mm) ?? []), marker]);
  }
  const [first, numbers] = [...sizes][0] ?? [36, [0, 1, 2, 3]];
  const ids = h("input", { id: "ids", value: numbers.join(","), "aria-label": t("numbers") });
  const size = h("input", { id: "size", type: "number", value: first, min: 5, max: 300, step: "any", "aria-label": t("edge, mm") });
  const which = h("select", { id: "sizes", "aria-label": t("of the configuration") }, [...sizes].map(([mm, all]) => h("option", { value: mm }, `${mm} mm: ${all.length > 6 ? t("{count} markers", { count: all.length }) : all.join(", ")}`)));
  which.addEventListener("change", () => { [ids.value, size.value] = [sizes.get(Number(which.value)).join(","), which.value]; update(); });
  const paper = h("select", { id: "paper", "aria-label": t("paper") }, h("option", { value: "a4" }, "A4"), h("option", { value: "letter" }, "Letter"));
  const link = h("a", { class: "button", download: "markers.pdf" }, t("Make a PDF"));
  const update = () => { link.href = "/api/v1/markers.pdf?" + new URLSearchParams({ ids: ids.value, size_mm: size.value, paper: paper.value }); };
  for (const input of [ids, size, paper]) input.addEventListener("input", update);
  update();
  return card(t("Print markers"), h("p", {}, t("Those of the configuration that have one size are filled in; the edge is that of the black square, mm. Print at 100 % and measure the ruler.")), h("div", { class: "row" }, sizes.size ? which : null, ids, size, paper, link));
}

function look() {
  const tongue = h("select", { id: "language", "aria-label": t("Language"), change: (event) => { localStorage.setItem("language", event.target.value); location.reload(); } });
  languages().then((all) => fill(tongue, Object.entries(all).map(([code, name]) => h("option", { value: code, lang: code, selected: code === language() }, name))));
  const theme = h("select", { "aria-label": t("Light or dark"), change: (event) => { localStorage.setItem("theme", event.target.value); document.documentElement.dataset.theme = event.target.value; } },
    [["", t("as the computer")], ["light", t("light")], ["dark", t("dark")]].map(([code, name]) => h("option", { value: code, selected: code === (localStorage.getItem("theme") ?? "") }, name)));
  return card(t("Language and light"), h("div", { class: "row" }, tongue, theme));
}

function person() {
  const me = state.me;
  return card(t("Signed in"), h("dl", {}, h("dt", {}, t("name")), h("dd", {}, me.name), h("dt", {}, t("role")), h("dd", {}, t(me.role)), h("dt", {}, t("until")), h("dd", {}, moment(me.until_unix_s))),
    h("div", { class: "row" }, h("button", { type: "button", click: async () => { await api("sign-out", { body: {} }); location.reload(); } }, t("Sign out"))),
    h("p", { class: "soft" }, t("On the cell's computer, `celld open` signs a browser in, and `celld open --token` gives a program a token.")));
}

export function setupPage(main) {
  fill(main, h("div", { class: "grid" }, look(), person(), markers(),
    card(t("Interface for programs"), h("p", {}, h("a", { href: "/api/v1/openapi.json" }, "OpenAPI"), ", ", h("a", { href: "/metrics" }, "Prometheus")))));
  return () => {};
}
