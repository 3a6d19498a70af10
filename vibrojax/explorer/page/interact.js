// What a plot offers besides being seen: a box to zoom into, panning, reset, and files of it.
import { el } from "./dom.js";
import { download, fileName, picture } from "./paper.js";

const LEAST_DRAG = 6;

/** The limits in the middle of a scale's, by a factor narrower, around a pixel; a shift moves them by pixels. */
function limitsAt(scale, ends, log, factor, around, shift = 0) {
  const middle = around ?? (ends[0] + ends[1]) / 2;
  const limits = ends.map((end) => scale.inverse(middle + (end - middle) / factor - shift)).sort((u, v) => u - v);
  return log && !(limits[0] > 0) ? null : limits;
}

/**
 * Make a plot's canvas interactive.
 *
 * draw(canvas): draws the plot on its canvas or on paper. Options: title() and keys() of an export; files: [[label,
 * ending, () => text]]; click(place, event); scrub(place): hears of drags in place of a zoom box; zoomed(): hears of
 * each zoom; over: the element that hears the pointer, where it is not the canvas.
 * Returns {menu, layer, redraw}: the menu, and what lies over the canvas.
 */
export function interactive(canvas, draw, { title = () => "", keys = () => [], files = [], click, scrub, zoomed, over = canvas } = {}) {
  const band = el("div", { class: "vx-band", hidden: true });
  const redraw = () => { draw(canvas); };
  const set = (zoom) => {
    canvas.zoom = zoom;
    redraw();
    menu.classList.toggle("vx-zoomed", Boolean(zoom));
    zoomed?.(zoom);
  };
  const scaledBy = (factor, at = []) => {
    const { frame } = canvas;
    if (!frame) return;
    const { box } = frame;
    const x = limitsAt(frame.x, [box.left, box.right], frame.xAxis.log, factor, at[0]), y = limitsAt(frame.y, [box.bottom, box.top], frame.yAxis.log, factor, at[1]);
    if (x && y) set([x, y]);
  };
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const inside = ([x, y], { box }) => [Math.max(box.left, Math.min(box.right, x)), Math.max(box.top, Math.min(box.bottom, y))];
  let from = null, dragged = false, panned = null;
  over.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || !canvas.frame) return;
    dragged = false;
    if (event.pointerType === "touch" && !scrub) return;
    from = place(event);
    panned = event.shiftKey ? canvas.frame : null;
  });
  over.addEventListener("pointermove", (event) => {
    if (!from) return;
    const to = place(event), { frame } = canvas;
    if (!dragged && Math.hypot(to[0] - from[0], to[1] - from[1]) < LEAST_DRAG) return;
    if (!dragged) over.setPointerCapture(event.pointerId);
    dragged = true;
    if (panned) {
      const { box } = panned;
      const x = limitsAt(panned.x, [box.left, box.right], panned.xAxis.log, 1, null, to[0] - from[0]), y = limitsAt(panned.y, [box.bottom, box.top], panned.yAxis.log, 1, null, to[1] - from[1]);
      if (x && y) set([x, y]);
    } else if (scrub) scrub(to);
    else {
      const [a, b] = [inside(from, frame), inside(to, frame)], base = [canvas.offsetLeft, canvas.offsetTop];
      band.hidden = false;
      band.style.cssText = `left:${base[0] + Math.min(a[0], b[0])}px;top:${base[1] + Math.min(a[1], b[1])}px;width:${Math.abs(a[0] - b[0])}px;height:${Math.abs(a[1] - b[1])}px`;
    }
  });
  over.addEventListener("pointerup", (event) => {
    if (from && dragged && !panned && !scrub) {
      const { frame } = canvas, [a, b] = [inside(from, frame), inside(place(event), frame)];
      const between = (scale, k) => [scale.inverse(a[k]), scale.inverse(b[k])].sort((u, v) => u - v);
      if (Math.abs(a[0] - b[0]) > LEAST_DRAG && Math.abs(a[1] - b[1]) > LEAST_DRAG) set([between(frame.x, 0), between(frame.y, 1)]);
    }
    band.hidden = true;
    from = null;
  });
  over.addEventListener("pointercancel", () => { band.hidden = true; from = null; });
  over.addEventListener("click", (event) => {
    if (dragged) event.stopImmediatePropagation();
    else if (click) click(place(event), event);
    else if (scrub) scrub(place(event));
    dragged = false;
  });
  over.addEventListener("dblclick", () => { if (canvas.zoom) set(null); });
  over.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    scaledBy(event.deltaY < 0 ? 1.25 : 0.8, place(event));
  }, { passive: false });
  const save = async (type) => download(await picture(canvas, draw, { title: title(), keys: keys() }, type), fileName(title(), type));
  const action = (text, run) => el("button", { type: "button", text, onclick: () => run() });
  const menu = el("details", { class: "vx-menu" }, el("summary", { "aria-label": `Zoom and files of the plot ${title()}`.trim(), title: "Zoom and files", text: "⋯" }),
    el("div", {}, action("Zoom in", () => scaledBy(1.6)), action("Zoom out", () => scaledBy(1 / 1.6)), action("Reset zoom", () => set(null)),
      action("PNG", () => save("png")), action("SVG", () => save("svg")),
      ...files.map(([label, ending, text]) => action(label, () => download(text(), fileName(title(), ending))))));
  menu.addEventListener("keydown", (event) => { if (event.key === "Escape") { menu.open = false; menu.firstChild.focus(); } });
  menu.addEventListener("focusout", (event) => { if (!menu.contains(event.relatedTarget)) menu.open = false; });
  const reset = el("button", { type: "button", class: "vx-reset", text: "reset zoom", onclick: () => set(null) });
  return { menu: el("span", { class: "vx-tools" }, reset, menu), band, redraw, set };
}
