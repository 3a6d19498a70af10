// Plots that the analysis of a dataset describes: lines, points, areas, cells and texts, linked to the chosen cell.
import { unpack } from "./decode.js";
import { el, explained } from "./dom.js";
import { placesOf } from "./grid.js";
import { interactive, readingAt } from "./interact.js";
import { barElements, entry, fillCell, FONT, framed, inkOf, isPale, leastOf, legible, levelLine, line, mark, numberText, read, uprightLine } from "./plots.js";

/** The colour of signs in a legend that stand for marks of any colour. */
const INK = "#222222";

/** Pixels of a point, in which sizes of marks are. */
const POINT = 4 / 3;

/** The level of cells at a place. */
function levelAt({ x, y, levels }, u, v) {
  const [i, j] = [[x, u], [y, v]].map(([ends, at]) => ends.findIndex((end, k) => (end - at) * ((ends[k + 1] ?? NaN) - at) <= 0));
  return i < 0 || j < 0 ? -1 : levels[j * (x.length - 1) + i];
}

/** Draw items of a description, and have their values read by the last key that looks the same; cells need `levels`, their unpacked indices. */
export function drawItems(c, items, sx, sy, ink, keys = []) {
  const alike = (colour, ...shapes) => keys.findLast((key) => key.colour === colour && (shapes.includes(key.shape) || (!shapes.length && colour !== INK)));
  const nameOf = (item, colour, ...shapes) => item.label || ((alike(colour, ...shapes) ?? alike(colour))?.text ?? "");
  const labels = new Set(keys.filter(({ shape }) => shape !== "patch").map((key) => key.colour));
  for (const item of items) {
    const { x, y } = item, colour = (text) => legible(text, ink);
    if (item.kind === "line") {
      line(c, x, y, sx, sy, colour(item.colour), Math.max(1, item.width), item.dash);
      read(nameOf(item, item.colour, "line"), x, y, { joined: true });
    } else if (item.kind === "points") {
      const { colours, sizes, values } = item, faint = colours.some((own) => colour(own) !== own);
      x.forEach((value, k) => {
        if (value === null || y[k] === null) return;
        const own = colours[k % colours.length] ?? "#222222", shade = colours.length === 1 || labels.has(own) ? colour(own) : own, size = POINT * Math.max(1.2, sizes[k % sizes.length] ?? 2);
        if (item.hollow) mark(c, item.shape, sx(value), sy(y[k]), size, item.hollow === "none" ? "transparent" : ink.plate, colour(own));
        else mark(c, item.shape, sx(value), sy(y[k]), size, shade, colour(shade) !== shade || (size > 2.6 && faint && shade === own) ? ink.faint : size > 2.6 ? ink.plate : null);
      });
      if (colours.length === 1) read(nameOf(item, colours[0], item.shape, "line"), x, y);
      else read("", x, y, { texts: colours.map((own, k) => (values.length ? numberText(values[k]) : nameOf(item, own, item.shape, "line"))) });
    } else if (item.kind === "area") {
      c.globalAlpha = item.alpha;
      c.fillStyle = item.colour === "hatched" ? ink.undefined : item.alpha < 0.5 ? colour(item.colour) : isPale(item.colour) ? ink.pale : item.colour;
      c.beginPath();
      x.forEach((value, k) => (k ? c.lineTo(sx(value), sy(y[k])) : c.moveTo(sx(value), sy(y[k]))));
      c.closePath();
      c.fill();
      if (item.alpha === 1) { Object.assign(c, { strokeStyle: item.at && (isPale(item.colour) || colour(item.colour) !== item.colour) ? ink.faint : c.fillStyle, lineWidth: 0.6 }); c.stroke(); }  // else hairlines part neighbours
      c.globalAlpha = 1;
      const name = nameOf(item, item.colour, "patch"), half = x.length / 2, top = y.slice(half).reverse();
      if (item.at) read(name, [item.at[0]], [item.at[1]], { edges: [[x[0], x[1]], [y[0], y[2]]], ...(item.at[1] === y[2] ? { low: [y[0]] } : {}) });
      else if (name) read(name, x.slice(0, half), top, { low: y.slice(0, half), texts: top.map((high, k) => numberText(high - y[k])) });
    } else if (item.kind === "cells" && item.levels) {
      const wide = x.length - 1, across = [], up = [];
      const shades = item.colours.length === 1 ? item.colours.map((own) => (isPale(own) ? ink.pale : own)) : item.colours;
      item.levels.forEach((level, k) => {
        const i = k % wide, j = Math.floor(k / wide);
        c.fillStyle = level < 0 ? ink.undefined : shades[level];
        if (level >= 0 || item.hatched) fillCell(c, sx(x[i]), sx(x[i + 1]), sy(y[j]), sy(y[j + 1]));
        across.push((x[i] + x[i + 1]) / 2);
        up.push((y[j] + y[j + 1]) / 2);
      });
      read("", across, up, { edges: [x, y], texts: item.values.map((value) => item.names[String(value)] ?? (value === null ? "no value" : numberText(value))) });
    } else if (item.kind === "text") {
      const over = items.some((one) => one.kind === "cells"), left = { left: 0, center: 0.5, right: 1 }[item.align], top = { top: 0, middle: 0.5, bottom: 1 }[item.baseline];
      Object.assign(c, { font: `11px ${FONT}`, textAlign: item.align, textBaseline: item.baseline, fillStyle: ink.plate, globalAlpha: 0.8 });
      const wide = c.measureText(item.text).width + 4;
      if (!over) c.fillRect(sx(x[0]) - left * wide, sy(y[0]) - 14 * top, wide, 14);  // on hatches and lines it would not be read
      const pale = items.some((one) => one.kind === "cells" && one.colours.length === 1 && isPale(one.colours[0]) && !one.hatched && levelAt(one, x[0], y[0]) === 0);
      Object.assign(c, { fillStyle: over && !pale ? item.colour : ink.ink, globalAlpha: 1 });
      c.fillText(item.text, sx(x[0]), sy(y[0]));
    }
  }
}

/** The place of the chosen cell along a direction of the page; undefined without one. */
function chosenAt(page, id) {
  const direction = id && page.direction(id);
  return direction ? placesOf(direction.column)[page.cell[direction.axis.name]] : undefined;
}

/** The entries of a legend for what a plot shows. */
function keysIn({ items }, keys) {
  const shows = { line: ["line", "points"], patch: ["area", "cells"] };
  return keys.filter((key) => items.some((item) => {
    const own = item.colours ?? [item.colour], drawn = (shows[key.shape] ?? ["points"]).includes(item.kind);
    return item.label === key.text || (drawn && (own.includes(key.colour) || (key.colour === INK && item.shape === key.shape)));
  }));
}

export class Figure {
  constructor(page, data) {
    this.page = page;
    const shared = data.bars.filter((_, k) => data.plots.filter(({ bar }) => bar === k).length > 1);
    this.plots = data.plots.map((plot) => this.plot(plot, data, shared));
    const legend = el("ul", { class: "vx-figurekeys" }, ...data.keys.map((key) => entry(key, explained(el("span", { text: key.text }), page.data.meanings?.[key.text.split(" ")[0]]))));
    const images = data.images.filter((one) => one.data.startsWith("data:image/png;base64,"))
      .map((one) => el("figure", { class: "vx-panel vx-wideplot" }, el("img", { src: one.data, alt: one.title || page.data.title })));
    const tracks = this.plots.filter(({ track }) => track), together = tracks.length ? [el("div", { class: "vx-tracks" }, ...tracks.map((one) => one.figure))] : [];
    this.element = el("div", { class: "vx-figure" }, ...shared.flatMap(barElements), ...(data.keys.length ? [legend] : []),
      el("div", { class: "vx-plots" }, ...this.plots.filter(({ track }) => !track).map((one) => one.figure), ...together, ...images), ...(data.note ? [el("p", { class: "vx-notes", text: data.note })] : []));
  }

  async load() {
    const items = this.page.data.figure.plots.flatMap((plot) => plot.items).filter((item) => item.kind === "cells");
    await Promise.all(items.map(async (item) => { item.levels = await unpack(item.data); }));
  }

  plot(plot, { keys, bars }, shared) {
    const bar = bars[plot.bar];
    const short = plot.x.label.split(", ").at(-1), words = plot.title || [plot.y.label, short].filter(Boolean).join(" over ").replace(/ \[[^\]]*\]/g, "") || "plot";
    const canvas = el("canvas", { role: "img", "aria-label": words });
    const draw = (paper) => this.paint(paper, plot), linked = plot.x.direction || plot.y.direction || Object.keys(plot.at).length || this.page.data.map === false;
    const tools = interactive(canvas, draw, {
      about: () => this.page.about(words, { keys: keysIn(plot, keys), bar, name: words, notes: [this.page.data.title, this.page.data.common, this.page.data.figure.note] }),
      click: linked ? (place) => this.pick(canvas, plot, place) : undefined,
      zoomed: () => this.page.tell(),
    });
    this.page.keepZoom(canvas, tools);
    const size = `${plot.wide ? " vx-wideplot" : ""}${plot.low ? " vx-lowplot" : ""}${linked ? " vx-linked" : ""}`;
    const figure = el("figure", { class: `vx-panel${size}` }, el("figcaption", {}, el("span", { text: plot.title || words }), tools.menu), canvas, ...(bar && !shared.includes(bar) ? barElements(bar) : []), tools.band);
    // Of panels at other values than those of the controls, the page shows none.
    const names = Object.keys(plot.at), here = () => !this.page.shown.x && names.length > 0 && names.every((name) => plot.at[name] === this.page.cell[name]);
    const hides = () => this.page.facets().some((name) => name in plot.at && plot.at[name] !== this.page.cell[name]);
    return { figure, track: plot.track, draw: () => { figure.hidden = this.page.shown.x && hides(); if (!figure.hidden) draw(canvas); figure.classList.toggle("vx-here", here()); } };
  }

  paint(canvas, plot) {
    const { page } = this, ink = inkOf(canvas), figure = canvas.closest?.("figure");
    const axis = (one) => ({ ...one, ticks: one.ticks ?? undefined });
    framed(canvas, ink, axis(plot.x), { ...axis(plot.y), bare: plot.bare && !canvas.source && figure.offsetLeft > figure.parentNode.firstChild.offsetLeft }, (c, sx, sy, box) => {
      const bars = plot.items.some(({ at }) => at), here = !canvas.source && Object.entries(plot.at).every(([name, k]) => page.cell[name] === k);  // no cursor in a file
      const [x, y] = here ? [chosenAt(page, plot.x.direction), chosenAt(page, plot.y.direction)] : [];
      const cursor = () => {
        if (x !== undefined) uprightLine(c, sx(x), box, ink.ink, 1.2, [3, 3]);
        if (y !== undefined) levelLine(c, sy(y), box, ink.ink, 1.2, [3, 3]);
      };
      if (bars) cursor();  // below bars and their numbers
      drawItems(c, plot.items, sx, sy, ink, page.data.figure.keys);
      const lists = here ? this.lists(canvas) : [], dot = lists[page.cell.start ?? 0] ?? lists[0];
      const [u, v] = dot ? [dot.xs[page.cell.point], dot.ys[page.cell.point]] : [x, y];
      if (u !== undefined && v !== undefined) { mark(c, "o", sx(u), sy(v), 7, "transparent", ink.plate); mark(c, "o", sx(u), sy(v), 6, "transparent", ink.ink); } else if (!bars) cursor();
    }, { square: plot.square, grid: !plot.items.some((item) => item.kind === "cells") });
  }

  /** What a plot shows of each point of a list: one series, or one for each start. */
  lists(canvas) {
    const { axes } = this.page.grid, found = canvas.readings.filter(({ xs }) => xs.length === axes.get("point")?.values.length);
    return [1, axes.get("start")?.values.length].includes(found.length) ? found : [];
  }

  /** Choose the cell nearest to a place, of those that the plot shows. */
  pick(canvas, plot, [px, py]) {
    const { page } = this, { frame } = canvas, cell = { ...page.cell, ...plot.at }, lists = this.lists(canvas);
    if (!frame) return;
    const dot = readingAt({ frame, readings: lists }, [px, py]);
    if (dot) { page.pick({ ...cell, point: dot.k, ...(lists.length > 1 ? { start: lists.indexOf(dot.series) } : {}) }); return; }
    const squares = {};  // of the distances, by axis: both columns of a list are along one
    for (const [name, pixel] of [["x", px], ["y", py]]) {
      const way = page.direction(plot[name].direction);
      if (way) placesOf(way.column).forEach((value, k) => { const all = (squares[way.axis.name] ??= []); all[k] = (all[k] ?? 0) + (frame[name](value) - pixel) ** 2; });
    }
    if (!Object.keys({ ...squares, ...plot.at }).length) return;
    for (const [name, all] of Object.entries(squares)) cell[name] = Math.max(0, leastOf(all));
    page.pick(cell);
  }

  draw() { this.plots.forEach((one) => one.draw()); }
}
