// The camera's last picture with what was recognised, where things go, and the numbered moves; or the
// pictures as they come, without all that: the arm moves, and what was recognised was seen from elsewhere.

import { h, s, card, fill } from "./dom.js";
import { api, on, state, colour } from "./net.js";
import { t, time } from "./text.js";
import { film } from "./film.js";
import { spread } from "./table.js";

/** Of the letters, in pixels of the picture: as in the style sheet. */
const TEXT_PX = 24;

const line = (points) => "M" + points.map(([x, y]) => `${x} ${y}`).join("L") + "Z";

export function picture() {
  const image = h("img", { alt: t("The camera's last picture"), width: 1280, height: 720 });
  const over = s("svg", { "aria-hidden": "true" });
  const holder = h("div", { class: "picture", hidden: true }, image, over);
  const none = h("p", { class: "soft" }, t("No picture yet: the camera takes one when the cell looks."));
  const taken = h("p", { class: "soft", id: "taken", hidden: true });
  const live = film();
  const moving = h("div", { class: "picture", hidden: true }, live.image);
  const toggle = h("button", { type: "button", id: "film", "aria-pressed": "false", hidden: !state.cell.film, click: () => turn(moving.hidden) }, t("Live"));
  let shown = 0;
  let wanted = "";
  const turn = (on) => {
    toggle.setAttribute("aria-pressed", String(on));
    toggle.classList.toggle("first", on);
    moving.hidden = !on;
    holder.hidden = taken.hidden = on || !shown;
    none.hidden = on || Boolean(shown);
    live.turn(on);
    localStorage.setItem("film", on ? "on" : "");
  };
  const draw = (view) => {
    over.setAttribute("viewBox", `0 0 ${view.width} ${view.height}`);
    const middle = (points) => points.reduce(([a, b], [x, y]) => [a + x / points.length, b + y / points.length], [0, 0]);
    const coloured = (kind) => ({ id, outline }) => {
      const drawn = s("path", { class: kind, d: line(outline) });
      drawn.style.stroke = colour(id);
      return drawn;
    };
    const head = ([x0, y0], [x1, y1]) => {
      const a = Math.atan2(y1 - y0, x1 - x0);
      const p = (d, r) => [(x1 + r * Math.cos(a + d)).toFixed(1), (y1 + r * Math.sin(a + d)).toFixed(1)];
      return s("path", { class: "p-head", d: line([[x1, y1], p(2.7, 26), p(-2.7, 26)]) });
    };
    const texts = [...view.moves.map(({ number, from, to }) => ({ text: number, at: [from[0] + 0.3 * (to[0] - from[0]), from[1] + 0.3 * (to[1] - from[1])] })),
      ...view.objects.map(({ id, outline }) => ({ text: id, at: middle(outline) }))];
    const places = spread(texts, TEXT_PX);
    fill(over, view.foreign.map((outline) => s("path", { class: "p-foreign", d: line(outline) })),
      view.goals.map(coloured("p-goal")), view.objects.map(coloured("p-object")),
      view.moves.map(({ from, to }) => [s("path", { class: "p-under", d: `M${from}L${to}` }), s("path", { class: "p-move", d: `M${from}L${to}` }), head(from, to)]),
      texts.map(({ text }, index) => s("text", { class: "p-text", x: places[index][0], y: places[index][1] }, String(text))));
  };
  const update = async () => {
    if (!state.picture) return;
    try {
      const view = await api("picture");
      if (view.number !== shown) {
        shown = view.number;
        image.src = `/api/v1/picture.jpg?number=${shown}`;
      }
      none.hidden = true;
      holder.hidden = taken.hidden = !moving.hidden;
      taken.textContent = t("Taken at {time}", { time: time(view.unix_s) });
      draw(view);
    } catch { /* there is none yet */ }
  };
  const stops = [on("picture", update), on("sight", update), on("status", () => {
    const now = JSON.stringify([state.status?.plan?.unix_s, state.status?.job]);
    if (now !== wanted) { wanted = now; update(); }
  }), live.stop];
  update();
  if (localStorage.getItem("film") && state.cell.film) turn(true);
  return { element: card(t("Camera"), h("div", { class: "row" }, toggle), holder, moving, taken, none), stop: () => stops.forEach((stop) => stop()) };
}
