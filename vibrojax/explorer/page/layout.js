// The layout of the page.
import { el } from "./dom.js";
import { Pins } from "./compare.js";
import { Figure } from "./figure.js";
import { interactive } from "./interact.js";
import { MapView } from "./map.js";
import { Player } from "./player.js";

const HELP = "Click a cell, or give the map the focus and use the arrow keys (with Shift ten cells, Home and End the first and last). " +
  "Drag a box to zoom; the menu ⋯ of each plot has its files. " +
  "The URL stores your selection: a link restores it.";

const POINTS_HELP = "Click a plot, or move in it with the arrow keys and choose with Enter. ";

const PLOTS_HELP = "Drag a box in a plot to zoom, with Shift to move; a double click resets. The menu ⋯ of each plot has its files.";

/** Number of lines of text below which they stand below the plots, not beside them. */
const FEW_LINES = 7;

/** Lay a page out in its element; the parts that are drawn into are attributes of the page. */
export function layOut(page) {
  const { data, id } = page;
  page.map = el("canvas", { class: "vx-base", "aria-hidden": "true" });
  page.over = el("canvas", {
    class: "vx-over", tabindex: "0", role: "application", "aria-roledescription": "map",
    "aria-label": "Map of the lanes; arrow keys choose a cell", "aria-describedby": `${id}-live`,
  });
  page.caption = el("span");
  page.tip = el("div", { class: "vx-tip", hidden: true });
  page.controls = el("div", { class: "vx-controls" });
  page.legend = el("div", { class: "vx-legend" });
  page.live = el("p", { class: "vx-live", id: `${id}-live`, "aria-live": "polite" });
  page.slices = el("div", { class: "vx-slices" });
  page.side = el("div", { class: "vx-side" });
  page.computing = page.source.attach?.(page) ?? null;
  page.table = el("section", { class: "vx-table", "aria-label": "Numbers of the chosen cell" });
  page.view = new MapView(page.map, page.over, page.grid);
  page.player = new Player(page);
  page.pins = new Pins(page);
  page.figure = data.figure ? new Figure(page, data.figure) : null;
  const tools = interactive(page.map, (paper) => page.view.paint(paper), {
    over: page.over, about: () => (page.view.view ? page.aboutMap() : { title: "map" }), files: [["CSV", "csv", () => page.mapTable()]],
    click: (place) => {
      const cell = page.view.at(...place), inside = page.view.patchAt(place);
      if (inside) page.computing.beside(inside.at);
      else if (cell) page.pick(cell);
    }, zoomed: (zoom) => page.zoomed(zoom),
  });
  page.mapTools = tools;
  const figure = page.figure ? [el("section", { "aria-label": "Plots of the analysis" }, page.figure.element)] : [];
  const first = figure.length && !data.family && !data.variables[0]?.inner && ((data.view ?? []).filter(Boolean).length < 2 || !data.view.every((name) => data.axes.find((axis) => axis.name === name)?.numeric)), mapParts = [page.controls,
    el("div", { class: "vx-map" }, el("div", { class: "vx-caption" }, page.caption, tools.menu), page.map, page.over, page.tip, tools.band), page.legend, page.live, page.slices];
  page.theme = el("button", { type: "button", class: "vx-theme", onclick: () => page.switchScheme() });
  const computing = page.computing ? [page.computing.element] : [];
  const notes = data.notes.length ? [el("p", { class: "vx-notes", text: data.notes.join(". ") })] : [];
  const sheet = el("section", { class: "vx-side vx-sheet", "aria-label": "The chosen cell" });
  const turn = (name, texts) => el("button", { type: "button", text: texts[0], "aria-pressed": "false", onclick: (event) => {
    const on = sheet.classList.toggle(name);
    event.target.setAttribute("aria-pressed", `${on}`);
    event.target.textContent = texts[Number(on)];
    if (on) sheet.classList.remove(name === "vx-tall" ? "vx-closed" : "vx-tall");
    page.redraw();
  } });
  sheet.append(el("div", { class: "vx-sheetbar" }, turn("vx-tall", ["Taller", "Lower"]), turn("vx-closed", ["Hide", "Show"])), ...computing, page.pins.element, page.side);
  page.element.classList.toggle("vx-has-cell", Boolean(data.lanes) && !data.history);
  page.element.classList.add("vibrojax");
  const lines = data.variables.length + data.summary.reduce((n, part) => n + part.lines.length, 0);
  page.element.classList.toggle("vx-alone", data.kind === "plots" && lines < FEW_LINES);
  page.element.classList.toggle("vx-still", !data.lanes && !data.history && data.map !== false);
  page.element.classList.toggle("vx-cells", !data.lanes && data.map === false && !data.axes.some(({ name }) => name === "form"));
  page.element.replaceChildren(
    el("header", { class: "vx-head" }, el("div", {}, el("h1", { text: data.title || data.scene }), ...notes), page.theme),
    el("div", { class: "vx-main" },
      el("section", { class: "vx-left", "aria-label": "Map" }, ...(first ? [...figure, ...mapParts] : [...mapParts, ...figure])),
      sheet,
      page.table),
    el("footer", { class: "vx-foot" }, el("p", { text: [data.scene, data.source].filter(Boolean).join(", ") }),
      el("p", { text: data.map === false ? POINTS_HELP + PLOTS_HELP : data.kind === "plots" || data.history ? PLOTS_HELP : HELP })));
}
