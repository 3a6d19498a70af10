// What a plot offers besides being seen: its values, a box to zoom into, panning, pinching, reset, and files of it.
import { el, placeIn } from "./dom.js";
import { csvOf, download, fileName, picture } from "./paper.js";
import { distance, nameAt, nearestOn, readText } from "./plots.js";

const LEAST_DRAG = 6, NEAR = 26, DOUBLE_CLICK = 260;

/** The limits of a scale `factor` times nearer at a pixel, which then moves by `shift`; null where a log axis has none. */
function limitsAt(scale, ends, log, factor, around, shift = 0) {
  const middle = around ?? (ends[0] + ends[1]) / 2;
  const limits = ends.map((end) => scale.inverse(middle + (end - middle - shift) / factor)).sort((u, v) => u - v);
  return log && !(limits[0] > 0) ? null : limits;
}

/** The place on a plot's lines, marks and cells that is read at a pixel: {series, k, x, y}, null where nothing is near. */
export function readingAt({ frame, readings = [] }, [px, py]) {
  let found = null, least = NEAR;
  const offer = (series, k, u, v) => {
    const away = distance([u, v], [px, py]);
    if (away < least) { least = away; found = { series, k, x: series.joined ? frame.x.inverse(u) : series.xs[k], y: series.joined ? frame.y.inverse(v) : series.ys[k] }; }
  };
  for (const series of readings) {
    if (series.edges || series.low) continue;
    series.xs.forEach((x, k) => {
      const [u, v] = [frame.x(x), frame.y(series.ys[k])];
      if (!Number.isFinite(u + v)) return;
      if (!series.joined || !k) { offer(series, k, u, v); return; }
      const before = [frame.x(series.xs[k - 1]), frame.y(series.ys[k - 1])];
      if (before.every(Number.isFinite)) offer(series, k, ...nearestOn([px, py], before, [u, v]));
    });
  }
  const inside = (edges, value) => edges.findIndex((edge, k) => k > 0 && (value - edges[k - 1]) * (value - edge) <= 0) - 1;
  if (found?.series.name) return found;
  for (const series of readings) {
    const { xs, ys, edges, low } = series, [x, y] = [frame.x.inverse(px), frame.y.inverse(py)];
    let k = -1;
    if (edges) {
      const [i, j] = [inside(edges[0], x), inside(edges[1], y)];
      if (i >= 0 && j >= 0) k = j * (edges[0].length - 1) + i;
    } else if (low) {
      const n = inside(xs, x), share = (x - xs[n]) / (xs[n + 1] - xs[n] || 1), at = (values) => values[n] + share * (values[n + 1] - values[n]);
      if (n >= 0 && (y - at(low)) * (y - at(ys)) <= 0) k = share < 0.5 ? n : n + 1;
    }
    if (k >= 0) found = { series, k, x: xs[k], y: ys[k] };
  }
  return found;
}

/** What is read in a plot, as columns. */
function tableOf({ readings = [], frame }) {
  const name = (axis, other) => axis?.said || axis?.label || other, names = readings.some((one) => one.name), texts = readings.some((one) => one.texts), columns = {};
  const all = (of) => readings.flatMap((one) => one.xs.map((_, k) => of(one, k)));
  if (names) columns.name = all((one) => one.name);
  columns[name(frame?.xAxis, "x")] = all((one, k) => nameAt(frame.xAxis, one.xs[k]) ?? one.xs[k]);
  columns[name(frame?.yAxis, "y")] = all((one, k) => nameAt(frame.yAxis, one.ys[k]) ?? one.ys[k]);
  if (texts) columns.value = all((one, k) => (one.texts?.[k] ?? "").replaceAll("−", "-"));
  return columns;
}

/**
 * Make a plot's canvas interactive.
 *
 * draw(canvas): draws the plot on its canvas or on paper. Options: about(): {title, name, notes, keys, bar} of an export,
 * see `picture`; files: [[label, ending, () => text]], by default a table of what is read; click(place, event); scrub(place): hears of drags in place of a
 * zoom box; zoomed(): hears of each zoom; over: the element that hears the pointer, where it is not the canvas.
 * Returns {menu, band, redraw, set(zoom, silent)}: the menu, and what lies over the canvas.
 */
export function interactive(canvas, draw, { about = () => ({ title: "" }), files = [["CSV", "csv", () => csvOf(tableOf(canvas))]], click, scrub, zoomed, over = canvas } = {}) {
  const band = el("div", { class: "vx-band", hidden: true }), tip = el("div", { class: "vx-tip", role: "status", hidden: true }), ring = el("span", { class: "vx-at", hidden: true });
  const touches = new Map();
  let from = null, dragged = false, panned = null, pinched = null, waiting = 0, shown = null;
  const redraw = () => { draw(canvas); };
  const set = (zoom, silent = false) => {
    canvas.zoom = zoom;
    if (!silent) { tell(null); redraw(); }
    menu.classList.toggle("vx-zoomed", Boolean(zoom));
    if (!silent) zoomed?.(zoom);
  };
  /** Show the limits of a frame nearer around a place, and moved. */
  const scaled = ({ box, x, y, xAxis, yAxis }, factor, at = [], shift = [0, 0]) => {
    const limits = [limitsAt(x, [box.left, box.right], xAxis.log, factor, at[0], shift[0]), limitsAt(y, [box.bottom, box.top], yAxis.log, factor, at[1], shift[1])];
    if (limits[0] && limits[1]) set(limits);
  };
  const scaledBy = (factor, at) => { if (canvas.frame) scaled(canvas.frame, factor, at); };
  const place = (event) => placeIn(canvas, event);
  const isInside = ([x, y], { left, right, top, bottom }) => x > left - 1 && x < right + 1 && y > top - 1 && y < bottom + 1;
  const inside = ([x, y], { box }) => [Math.max(box.left, Math.min(box.right, x)), Math.max(box.top, Math.min(box.bottom, y))];
  const middleOf = ([a, b]) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];

  /** Say what is read at a place of the plot; null: nothing. */
  function tell(found) {
    shown = found;
    tip.hidden = ring.hidden = !found;
    if (!found) return;
    const { x: sx, y: sy, xAxis, yAxis } = canvas.frame, { series, k } = found, [u, v] = [sx(found.x) + canvas.offsetLeft, sy(found.y) + canvas.offsetTop];
    const up = readText(series.name ? { ...yAxis, said: (yAxis.said ?? yAxis.label ?? "").replace(/^[^[]*(?=\[)/, " ") } : yAxis, series.low ? found.y - series.low[k] : found.y), text = series.low ? null : series.texts?.[k];
    canvas.parentNode.append(ring, tip);
    tip.replaceChildren(...[[series.name, text || up].filter(Boolean).join(": "), ...(text ? [readText(yAxis, found.y)] : []), readText(xAxis, found.x)].map((line, n) => el(n ? "span" : "b", { text: line })));
    ring.style.cssText = `left:${u}px;top:${v}px`;
    tip.style.left = `${Math.max(2, Math.min(u + 12, canvas.parentNode.clientWidth - tip.offsetWidth - 2))}px`;
    tip.style.top = `${v > canvas.offsetTop + canvas.clientHeight / 2 ? v - tip.offsetHeight - 10 : v + 12}px`;
  }
  if (over === canvas) {
    canvas.tabIndex = 0;
    canvas.addEventListener("pointermove", (event) => tell(from && dragged ? null : canvas.frame && readingAt(canvas, place(event))));
    for (const name of ["pointerleave", "blur"]) canvas.addEventListener(name, () => tell(null));
    canvas.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && shown) { click?.([canvas.frame.x(shown.x), canvas.frame.y(shown.y)], event); return; }
      const [along, across] = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1], Home: [-1e9, 0], End: [1e9, 0] }[event.key] ?? [0, 0], { frame } = canvas;
      const seen = ({ xs, ys }) => [...xs.keys()].filter((k) => isInside([frame.x(xs[k]), frame.y(ys[k])], frame.box)), readings = frame ? canvas.readings.filter((one) => seen(one).length) : [];
      if ((!along && !across) || !readings.length || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      const at = Math.max(0, readings.indexOf(shown?.series)), series = readings[(at + (shown ? across : 0) + readings.length) % readings.length];
      const known = seen(series), next = known.findIndex((k) => k >= (shown?.k ?? 0));
      const k = known[Math.max(0, Math.min(known.length - 1, (next < 0 ? known.length - 1 : next) + (shown ? along * (event.shiftKey ? 10 : 1) : 0)))];
      if (k !== undefined) tell({ series, k, x: series.xs[k], y: series.ys[k] });
    });
  }
  over.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || !canvas.frame) return;
    dragged = false;
    if (event.pointerType === "touch") {
      touches.set(event.pointerId, place(event));
      pinched = touches.size === 2 ? { frame: canvas.frame, ends: [...touches.values()] } : null;
      if (pinched || (!scrub && !canvas.zoom)) { from = null; return; }
    }
    from = place(event);
    panned = event.shiftKey || (event.pointerType === "touch" && canvas.zoom) ? canvas.frame : null;
  });
  over.addEventListener("pointermove", (event) => {
    const to = place(event), { frame } = canvas;
    if (touches.has(event.pointerId)) touches.set(event.pointerId, to);
    if (pinched) {
      const ends = [...touches.values()], [was, is] = [middleOf(pinched.ends), middleOf(ends)];
      dragged = true;
      scaled(pinched.frame, distance(...ends) / (distance(...pinched.ends) || 1), was, [is[0] - was[0], is[1] - was[1]]);
      return;
    }
    if (!from) return;
    if (!dragged && distance(from, to) < LEAST_DRAG) return;
    if (!dragged) over.setPointerCapture(event.pointerId);
    dragged = true;
    if (panned) scaled(panned, 1, [], [to[0] - from[0], to[1] - from[1]]);
    else if (scrub) scrub(to);
    else {
      const [a, b] = [inside(from, frame), inside(to, frame)], base = [canvas.offsetLeft, canvas.offsetTop];
      band.hidden = false;
      band.style.cssText = `left:${base[0] + Math.min(a[0], b[0])}px;top:${base[1] + Math.min(a[1], b[1])}px;width:${Math.abs(a[0] - b[0])}px;height:${Math.abs(a[1] - b[1])}px`;
    }
  });
  const ended = (event) => {
    touches.delete(event.pointerId);
    band.hidden = true;
    from = pinched = null;
  };
  over.addEventListener("pointerup", (event) => {
    if (from && dragged && !panned && !scrub) {
      const { frame } = canvas, [a, b] = [inside(from, frame), inside(place(event), frame)];
      const between = (scale, k) => [scale.inverse(a[k]), scale.inverse(b[k])].sort((u, v) => u - v);
      if (Math.abs(a[0] - b[0]) > LEAST_DRAG && Math.abs(a[1] - b[1]) > LEAST_DRAG) set([between(frame.x, 0), between(frame.y, 1)]);
    }
    ended(event);
  });
  over.addEventListener("pointercancel", ended);
  // Two fingers zoom, and one moves what is zoomed; else a finger scrolls the page.
  over.addEventListener("touchmove", (event) => { if (event.cancelable && (event.touches.length > 1 || canvas.zoom)) event.preventDefault(); }, { passive: false });
  over.addEventListener("click", (event) => {
    const chosen = click ?? scrub;
    clearTimeout(waiting);
    // A finger does not hover: a tap reads the value.
    if (event.pointerType === "touch" && over === canvas && !dragged && canvas.frame) tell(readingAt(canvas, place(event)));
    if (dragged) event.stopImmediatePropagation();
    // The first click of two that reset a zoom chooses nothing.
    else if (chosen && canvas.zoom) { if (event.detail < 2) waiting = setTimeout(() => chosen(place(event), event), DOUBLE_CLICK); } else chosen?.(place(event), event);
    dragged = false;
  });
  over.addEventListener("dblclick", () => { clearTimeout(waiting); if (canvas.zoom) set(null); });
  over.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    scaledBy(event.deltaY < 0 ? 1.25 : 0.8, place(event));
  }, { passive: false });
  const save = async (type) => { const said = about(); download(await picture(canvas, draw, said, type), fileName(said.name ?? said.title, type)); };
  const action = (text, run) => el("button", { type: "button", text, onclick: () => run() });
  const menu = el("details", { class: "vx-menu" }, el("summary", { "aria-label": `Zoom and files of the plot ${about().title}`.trim(), title: "Zoom and files", text: "⋯" }),
    el("div", {}, action("Zoom in", () => scaledBy(1.6)), action("Zoom out", () => scaledBy(1 / 1.6)), action("Reset zoom", () => set(null)),
      action("PNG", () => save("png")), action("SVG", () => save("svg")),
      ...files.map(([label, ending, text]) => action(label, () => download(text(), fileName(about().name ?? about().title, ending))))));
  menu.addEventListener("keydown", (event) => { if (event.key === "Escape") { menu.open = false; menu.firstChild.focus(); } });
  menu.addEventListener("focusout", (event) => { if (!menu.contains(event.relatedTarget)) menu.open = false; });
  const reset = el("button", { type: "button", class: "vx-reset", text: "reset zoom", onclick: () => set(null) });
  return { menu: el("span", { class: "vx-tools" }, reset, menu), band, redraw, set };
}
