// Exports: a plot drawn once more on a sheet, as PNG or SVG with its title and legend, and text files.
import { drawBar, drawSign, FONT, inkOf, signWidth } from "./plots.js";

const SCALE = 3;
const escaped = (text) => String(text).replace(/[&<>"]/g, (c) => `&#${c.charCodeAt(0)};`);
const rounded = (x) => Math.round(x * 100) / 100;

/** The part of a canvas context that the plots use, which writes SVG. */
class SvgContext {
  constructor() {
    Object.assign(this, { parts: [], state: { at: [1, 0, 0, 1, 0, 0], clip: "" }, kept: [], path: [], clips: 0 });
    Object.assign(this, { fillStyle: "#000", strokeStyle: "#000", lineWidth: 1, font: "", textAlign: "left", textBaseline: "middle", globalAlpha: 1, dash: [] });
    this.measure = document.createElement("canvas").getContext("2d");
  }
  setTransform() {}
  clearRect() {}
  setLineDash(dash) { this.dash = dash; }
  measureText(text) { this.measure.font = this.font; return this.measure.measureText(text); }
  createPattern() { return {}; }
  save() { this.kept.push({ ...this.state }); }
  restore() { this.state = this.kept.pop(); }
  translate(x, y) { const [a, b, c, d, e, f] = this.state.at; this.state.at = [a, b, c, d, e + a * x + c * y, f + b * x + d * y]; }
  rotate(angle) {
    const [a, b, c, d, e, f] = this.state.at, cos = Math.cos(angle), sin = Math.sin(angle);
    this.state.at = [a * cos + c * sin, b * cos + d * sin, c * cos - a * sin, d * cos - b * sin, e, f];
  }
  beginPath() { this.path = []; }
  moveTo(x, y) { this.path.push(`M${rounded(x)},${rounded(y)}`); }
  lineTo(x, y) { this.path.push(`${this.path.length ? "L" : "M"}${rounded(x)},${rounded(y)}`); }
  closePath() { this.path.push("Z"); }
  rect(x, y, w, h) { this.path.push(`M${rounded(x)},${rounded(y)}h${rounded(w)}v${rounded(h)}h${rounded(-w)}Z`); }
  arc(x, y, r) { this.ellipse(x, y, r, r); }
  ellipse(x, y, rx, ry) {
    const [a, b] = [Math.abs(rx), Math.abs(ry)].map(rounded);
    this.path.push(`M${rounded(x - a)},${rounded(y)}a${a},${b} 0 1 0 ${2 * a},0a${a},${b} 0 1 0 ${-2 * a},0Z`);
  }
  clip() {
    const id = `clip${++this.clips}`;
    this.parts.push(`<clipPath id="${id}"><path transform="matrix(${this.state.at.map(rounded).join()})" d="${this.path.join("")}"/></clipPath>`);
    this.state.clip = ` clip-path="url(#${id})"`;
  }
  paint(style) { return typeof style === "string" ? escaped(style) : "url(#hatch)"; }
  put(element) {
    const moved = this.state.at.join() === "1,0,0,1,0,0" ? "" : ` transform="matrix(${this.state.at.map(rounded).join()})"`;
    this.parts.push(`<g${this.state.clip}${this.globalAlpha < 1 ? ` opacity="${this.globalAlpha}"` : ""}>${element.replace(/^<(\w+)/, `<$1${moved}`)}</g>`);
  }
  fill() { this.put(`<path d="${this.path.join("")}" fill="${this.paint(this.fillStyle)}"/>`); }
  stroke() {
    const dash = this.dash.length ? ` stroke-dasharray="${this.dash.join()}"` : "";
    this.put(`<path d="${this.path.join("")}" fill="none" stroke="${this.paint(this.strokeStyle)}" stroke-width="${this.lineWidth}" stroke-linejoin="round"${dash}/>`);
  }
  fillRect(x, y, w, h) { this.put(`<rect x="${rounded(x)}" y="${rounded(y)}" width="${rounded(w)}" height="${rounded(h)}" fill="${this.paint(this.fillStyle)}" shape-rendering="crispEdges"/>`); }
  strokeRect(x, y, w, h) { this.beginPath(); this.rect(x, y, w, h); this.stroke(); }
  fillText(text, x, y, most) {
    const size = parseFloat(/([\d.]+)px/.exec(this.font)?.[1] ?? 11), anchor = { center: "middle", right: "end" }[this.textAlign] ?? "start";
    const down = { top: 0.8 * size, middle: 0.35 * size }[this.textBaseline] ?? 0, weight = /bold|600/.test(this.font) ? ' font-weight="600"' : "";
    const narrowed = most && this.measureText(text).width > most ? ` textLength="${rounded(most)}" lengthAdjust="spacingAndGlyphs"` : "";
    this.put(`<text x="${rounded(x)}" y="${rounded(y + down)}" font-size="${size}" text-anchor="${anchor}" fill="${this.paint(this.fillStyle)}"${weight}${narrowed}>${escaped(text)}</text>`);
  }
}

/** What a plot draws on when it is exported: of the size and zoom of its canvas, in the colours of the light scheme. */
function paperOf(canvas, context, ratio) {
  const { width, height } = canvas.getBoundingClientRect();
  const paper = { source: canvas, zoom: canvas.zoom, ratio, width: 0, height: 0, getContext: () => context };
  return Object.assign(paper, { getBoundingClientRect: () => ({ width, height }) });
}

/** Rows of legend entries that fit into a width, each with its place from the left. */
function rowsOf(c, keys, width) {
  const rows = [];
  let used = Infinity;
  for (const key of keys) {
    const wide = c.measureText(key.text).width + signWidth(key) + 22;
    if (used + wide > width) { rows.push([]); used = 0; }
    rows.at(-1).push({ ...key, left: used });
    used += wide;
  }
  return rows;
}

/** A text in lines that fit into a width. */
function wrapped(c, text, width) {
  const lines = [""];
  for (const word of text.replaceAll(" = ", "\u00a0=\u00a0").split(" ")) {
    const longer = `${lines.at(-1)} ${word}`.trim();
    if (c.measureText(longer).width <= width) lines[lines.length - 1] = longer; else lines.push(word);
  }
  return lines.filter(Boolean);
}

/**
 * A blob of a plot on a sheet in the light scheme. `draw(paper)` draws the plot; `about`: its title, the notes below it,
 * the entries of its legend (`keys`, see `drawSign`) and the bar of its colours ({label, low, high, log, extend, map});
 * `type`: "png" or "svg".
 */
export async function picture(canvas, draw, { title = "", notes = [], keys = [], bar = null }, type) {
  const root = canvas.closest(".vibrojax"), dark = root.classList.contains("vx-dark");
  root.classList.remove("vx-dark");
  try {
    return sheetOf(canvas, draw, title, notes, keys, bar, type);
  } finally {
    root.classList.toggle("vx-dark", dark);
  }
}

function sheetOf(canvas, draw, title, notes, keys, bar, type) {
  const { width, height } = canvas.getBoundingClientRect(), ink = inkOf(canvas);
  const inner = document.createElement("canvas"), probe = inner.getContext("2d");
  probe.font = `bold 12.5px ${FONT}`;
  const heads = wrapped(probe, title, width - 20), top = 8 + 18 * heads.length;
  probe.font = `11px ${FONT}`;
  const rows = rowsOf(probe, keys, width - 16), lines = notes.filter(Boolean).flatMap((note) => wrapped(probe, note, width - 24));
  const below = top + height + (bar ? 52 : 0), whole = below + 17 * rows.length + 15 * lines.length + 10;
  const around = (c, plot) => {
    c.fillStyle = ink.plate;
    c.fillRect(0, 0, width, whole);
    plot();
    const write = (text, font, x, y, textAlign = "left") => { Object.assign(c, { fillStyle: ink.ink, font: `${font} ${FONT}`, textAlign, textBaseline: "middle" }); c.fillText(text, x, y, width - 20); };
    heads.forEach((head, k) => write(head, "bold 12.5px", 10, 14 + 18 * k));
    if (bar) {
      drawBar(c, bar, 20, top + height, width - 40, ink);
      write(bar.label, "11.5px", width / 2, top + height + 42, "center");
    }
    rows.forEach((row, k) => row.forEach((key) => { drawSign(c, key, 10 + key.left, below + 17 * k + 1, ink); write(key.text, "11px", 10 + key.left + signWidth(key) + 6, below + 17 * k + 8); }));
    lines.forEach((line, k) => write(line, "11px", 12, below + 17 * rows.length + 15 * k + 9));
  };
  if (type === "svg") {
    const c = new SvgContext();
    around(c, () => {
      c.save();
      c.translate(0, top);
      draw(paperOf(canvas, c, 1));
      c.restore();
    });
    const hatch = '<defs><pattern id="hatch" width="6" height="6" patternUnits="userSpaceOnUse"><path d="M0,6L6,0" stroke="#8c8c8c"/></pattern></defs>';
    const text = `<svg xmlns="http://www.w3.org/2000/svg" width="${rounded(width)}" height="${rounded(whole)}" viewBox="0 0 ${rounded(width)} ${rounded(whole)}" font-family="${escaped(FONT)}">${hatch}${c.parts.join("")}</svg>`;
    return new Blob([text], { type: "image/svg+xml" });
  }
  const paper = paperOf(canvas, probe, SCALE), outer = document.createElement("canvas");
  Object.defineProperties(paper, { width: { set: (x) => { inner.width = x; }, get: () => inner.width }, height: { set: (x) => { inner.height = x; }, get: () => inner.height } });
  draw(paper);
  Object.assign(outer, { width: Math.round(width * SCALE), height: Math.round(whole * SCALE) });
  const c = outer.getContext("2d");
  c.scale(SCALE, SCALE);
  around(c, () => c.drawImage(inner, 0, top, width, height));
  return new Promise((done) => outer.toBlob(done, "image/png"));
}

/** Offer a blob, or text, as a file. */
export function download(content, name) {
  const blob = content instanceof Blob ? content : new Blob([content], { type: "text/plain" });
  const link = document.createElement("a");
  Object.assign(link, { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

const field = (value) => (Number.isNaN(value) ? "" : /[",\n]/.test(value) ? `"${String(value).replaceAll('"', '""')}"` : String(value));

/** Columns {name: values} as CSV. */
export function csvOf(columns) {
  const names = Object.keys(columns), count = Math.max(0, ...names.map((name) => columns[name].length));
  const lines = [names.map(field).join(",")];
  for (let k = 0; k < count; k++) lines.push(names.map((name) => field(columns[name][k] ?? "")).join(","));
  return `${lines.join("\n")}\n`;
}

/** A file name from words; numbers keep their signs and points. */
export const fileName = (words, ending) => `${words.toLowerCase().replaceAll("−", "-").replace(/[₀-₉]/g, (digit) => "₀₁₂₃₄₅₆₇₈₉".indexOf(digit)).replace(/[^a-z0-9.=_-]+/g, "-").replace(/^[-.]+|[-.]+$/g, "").slice(0, 120) || "plot"}.${ending}`;
