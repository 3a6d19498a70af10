// The page: what is chosen, shown and drawn in it, and who hears of it. `mount` is the door of page, server and widget.
import { callsOf } from "./calls.js";
import { fillChosen, numbersOf } from "./chosen.js";
import { controlsOf } from "./controls.js";
import { unpack } from "./decode.js";
import { write } from "./dom.js";
import { fragmentOf, readFragment } from "./fragment.js";
import { Grid } from "./grid.js";
import { layOut } from "./layout.js";
import { csvOf } from "./paper.js";
import { barOf, drawLegend, keysOf, plane } from "./legend.js";
import { listen } from "./pointing.js";
import { drawSigns, limitsOf } from "./plots.js";
import { drawSlices, drawWhole } from "./slices.js";

let instances = 0;

/**
 * Show a dataset in `element`.
 *
 * data: the document that `vibrojax.explorer.document_of` makes. source: {cell(lane) -> Promise<Cell|null>}, and where
 * it computes, motion(parameters, start) -> Promise<Cell>. state: a fragment, as `onState` gives it.
 * onPick({cell, lane, values}) hears of every chosen cell: `values` are its coordinates by name.
 * Returns {pick(cell), show(cell), state, grid, element, destroy()}.
 */
export async function mount(element, { data, source = {}, state = "", onPick = null, onState = null }) {
  const page = new Page(element, data, source, onPick, onState);
  await page.begin(state);
  return page;
}

class Page {
  constructor(element, data, source, onPick, onState) {
    Object.assign(this, { element, data, source, onPick, onState, grid: new Grid(data), id: `vx${++instances}` });
    this.cell = Object.fromEntries(data.axes.map((axis) => [axis.name, data.first?.[axis.name] ?? 0]));
    this.shown = { variable: data.variables[0]?.name, x: null, y: null, region: true, borders: "own", only: "", returns: null };
    this.asked = 0;
    this.plots = [];
    this.zooms = {};
  }

  async begin(state) {
    layOut(this);
    listen(this);
    this.nameScheme();
    this.choose();
    this.restore(state);
    if (this.shown.variable) await this.grid.load(this.shown.variable);
    for (const name of ["hidden_motion", "regime"]) if (this.grid.variables.has(name)) await this.grid.load(name);
    await this.figure?.load();
    if (this.data.history) {
      this.history = { time: await unpack(this.data.history.time), observed: this.data.history.observed_from };
      for (const one of this.data.history.columns) this.history[one.name] = await unpack(one.data);
    }
    this.fillControls();
    this.draw();
    performance.mark("vibrojax-first-map");
    this.resized = new ResizeObserver(() => this.redraw());
    this.resized.observe(this.element);
    this.scheme = window.matchMedia("(prefers-color-scheme: dark)");
    this.onScheme = () => { this.nameScheme(); this.redraw(); };
    this.scheme.addEventListener("change", this.onScheme);
    await this.grid.loadAll();
    await this.pick(this.cell);
    await this.pins.restore(readFragment(this.data, state).pins);
    if (this.map.zoom) this.zoomed(this.map.zoom);
  }

  destroy() {
    this.resized?.disconnect();
    this.player.destroy();
    this.scheme?.removeEventListener("change", this.onScheme);
    this.element.replaceChildren();
  }

  // What is shown.

  get variable() { return this.grid.variables.get(this.shown.variable); }

  get directions() { return this.grid.directions(); }

  direction(id) { return this.directions.find((one) => one.id === id) ?? null; }

  /** The directions of the first view: those the document names, else the two longest. */
  choose() {
    if (this.data.map === false) return;  // its plots stand in place of the map
    const along = this.directions.filter((one) => this.along(one)), wanted = this.data.view ?? [];
    const longest = [...along].sort((a, b) => b.axis.values.length - a.axis.values.length);
    const x = along.find((one) => one.id === wanted[0]) ?? longest[0] ?? null;
    const others = x ? longest.filter((one) => Grid.together(x, one)) : [];
    const up = others.find((one) => one.id === wanted[1]) ?? others.find((one) => one.axis.values.length > 1);
    const y = this.data.family || this.variable?.inner ? null : up ?? null;  // several values of a cell make a diagram
    this.shown.x = x?.id ?? null;
    this.shown.y = wanted[1] === "" ? null : y?.id ?? null;
    for (const one of [x, y]) if (one) this.cell[one.axis.name] ||= this.data.first?.[one.axis.name] ?? Math.floor(one.axis.values.length / 2);
  }

  /** Whether the variable that is shown runs along a direction. */
  along(direction) { return this.variable?.axes.includes(direction.axis.name); }

  fillControls() {
    const focus = document.activeElement?.dataset?.control;
    this.controls.replaceChildren(...controlsOf(this));
    if (focus && focus !== "") this.controls.querySelector(`[data-control="${focus}"]`)?.focus();
  }

  /** The axes that the map does not run along. */
  facets() {
    return !this.variable ? [] : this.grid.facets(this.shown.variable, this.direction(this.shown.x), this.direction(this.shown.y));
  }

  /** The first direction that makes a map with x. */
  firstUp(x) { return this.variable?.inner ? null : this.directions.find((one) => this.along(one) && Grid.together(x, one))?.id ?? null; }

  /** Show another variable, other directions, or lay something over. */
  async show(changes) {
    const ways = [this.shown.x, this.shown.y];
    Object.assign(this.shown, changes);
    if ("y" in changes) this.shown.y = changes.y || null;
    await this.grid.load(this.shown.variable);
    const before = this.direction(this.shown.x);
    if (!before || !this.along(before)) {
      Object.assign(this.shown, { x: null, y: null });
      this.choose();
    }
    const x = this.direction(this.shown.x), y = this.direction(this.shown.y);
    if (y && (this.variable.inner || !this.along(y) || !Grid.together(x, y))) this.shown.y = "y" in changes ? null : this.firstUp(x);
    if ("x" in changes && !this.shown.y && !("y" in changes) && !this.data.family) this.shown.y = this.firstUp(x);
    if (ways[0] !== this.shown.x || ways[1] !== this.shown.y) this.mapTools.set(null, true);
    this.fillControls();
    this.draw();
    this.say();
    if (!this.data.lanes && this.current) this.showMotion(this.current.motion);
    this.tell();
  }

  draw(anew = true) {
    if (!this.shown.x) { this.drawWhole(); return; }
    const x = this.direction(this.shown.x), y = this.direction(this.shown.y), { region, borders } = this.shown;
    this.element.querySelector(".vx-map").classList.toggle("vx-low", !y || (!y.column.numeric && (y.axis.values.length < 4 || !x.column.numeric)) || x.axis.values.length < 6);
    const patch = this.patch?.at === this.facetKey() ? this.patch : null;
    if (anew) this.limit();
    this.view.draw({ x, y, variable: this.variable, cell: this.cell, region, patch, only: this.among, borders: borders !== "off" && borders }, anew);
    if (anew) drawLegend(this);
    write(this.caption, this.mapTitle());
    this.figure?.draw();
    drawSlices(this);
    drawSigns(this.element);
  }

  /** The forms of a law have coefficients of different sizes: the colours span those of the form that is shown. */
  limit() {
    const { variable, grid } = this;
    if (variable.flags || !variable.axes.includes("form")) return;
    const values = [...plane(this)].map((cell) => grid.value(variable.name, cell) * variable.factor).filter(Number.isFinite);
    if (values.length) [variable.low, variable.high] = limitsOf([values], 0);
    variable.log &&= variable.low > 0;
  }

  redraw() {
    this.draw();
    this.current?.draw?.();
    // On a phone the sheet leaves the first plot free, where that leaves enough of the sheet.
    const plot = [...this.element.querySelectorAll(".vx-left :is(.vx-map, .vx-panel)")].find((one) => one.offsetHeight), { innerHeight, scrollY } = window;
    const room = plot ? innerHeight - (plot.getBoundingClientRect().bottom + scrollY) - 6 : Infinity;
    this.element.style.setProperty("--sheet", `${Math.min(0.44 * innerHeight, Math.max(room, 0.28 * innerHeight))}px`);
  }

  /** In place of a map: a trajectory from its beginning. */
  drawWhole() {
    this.element.querySelector(".vx-map").hidden = true;
    this.controls.hidden = !this.controls.childElementCount;
    this.live.hidden = true;
    this.figure?.draw();
    if (this.history) drawWhole(this);
    drawSigns(this.element);
  }

  /** Whether a cell is among those that the map is limited to; null where it shows all. */
  get among() {
    const { only } = this.shown, { grid } = this;
    if (!only) return null;
    const stable = only.startsWith("stable"), flag = only.replace(/stable ?/, "");
    return (cell) => (!flag || grid.value("regime", cell) === Number(flag)) && (!stable || grid.value("stable", cell) === 1);
  }

  // The chosen cell.

  async pick(cell) {
    const before = this.cell;
    this.match(before, { ...cell });
    const anew = !this.current || this.facets().some((axis) => before[axis] !== this.cell[axis]);
    this.point = null;
    const number = ++this.asked, lane = this.apart === "attractor" ? -1 : this.grid.lane(this.cell);
    for (const facet of this.facets()) {
      const one = this.controls.querySelector(`[data-control="at-${facet}"]`);
      if (one) one.value = `${this.cell[facet]}`;
    }
    this.draw(anew);
    this.tell(Boolean(this.current));
    this.say();
    this.onPick?.({ cell: this.cell, lane, values: this.coordinates() });
    this.computing?.stand(this.coordinates());
    let motion = null;
    try {
      if (this.apart === "attractor") motion = { kind: "none", note: `no start here ends in attractor ${this.cell.attractor}` };
      else motion = this.source.cell && lane >= 0 ? await this.source.cell(lane) : await this.computing?.here() ?? null;
    } catch (error) {
      motion = { kind: "none", note: String(error.message ?? error) };
    }
    if (number !== this.asked) return;
    if (motion?.point) this.computing?.place(motion.point.parameters, motion.point.start);
    this.showMotion(motion);
  }

  /**
   * Choose a cell whose start ends in its attractor. An attractor chooses a start where it was chosen itself, or where
   * it is shown and the start was not chosen; else the start chooses its attractor. `apart` names what was chosen where
   * they do not belong together: an "attractor" in which no start ends, a "start" that ends in none.
   */
  match(before, cell) {
    const { grid } = this, own = grid.value("lane_attractor", cell);
    this.cell = cell;
    this.apart = "";
    if (own === undefined || !("attractor" in cell) || own === cell.attractor) return;
    const sameStart = grid.startAxes.every((name) => cell[name] === before[name]);
    const byAttractor = cell.attractor !== before.attractor || (sameStart && this.variable.axes.includes("attractor"));
    const matched = byAttractor ? grid.startOf(cell) : own >= 0 ? { ...cell, attractor: own } : null;
    if (matched) this.cell = matched;
    else this.apart = byAttractor ? "attractor" : "start";
  }

  /** The axes that the chosen lane, and its attractor, are named by; without lanes those of the variable that is shown. */
  get named() {
    const { data, grid } = this, left = { attractor: grid.startAxes, start: ["attractor"] }[this.apart] ?? [];
    const axes = data.lanes ? [...data.lanes.axes, "attractor"] : data.map === false ? data.axes.map((axis) => axis.name).filter((name) => name !== "form") : this.variable?.axes ?? [];
    return axes.filter((name) => !left.includes(name));
  }

  /** Show what was computed at a point beside the chosen cell: {title, parameters (not the defaults), start}. */
  showPoint(point, motion) {
    this.point = point;
    this.showMotion(motion);
  }

  /** The chosen cell's coordinates by name. */
  coordinates() {
    const found = { ...this.data.fixed };
    for (const axis of this.data.axes) {
      if (axis.columns.length) for (const column of axis.columns) found[column.name] = column.values[this.cell[axis.name]];
      if (!axis.columns.length || !axis.numeric) found[axis.name] = axis.values[this.cell[axis.name]];
    }
    for (const name of this.data.run?.states ?? []) if (this.grid.variables.has(`start_${name}`)) found[`start_${name}`] = this.grid.value(`start_${name}`, this.cell);
    return found;
  }

  /** What is chosen, in words, for who does not see the map. */
  say() {
    if (!this.shown.x) return;
    const { variable, grid } = this, value = grid.valueText(variable, grid.value(variable.name, this.cell)), name = variable.name.replaceAll("_", " ");
    const names = this.view.namesAt(null, this.cell), here = names.length ? `; here curves meet: ${names.join(", ")}` : "";
    write(this.live, `${grid.cellText(this.cell, variable.axes, undefined, true)}: ${name.endsWith(value.split(" ")[0]) ? "" : `${name} `}${value}${here}`);
  }

  showMotion(motion) {
    this.current = { motion, draw: () => {} };
    this.current.draw = fillChosen(this, motion);
    this.current.draw();
    this.element.dataset.ready = String(this.asked);
  }

  // The numbers of what is shown, and its command line and Python call.
  numbers(motion, pins = this.pinned(motion)) { return numbersOf(this, motion, pins); }
  calls() { return this.apart === "attractor" && !this.point ? null : callsOf(this.data, this.coordinates(), this.point); }

  // The fragment, and the scheme.

  get state() {
    const { shown, cell } = this;
    return fragmentOf(this.data, { shown, cell, scheme: this.element.dataset.scheme, pins: this.pins.state, zoom: this.map.zoom, zooms: this.plots.map(({ canvas }) => canvas.zoom) });
  }

  restore(state) {
    const said = readFragment(this.data, state), { shown } = this;
    if (this.grid.variables.has(said.variable)) {
      shown.variable = said.variable;
      this.choose();
    }
    const x = this.direction(said.x), y = this.direction(said.y);
    if (this.shown.x && x && this.along(x)) {
      shown.x = x.id;
      shown.y = y && !this.variable.inner && this.along(y) && Grid.together(x, y) ? y.id : null;
    }
    Object.assign(this.cell, said.cell);
    shown.region = said.region;
    shown.only = this.grid.variables.has("regime") || said.only === "stable" ? said.only : "";
    if (said.borders) shown.borders = said.borders;
    if (shown.borders === "own" && !this.grid.axes.has("start")) shown.borders = "any";
    if (said.scheme) this.element.dataset.scheme = said.scheme;
    this.mapTools.set(said.zoom, true);
    this.zooms = said.zooms;
    this.plots.forEach(({ tools }, k) => tools.set(this.zooms[k] ?? null, true));
    this.nameScheme();
  }

  /** Keep the zoom of a plot in the fragment. */
  keepZoom(canvas, tools) { tools.set(this.zooms[this.plots.push({ canvas, tools }) - 1] ?? null, true); }

  /** What the drawing of the machine needs to know of the chosen cell: the drive's speed and the gap. */
  machineOf() {
    const { machine = {} } = this.data, own = { ...machine, ...this.coordinates(), ...this.point?.parameters };
    if (typeof own.rpm === "number") own.v = ((2 * Math.PI) / 60) * own.rpm * (own.bit_radius ?? machine.bit_radius ?? 0);
    return { v: own.v ?? 0, delta: own.delta ?? 0, strikes: this.data.scene !== "rotary" };
  }

  /** The pinned motions that are drawn with another. */
  pinned(motion) { return this.pins.list.filter((pin) => pin.motion !== motion); }

  /** The chosen cell, or the point beside it, in words. */
  titleOf() { return this.point?.title || this.grid.cellText(this.cell, this.named, undefined, true) || (this.data.lanes ? "The motion" : ""); }

  /** The place of a map along the axes that it does not run along. */
  facetKey() { return JSON.stringify([this.shown.x, this.shown.y, ...Object.keys(this.cell).sort().filter((name) => ![this.shown.x, this.shown.y].includes(name)).map((name) => this.cell[name])]); }

  /** A source that computes gives the part of the map that is zoomed into, once the zoom has rested. */
  zoomed(zoom) {
    if (!this.view.view) return;  // before the first drawing
    this.view.drawOver();
    drawLegend(this);
    drawSigns(this.legend);
    this.tell();
    clearTimeout(this.resting);
    if (this.computing) this.resting = setTimeout(() => this.computing.box(zoom), 400);
  }

  /** The axes of what is shown that the map does not run along. */
  get besideMap() { return this.facets().filter((name) => this.variable?.axes.includes(name)); }

  /** What the map shows, in words. */
  mapTitle() {
    const { variable, grid } = this;
    return variable ? [variable.name.replaceAll("_", " "), grid.cellText(this.cell, this.besideMap)].filter(Boolean).join(", ") : "map";
  }

  /** What a file of a plot says besides the plot: what it is of, and a name that tells variables and cells apart. */
  about(title, more = {}) {
    const { point, grid, cell, named } = this;
    return { title, notes: [this.withCommon(point?.title || grid.cellText(cell, named))], name: [title, point?.title ?? grid.nameText(cell, named)].filter(Boolean).join("_"), ...more };
  }

  /** A text, and the values that all share. */
  withCommon(text) { return [text, this.data.common].filter(Boolean).join(", "); }

  /** The values that are the same over a plot along some axes. */
  notesAt(along) { return [this.withCommon(this.grid.cellText(this.cell, this.named.filter((name) => !along.includes(name))))]; }

  aboutMap() {
    const { variable, grid, cell, besideMap } = this, only = this.element.querySelector("[data-control='only']")?.selectedOptions[0].text;
    const notes = [this.withCommon(grid.cellText(cell, besideMap)), this.among ? `shown: ${only}` : ""];
    return { title: variable.label.replace("\n", " ").replace(/ \[.*/, ""), notes, name: [variable.name, grid.nameText(cell, besideMap), this.among ? only : ""].filter(Boolean).join("_"), keys: keysOf(this), bar: barOf(this) };
  }

  /** The map, or the curve, that is shown, as a table. */
  mapTable() {
    const { grid, variable } = this, [x, y] = [this.direction(this.shown.x), this.direction(this.shown.y)];
    const names = [...new Set([x, y].filter(Boolean).map((one) => one.axis.name)), ...(variable.inner ? [variable.inner] : [])];
    const cells = names.reduce((some, name) => some.flatMap((cell) => grid.axes.get(name).values.map((_, k) => ({ ...cell, [name]: k }))), [{ ...this.cell }]);
    return csvOf(this.tableOf(this.among ? cells.filter(this.among) : cells));
  }

  /** Cells as columns: every coordinate and the variable that is shown, in the units of the plots. */
  tableOf(cells) {
    const { grid, variable, data } = this, columns = { }, along = new Set([...(data.lanes?.axes ?? []), ...variable.axes]);
    const head = ({ name, units }) => (units ? `${name} [${units}]` : name), short = (value, digits) => (value === null || Number.isNaN(value) ? "" : Number(value.toPrecision(digits)));
    for (const axis of [...grid.axes.values()].filter(({ name }) => along.has(name)))
      for (const column of (axis.columns.length ? axis.columns : [axis]).filter((one) => !one.silent))
        columns[head(column)] = cells.map((cell) => { const value = column.values[cell[axis.name] ?? 0]; return column.numeric ? short(value * column.factor, 10) : value; });
    for (const [name, value] of Object.entries(data.fixed)) columns[name] = cells.map(() => value);
    columns[head(variable)] = cells.map((cell) => { const value = grid.value(variable.name, cell); return variable.flags ? variable.flags[value] ?? value : short(value * variable.factor, 7); });
    return columns;
  }

  /** Say what is chosen to who keeps it; `picked`: whether the user chose another cell. */
  tell(picked = false) { this.onState?.(this.state, picked); }

  get dark() {
    return this.element.dataset.scheme ? this.element.dataset.scheme === "dark" : window.matchMedia("(prefers-color-scheme: dark)").matches;
  }

  nameScheme() {
    this.element.classList.toggle("vx-dark", this.dark);
    this.theme.textContent = this.dark ? "Light" : "Dark";
    this.theme.setAttribute("aria-label", `Switch to the ${this.dark ? "light" : "dark"} scheme`);
  }

  switchScheme() {
    this.element.dataset.scheme = this.dark ? "light" : "dark";
    this.nameScheme();
    this.redraw();
    this.tell();
  }
}
