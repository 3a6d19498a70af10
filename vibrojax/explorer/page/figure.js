// Plots that the analysis of a dataset describes: lines, points, areas, cells and texts, linked to the chosen cell.
import { unpack } from "./decode.js";
import { el } from "./dom.js";
import { interactive } from "./interact.js";
import { csvOf } from "./paper.js";
import { FONT, framed, GLYPHS, inkOf, legible, line, mark } from "./plots.js";

/** Draw items of a description; cells need `levels`, their unpacked indices. */
export function drawItems(c, items, sx, sy, ink) {
  for (const item of items) {
    const { x, y } = item, colour = (text) => legible(text, ink);
    if (item.kind === "line") line(c, x, y, sx, sy, colour(item.colour), Math.max(1, item.width), item.dash);
    else if (item.kind === "points") {
      const { colours, sizes } = item;
      x.forEach((value, k) => {
        if (value === null || y[k] === null) return;
        const own = colours[k % colours.length] ?? "#222222", shade = item.hollow ? colour(own) : own, size = Math.max(1.4, sizes[k % sizes.length] ?? 2.5);
        if (item.hollow) mark(c, item.shape, sx(value), sy(y[k]), size, ink.plate, shade);
        else mark(c, item.shape, sx(value), sy(y[k]), size, shade, colour(own) !== own ? ink.faint : size > 2.6 ? ink.plate : null);
      });
    } else if (item.kind === "area") {
      c.globalAlpha = item.alpha;
      c.fillStyle = item.alpha < 1 ? colour(item.colour) : item.colour;
      c.beginPath();
      x.forEach((value, k) => (k ? c.lineTo(sx(value), sy(y[k])) : c.moveTo(sx(value), sy(y[k]))));
      c.closePath();
      c.fill();
      c.globalAlpha = 1;
    } else if (item.kind === "cells" && item.levels) {
      const wide = x.length - 1;
      item.levels.forEach((level, k) => {
        const i = k % wide, j = Math.floor(k / wide), [x0, x1, y0, y1] = [sx(x[i]), sx(x[i + 1]), sy(y[j]), sy(y[j + 1])];
        c.fillStyle = level < 0 ? ink.undefined : item.colours[level];
        c.fillRect(Math.floor(Math.min(x0, x1)), Math.floor(Math.min(y0, y1)), Math.ceil(Math.abs(x1 - x0)) + 0.5, Math.ceil(Math.abs(y1 - y0)) + 0.5);
      });
    } else if (item.kind === "text") {
      const over = items.some((one) => one.kind === "cells");
      c.font = `11px ${FONT}`;
      c.textAlign = item.align;
      c.textBaseline = item.baseline;
      c.fillStyle = over ? item.colour : ink.ink;
      c.fillText(item.text, sx(x[0]), sy(y[0]));
    }
  }
}

/** The columns of what a plot shows, for a file. */
function table(plot) {
  const columns = {}, names = [plot.x.label || "x", plot.y.label || "y"];
  plot.items.filter((item) => item.kind === "line" || item.kind === "points").forEach((item, k) => {
    columns[`${names[0]} ${k}`] = item.x;
    columns[`${names[1]} ${k}`] = item.y;
  });
  return csvOf(columns);
}

/** The value of the chosen cell along a direction of the page, as the plot shows it; undefined without one. */
function chosenAt(page, id) {
  const direction = id && page.direction(id), value = direction?.column.values[page.cell[direction.axis.name]];
  return typeof value === "number" ? value * direction.column.factor : undefined;
}

export class Figure {
  constructor(page, data) {
    this.page = page;
    this.plots = data.plots.map((plot) => this.plot(plot, data.keys));
    const legend = el("ul", { class: "vx-figurekeys" }, ...data.keys.map((key) => el("li", {}, keyMark(key), key.text)));
    const images = data.images.filter((one) => one.data.startsWith("data:image/png;base64,"))
      .map((one) => el("figure", { class: "vx-panel vx-wideplot" }, el("img", { src: one.data, alt: one.title || page.data.title })));
    this.element = el("div", { class: "vx-figure" }, ...(data.keys.length ? [legend] : []), el("div", { class: "vx-plots" }, ...this.plots.map((one) => one.figure), ...images));
  }

  async load() {
    const items = this.page.data.figure.plots.flatMap((plot) => plot.items).filter((item) => item.kind === "cells");
    await Promise.all(items.map(async (item) => { item.levels = await unpack(item.data); }));
  }

  plot(plot, keys) {
    const words = plot.title || [plot.y.label, plot.x.label].filter(Boolean).join(" over ") || "plot";
    const canvas = el("canvas", { role: "img", "aria-label": words });
    const draw = (paper) => this.paint(paper, plot);
    const tools = interactive(canvas, draw, {
      title: () => words, keys: () => keys, files: [["CSV", "csv", () => table(plot)]],
      click: plot.x.direction || plot.y.direction ? (place) => this.pick(canvas, plot, place) : undefined,
    });
    const size = `${plot.wide ? " vx-wideplot" : ""}${plot.low ? " vx-lowplot" : ""}${plot.x.direction ? " vx-linked" : ""}`;
    const figure = el("figure", { class: `vx-panel${size}` }, el("figcaption", {}, el("span", { text: plot.title || words }), tools.menu), canvas, tools.band);
    return { figure, draw: () => draw(canvas) };
  }

  paint(canvas, plot) {
    const { page } = this, ink = inkOf(canvas);
    const axis = (one) => ({ ...one, ticks: one.ticks ?? undefined });
    framed(canvas, ink, axis(plot.x), axis(plot.y), (c, sx, sy, box) => {
      drawItems(c, plot.items, sx, sy, ink);
      const [x, y] = [chosenAt(page, plot.x.direction), chosenAt(page, plot.y.direction)];
      if (canvas.source) return;  // a file shows no cursor
      if (x !== undefined) line(c, [x, x], [sy.inverse(box.bottom), sy.inverse(box.top)], sx, sy, ink.ink, 1.2, [3, 3]);
      if (y !== undefined) line(c, [sx.inverse(box.left), sx.inverse(box.right)], [y, y], sx, sy, ink.ink, 1.2, [3, 3]);
    }, { square: plot.square, grid: !plot.items.some((item) => item.kind === "cells") });
  }

  /** Choose the cell nearest to a place, of those that the plot shows. */
  pick(canvas, plot, [px, py]) {
    const { page } = this, { frame } = canvas, cell = { ...page.cell, ...plot.at };
    if (!frame) return;
    const ways = [["x", px], ["y", py]].map(([name, pixel]) => [page.direction(plot[name].direction), frame[name], pixel]).filter(([way]) => way);
    const byAxis = new Map();
    for (const way of ways) byAxis.set(way[0].axis.name, [...(byAxis.get(way[0].axis.name) ?? []), way]);
    for (const [name, some] of byAxis) {
      let least = Infinity;
      page.grid.axes.get(name).values.forEach((_, k) => {
        const away = Math.hypot(...some.map(([way, scale, pixel]) => scale(way.column.values[k] * way.column.factor) - pixel));
        if (away < least) { least = away; cell[name] = k; }
      });
    }
    page.pick(cell);
  }

  draw() { this.plots.forEach((one) => one.draw()); }
}

/** What stands before an entry of a legend. */
function keyMark({ shape, colour, dash, colours }) {
  if (shape === "line") return el("span", { class: `vx-dash${dash?.length ? " vx-dashed" : ""}`, style: `border-color:${colour}` });
  if (colours) return el("span", { class: "vx-scale", style: `background:linear-gradient(90deg,${colours})` });
  if (shape in GLYPHS && shape !== "circle") return el("span", { class: "vx-glyph", style: `color:${colour}`, text: GLYPHS[shape] });
  return el("span", { class: "vx-swatch", style: `background:${colour};border-radius:${shape === "circle" ? "50%" : "3px"}` });
}
