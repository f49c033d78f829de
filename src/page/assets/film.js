// The camera's pictures as they come. A page that is not looked at, or a card that is gone, watches no longer.

import { h } from "./dom.js";
import { t } from "./text.js";

export function film(attributes = {}) {
  const image = h("img", { alt: t("The camera's picture, live"), width: 1280, height: 720, ...attributes });
  let on = false;
  let again = null;
  const update = () => {
    clearTimeout(again);
    if (on && !document.hidden) image.src = `/api/v1/film?at=${Date.now()}`;
    else image.removeAttribute("src");
  };
  // Refused, or celld was started anew.
  image.addEventListener("error", () => { if (image.hasAttribute("src")) again = setTimeout(update, 2000); });
  document.addEventListener("visibilitychange", update);
  const turn = (wanted) => { if (on !== wanted) { on = wanted; update(); } };
  return { image, turn, stop: () => { turn(false); document.removeEventListener("visibilitychange", update); } };
}
