// Plots on canvas: scales, ticks, frames, lines, marks, signs of legends. Sizes are in CSS pixels.
import { el, indexed } from "./dom.js";

export const FONT = "system-ui, -apple-system, 'Segoe UI', sans-serif";

/** Colours of the scheme in use; those of lines are the pictures', lighter on dark ground. */
export function inkOf(element) {
  const style = getComputedStyle(element.source ?? element);
  const get = (name) => style.getPropertyValue(`--${name}`).trim();
  const ink = Object.fromEntries(
    ["ink", "faint", "grid", "ground", "plate", "bit", "striker", "stick", "impact", "rock", "slip", "accent", "pale"]
      .map((name) => [name, get(name)]));
  return { ...ink, undefined: hatched(ink.plate, get("undefined")) };
}

/** The filling of a cell without a value: hatched as in the pictures, since labels and colour maps have greys. */
function hatched(ground, colour) {
  const tile = document.createElement("canvas"), c = tile.getContext("2d"), size = 6;
  tile.width = tile.height = size;
  c.fillStyle = ground;
  c.fillRect(0, 0, size, size);
  c.strokeStyle = colour;
  c.beginPath();
  for (const shift of [-size, 0, size]) { c.moveTo(shift, size); c.lineTo(shift + size, 0); }
  c.stroke();
  return c.createPattern(tile, "repeat");
}

/** Red, green and blue of a colour #rrggbb. */
const partsOf = (colour) => [1, 3, 5].map((k) => parseInt(colour.slice(k, k + 2), 16));
const brightness = (colour) => partsOf(colour).reduce((sum, x) => sum + x, 0) / 765;

/** Whether a colour is a ground between white and grey, which dazzles on a dark plate. */
export const isPale = (colour) => brightness(colour) > 0.9 && Math.max(...partsOf(colour)) - Math.min(...partsOf(colour)) < 8;

const luminance = (colour) => partsOf(colour).map((x) => (x / 255) ** 2.2).reduce((sum, x, k) => sum + [0.2126, 0.7152, 0.0722][k] * x, 0);
const contrast = (colour, ground) => (luminance(colour) + 0.05) / (luminance(ground) + 0.05);

/** A colour of the pictures; where it would not be seen on the plate, mixed with the ink, or the ink in place of a grey. */
export function legible(colour, ink) {
  const dark = brightness(ink.plate) < 0.5, seen = dark ? contrast(colour, ink.plate) >= 3 : Math.abs(brightness(colour) - brightness(ink.plate)) >= 0.2;
  if (seen) return colour;
  const own = partsOf(colour), to = partsOf(ink.ink);
  return Math.max(...own) - Math.min(...own) < 40 ? ink.ink : `#${own.map((x, k) => Math.round((x + to[k]) / 2).toString(16).padStart(2, "0")).join("")}`;
}

/** The legible colour of marks with a label; the greys of several labels would be the same ink, and remain with their rims. */
const labelColour = (colour, ink) => { const own = legible(colour, ink); return own === ink.ink ? colour : own; };

/** The colour of a value's mark; those of a scale keep their order. */
export function markColour(grid, variable, value, ink) {
  const colour = grid.colour(variable, value, ink);
  return variable.flags && colour !== ink.undefined ? labelColour(colour, ink) : colour;
}

/** A number as it is read: `digits` significant ones, a true minus, no trailing noise. */
export function numberText(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "—";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  const text = size !== 0 && (size < 1e-3 || size >= 1e5)
    ? value.toExponential(digits - 1).replace(/\.?0+e/, "e") : String(Number(value.toPrecision(digits)));
  return text.replaceAll("-", "−").replace("e+", "e");
}

/** Round values between two limits, about `count` of them. */
export function ticks(low, high, count, log = false) {
  if (!(high > low)) return [low];
  if (log && low > 0) {
    const powers = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) powers.push(10 ** power);
    const inside = (leads) => powers.flatMap((power) => leads.map((lead) => lead * power)).filter((x) => x >= low * 0.999 && x <= high * 1.001);
    const fine = inside([1, 2, 5]), found = fine.length <= Math.max(count, 3) ? fine : inside([1]);
    const every = Math.ceil(found.length / Math.max(count, 2));
    if (found.length > 1) return found.filter((_, k) => k % every === 0);
  }
  const rough = (high - low) / Math.max(count, 1), power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((lead) => lead * power >= rough * 0.999) * power;
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
}

/** Ticks of an axis, three or more also where it is short. */
function fewTicks({ limits, log }, wanted) {
  let count = Math.max(2, wanted), found = ticks(...limits, count, log);
  while (found.length < 3 && count < 8) found = ticks(...limits, ++count, log);
  return found;
}

/** As many digits as tell the ticks of an axis apart. */
const digitsOf = ({ limits: [low, high] }) => Math.min(15, Math.max(5, 3 + Math.ceil(Math.log10(Math.max(Math.abs(low), Math.abs(high)) / (high - low)) || 0)));

/** A scale from values to pixels. */
export function scaleOf(low, high, from, to, log = false) {
  const map = log ? Math.log : (x) => x, a = map(low), b = map(high);
  const scale = (x) => from + ((map(x) - a) / (b - a || 1)) * (to - from);
  scale.inverse = (pixel) => {
    const value = a + ((pixel - from) / (to - from)) * (b - a);
    return log ? Math.exp(value) : value;
  };
  return scale;
}

/** The number of the least of some values, -1 without one. */
export const leastOf = (values) => values.reduce((best, value, k) => (value < (values[best] ?? Infinity) ? k : best), -1);

export const distance = ([x, y], [u, v]) => Math.hypot(u - x, v - y);

/** The place on the straight line from one place to another that is nearest to a third. */
export function nearestOn([px, py], [ax, ay], [bx, by]) {
  const [dx, dy] = [bx - ax, by - ay], share = Math.max(0, Math.min(1, ((px - ax) * dx + (py - ay) * dy) / (dx * dx + dy * dy || 1)));
  return [ax + share * dx, ay + share * dy];
}

/** The canvas made as large as it is shown, and its context in CSS pixels. */
export function prepared(canvas) {
  const ratio = canvas.ratio ?? (window.devicePixelRatio || 1), { width, height } = canvas.getBoundingClientRect();
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = Object.assign(canvas.getContext("2d"), { ratio });
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

/** Limits of values with some room around them. */
export function limitsOf(arrays, room = 0.06) {
  let low = Infinity, high = -Infinity;
  for (const values of arrays) for (const x of values) if (Number.isFinite(x)) { if (x < low) low = x; if (x > high) high = x; }
  if (!(high >= low)) return [0, 1];
  const size = Math.max(Math.abs(low), Math.abs(high));
  if (high - low <= 1e-9 * size) { const more = 0.1 * size || 1; return [low - more, high + more]; }
  const more = room * (high - low);
  return [low - more, high + more];
}

/** The limits of values, and the only tick of such as are zero. */
export function limitsAndTicks(values) {
  const zero = values.some(Number.isFinite) && values.every((x) => !x);
  return { limits: limitsOf([values]), ticks: zero ? [[0, "0"]] : undefined };
}

/** Write the label of an axis around a place, narrowed to a length, with lowered indices. */
function writeLabel(c, text, x, y, most) {
  const parts = indexed(text), fonts = parts.map((_, k) => `${k % 3 === 2 ? 8.5 : 11.5}px ${FONT}`);
  if (parts.length === 1) { c.fillText(text, x, y, most); return; }
  const lengths = parts.map((part, k) => { c.font = fonts[k]; return c.measureText(part).width; });
  let at = x - lengths.reduce((sum, one) => sum + one) / 2;
  c.textAlign = "left";
  parts.forEach((part, k) => { c.font = fonts[k]; c.fillText(part, at, y + (k % 3 === 2 ? 3 : 0)); at += lengths[k]; });
  Object.assign(c, { font: fonts[0], textAlign: "center" });
}

/**
 * A frame with ticks and labels, and in it what `draw(context, x, y, box)` draws.
 * `x`, `y`: {limits, label, log, reversed, ticks: [[value, text]]}; options: {left, right, top, square, grid, empty: nothing to
 * draw}; returns the frame {x, y, box}.
 */
export function framed(canvas, ink, x, y, draw, options = {}) {
  const { context: c, width, height } = prepared(canvas);
  if (width < 20 || height < 20) return null;
  [x, y] = zoomed(canvas, x, y);
  if (y.bare) y = { ...y, said: y.label, label: "" };
  c.font = `11px ${FONT}`;
  c.textBaseline = "middle";
  const textOf = (axis, value) => (axis.bare ? "" : numberText(!axis.log && Math.abs(value) < 1e-12 * (axis.limits[1] - axis.limits[0]) ? 0 : value, digitsOf(axis)));
  const yTicks = options.empty ? [] : y.ticks ?? ticks(...y.limits, Math.max(3.2, height / 42), y.log).map((v) => [v, textOf(y, v)]);
  const wide = Math.max(0, ...yTicks.map(([, text]) => c.measureText(text).width));
  const left = Math.round(options.left ?? wide + (y.label ? 30 : 12)), bottom = x.label ? 36 : 20, top = options.top ?? 8;
  const box = { left, top, right: width - (options.right ?? 10), bottom: height - bottom };
  if (options.square) {
    const side = Math.min(box.right - box.left, box.bottom - box.top);
    box.left += Math.max(0, (box.right - box.left - side) / 2);
    box.right = box.left + side;
    box.top += Math.max(0, (box.bottom - box.top - side) / 2);
    box.bottom = box.top + side;
  }
  const ends = (axis) => (axis.reversed ? [...axis.limits].reverse() : axis.limits);
  const sx = scaleOf(...ends(x), box.left, box.right, x.log), sy = scaleOf(...ends(y), box.bottom, box.top, y.log);
  const xTicks = x.ticks ?? fewTicks(x, (box.right - box.left) / 62).map((v) => [v, textOf(x, v)]);
  c.lineWidth = 1;
  if (options.grid !== false) {
    c.strokeStyle = ink.grid;
    c.beginPath();
    for (const [value] of xTicks) { const at = Math.round(sx(value)) + 0.5; c.moveTo(at, box.top); c.lineTo(at, box.bottom); }
    for (const [value] of yTicks) { const at = Math.round(sy(value)) + 0.5; c.moveTo(box.left, at); c.lineTo(box.right, at); }
    c.stroke();
  }
  c.save();
  c.beginPath();
  c.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
  c.clip();
  readings = canvas.readings = [];
  draw(c, sx, sy, box);
  readings = null;
  c.restore();
  c.strokeStyle = ink.faint;
  c.strokeRect(box.left + 0.5, box.top + 0.5, box.right - box.left - 1, box.bottom - box.top - 1);
  c.fillStyle = ink.ink;
  c.textAlign = "center";
  let end = -Infinity;
  for (const [value, text] of xTicks) {
    const half = c.measureText(text).width / 2;
    const at = Math.min(Math.max(sx(value), half + 1), width - half - 1);
    if (at - half < end + 6) continue;
    c.fillText(text, at, box.bottom + 11);
    end = at + half;
  }
  c.textAlign = "right";
  for (const [value, text] of yTicks) c.fillText(text, box.left - 5, sy(value));
  c.font = `11.5px ${FONT}`;
  c.textAlign = "center";
  // A label is in the middle of its axis, and narrowed to what fits on both sides of it.
  const middle = [(box.left + box.right) / 2, (box.top + box.bottom) / 2];
  const room = (at, size) => 2 * Math.min(at, size - at) - 4;
  if (options.empty) c.fillText("no value here", ...middle);
  if (x.label) writeLabel(c, x.label, middle[0], box.bottom + 27, room(middle[0], width));
  if (y.label) {
    c.save();
    c.translate(options.square ? Math.max(9, box.left - wide - 18) : 9, middle[1]);
    c.rotate(-Math.PI / 2);
    writeLabel(c, y.label, 0, 0, room(middle[1], height));
    c.restore();
  }
  canvas.frame = { x: sx, y: sy, box, context: c, xAxis: x, yAxis: y, xTicks };
  return canvas.frame;
}

/** Axes with the limits that a canvas is zoomed to; named ticks outside of them go. */
function zoomed(canvas, ...axes) {
  return axes.map((axis, k) => {
    const limits = canvas.zoom?.[k];
    if (!limits) return axis;
    return { ...axis, limits, ticks: axis.ticks?.filter(([value]) => value >= limits[0] && value <= limits[1]) };
  });
}

/** Fill a cell to whole pixels of the screen: fractions would leave hairlines between neighbours. */
export function fillCell(c, ...ends) {
  const [x0, x1, y0, y1] = ends.map((end) => Math.round(end * c.ratio) / c.ratio);
  c.fillRect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0));
}

/** A line through points; not-finite ones part it. */
export function line(c, xs, ys, sx, sy, colour, width = 1.6, dash = []) {
  c.strokeStyle = colour;
  c.lineWidth = width;
  c.setLineDash(dash);
  c.lineJoin = "round";
  c.beginPath();
  let down = false;
  for (let i = 0; i < xs.length; i++) {
    if (!Number.isFinite(xs[i]) || !Number.isFinite(ys[i])) { down = false; continue; }
    if (down) c.lineTo(sx(xs[i]), sy(ys[i])); else c.moveTo(sx(xs[i]), sy(ys[i]));
    down = true;
  }
  c.stroke();
  c.setLineDash([]);
}

const same = (pixel) => pixel;

/** A line through a frame at a pixel, upright or level. */
export const uprightLine = (c, x, { top, bottom }, colour, width = 1.2, dash = []) => line(c, [x, x], [top, bottom], same, same, colour, width, dash);
export const levelLine = (c, y, { left, right }, colour, width = 1.2, dash = []) => line(c, [left, right], [y, y], same, same, colour, width, dash);

const AROUND = (count, ...radii) => Array.from({ length: count * radii.length }, (_, k) => [radii[k % radii.length], (2 * Math.PI * k) / (count * radii.length)])
  .map(([radius, angle]) => [radius * Math.sin(angle), -radius * Math.cos(angle)]);

/** The marks by their names in the pictures, as matplotlib has them: corners of an area, or strokes, of size 1. */
const AREAS = {
  s: [[-1, -1], [1, -1], [1, 1], [-1, 1]], D: AROUND(4, 1.3), p: AROUND(5, 1.2), h: AROUND(6, 1.2), "*": AROUND(5, 1.6, 0.62), _: [[-1.6, -0.35], [1.6, -0.35], [1.6, 0.35], [-1.6, 0.35]], "|": [[-0.35, -1.6], [0.35, -1.6], [0.35, 1.6], [-0.35, 1.6]],
  "^": [[0, -1.2], [1, 1], [-1, 1]], v: [[0, 1.2], [1, -1], [-1, -1]], "<": [[-1.2, 0], [1, 1], [1, -1]], ">": [[1.2, 0], [-1, 1], [-1, -1]],
  P: [[-0.4, -1.1], [0.4, -1.1], [0.4, -0.4], [1.1, -0.4], [1.1, 0.4], [0.4, 0.4], [0.4, 1.1], [-0.4, 1.1], [-0.4, 0.4], [-1.1, 0.4], [-1.1, -0.4], [-0.4, -0.4]],
};
const STROKES = { x: [[-1, -1, 1, 1], [-1, 1, 1, -1]], "+": [[-1, 0, 1, 0], [0, -1, 0, 1]] };

/** A mark: a name of the table, a circle for any other. */
export function mark(c, kind, x, y, size, colour, edge) {
  c.beginPath();
  for (const [x0, y0, x1, y1] of STROKES[kind] ?? []) { c.moveTo(x + size * x0, y + size * y0); c.lineTo(x + size * x1, y + size * y1); }
  if (kind in STROKES) { c.strokeStyle = colour; c.lineWidth = 1.8; c.stroke(); return; }
  if (kind in AREAS) AREAS[kind].forEach(([u, v], k) => c[k ? "lineTo" : "moveTo"](x + size * u, y + size * v)); else c.arc(x, y, size, 0, 2 * Math.PI);
  c.closePath();
  c.fillStyle = colour;
  c.fill();
  if (edge) { c.strokeStyle = edge; c.lineWidth = 1; c.stroke(); }
}

/** How wide the sign of an entry of a legend is. */
export const signWidth = ({ shape }) => (shape === "line" ? 28 : 14);

/**
 * What stands before an entry {text, shape: "line", "patch" or a mark, colour, dash, marker: on the line, hollow, rim} of a
 * legend, 14 high at a place: as it stands in the plot.
 */
export function drawSign(c, key, left, top, ink) {
  const { shape, colour, dash, marker, hollow, size = 3 } = key, wide = signWidth(key), own = ink[colour] ?? (key.rim ? labelColour : legible)(colour, ink), y = top + 7, middle = left + wide / 2;
  const spot = (kind) => mark(c, kind, middle, y, Math.max(2.4, Math.min(5.4, (4 / 3) * size)), hollow ? ink.plate : own, hollow ? own : key.rim ? ink.faint : null);
  if (shape === "line") {
    levelLine(c, y, { left: left + 1, right: left + wide - 1 }, own, 2, dash);
    if (marker) spot(marker);
  } else if (shape === "patch") {
    c.fillStyle = colour === "hatched" ? ink.undefined : ink[colour] ?? (isPale(colour) ? ink.pale : colour);
    c.fillRect(middle - 6, y - 6, 12, 12);
    c.strokeStyle = ink.faint;
    c.lineWidth = 1;
    c.strokeRect(middle - 6, y - 6, 12, 12);
  } else spot(shape);
}

/** A bar of a quantity's colours, with arrows at the ends beyond which there are values. */
export function drawBar(c, { low, high, log, extend, map }, left, top, width, ink) {
  const [from, to] = [left + 22, left + width - 22];
  map.forEach((colour, k) => { c.fillStyle = colour; c.fillRect(from + (k / map.length) * (to - from), top + 2, (to - from) / map.length + 1, 12); });
  for (const [at, way, ends] of [[from, -1, ["min", "both"]], [to, 1, ["max", "both"]]]) {
    if (!ends.includes(extend)) continue;
    c.beginPath();
    c.moveTo(at, top + 2); c.lineTo(at + way * 8, top + 8); c.lineTo(at, top + 14);
    c.closePath();
    c.fillStyle = way < 0 ? map[0] : map.at(-1);
    c.fill();
  }
  Object.assign(c, { fillStyle: ink.ink, font: `11px ${FONT}`, textAlign: "center", textBaseline: "top" });
  const place = scaleOf(low, high, from, to, log);
  for (const value of fewTicks({ limits: [low, high], log }, width < 300 ? 3 : 6)) c.fillText(numberText(value, 6), place(value), top + 18);
}

/** An entry of a legend in the page: its sign, and its text or what stands for it. `drawSigns` draws it. */
export function entry(key, content = key.text) {
  const sign = el("canvas", { class: "vx-sign", "aria-hidden": "true", style: `width:${signWidth(key)}px` });
  sign.key = key;
  return el("li", {}, sign, content);
}

/** The bar of a quantity's colours in the page, and its name. `drawSigns` draws it. */
export function barElements(bar) {
  const canvas = el("canvas", { class: "vx-bar", role: "img", "aria-label": `Colours of ${bar.label} from ${numberText(bar.low)} to ${numberText(bar.high)}` });
  return [el("p", { class: "vx-barname", text: bar.label }), Object.assign(canvas, { bar })];
}

/** Draw the signs and bars of the legends in an element, in the colours of its scheme. */
export function drawSigns(root) {
  const ink = inkOf(root);
  for (const one of root.querySelectorAll(".vx-sign")) drawSign(prepared(one).context, one.key, 0, 0, ink);
  for (const one of root.querySelectorAll(".vx-bar")) { const { context, width } = prepared(one); drawBar(context, one.bar, 0, 0, width, ink); }
}

let readings = null;

/**
 * Have values of the plot that is being drawn read where they are pointed at: `xs`, `ys` in data coordinates; `texts`:
 * what is read there, by default both coordinates; `edges`: [x, y] of cells, of which ys has the rows, or of a bar; `low`:
 * the lower ends of an area.
 */
export const read = (name, xs, ys, more = {}) => { if (xs.length) readings?.push({ name, xs: numbers(xs), ys: numbers(ys), ...more }); };
const numbers = (values) => Array.from(values, (x) => x ?? NaN);

/** The name of a value along an axis: of the nearest tick where the ticks are names, else of a tick at the value; null without one. */
export function nameAt({ ticks: named = [], log }, value) {
  if (!named.length || log || !Number.isFinite(value)) return null;
  const [at, text] = named.reduce((best, tick) => (Math.abs(tick[0] - value) < Math.abs(best[0] - value) ? tick : best));
  return Math.abs(at - value) < 1e-9 || !named.some(([, each]) => /\d/.test(each)) ? text : null;
}

/** A value along an axis as it is read: its label, and its name or the value. */
export function readText(axis, value) {
  const { label = "", said = label, log, limits } = axis, [, words, unit = ""] = /^(.*?)(?: ?\[(.*?)\].*)?$/.exec(said.replaceAll("\n", " "));
  const exact = !log && limits && Math.abs(value) < 1e-9 * (limits[1] - limits[0]) ? 0 : value;
  return [words, nameAt(axis, value) ?? `${numberText(exact, 5)} ${unit}`.trim()].filter(Boolean).join(" ");
}
