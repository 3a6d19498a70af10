// Pointer and keys over the map: which cell is meant, what is said of it, and that it is picked.
import { el, placeIn } from "./dom.js";

/** Where keys lead, in cells. */
const WAYS = {
  ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
  Home: [-1e9, 0], End: [1e9, 0], PageUp: [0, 1e9], PageDown: [0, -1e9],
};

const placeText = (page, at) => Object.entries(at).map(([name, value]) => page.grid.coordinateText({ ...page.grid.axes.get(name), values: [value] }, 0)).join(", ");

/** Say in a tip what stands at a cell, at a place of the map; null: the tip goes. */
function hover(page, cell, place) {
  page.view.drawOver(cell);
  page.tip.hidden = !cell;
  if (!cell) return;
  const inside = place && page.view.patchAt(place), value = page.grid.valueText(page.variable, inside ? inside.value : page.grid.value(page.variable.name, cell));
  const names = page.view.namesAt(place, cell).map((name) => el("b", { text: name }));
  const border = page.view.borderAt(place);
  if (border) names.push(el("span", { text: `${border}: ${page.data.meanings?.[border] ?? "a border"}` }));
  page.tip.replaceChildren(...names, el("b", { text: value }), el("span", { text: inside ? placeText(page, inside.at) : page.grid.cellText(cell, page.variable.axes, undefined, true) }));
  const box = page.over.getBoundingClientRect(), wide = page.tip.offsetWidth;
  page.tip.style.left = `${Math.max(0, Math.min(place[0] + 14, box.width - wide - 4))}px`;
  page.tip.style.top = `${place[1] > box.height / 2 ? place[1] - page.tip.offsetHeight - 12 : place[1] + 16}px`;
}

/** Hear the pointer and the keys over the map of a page. */
export function listen(page) {
  const over = (event) => { const place = placeIn(page.over, event); hover(page, page.view.at(...place), place); };
  page.over.addEventListener("pointermove", over);
  page.over.addEventListener("pointerleave", () => hover(page, null));
  page.over.addEventListener("click", (event) => { if (event.pointerType === "touch") over(event); });
  page.over.addEventListener("keydown", (event) => {
    const way = WAYS[event.key];
    if (!way || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    const by = event.shiftKey ? 10 : 1;
    page.pick(page.view.moved(way[0] * by, way[1] * by));
  });
}
