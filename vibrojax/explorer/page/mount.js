// The page: controls, map, slices and the chosen cell. `mount` is the door of page, server and widget.
import { described, drawCourse, drawHistory, drawMultipliers, drawPlane, drawReturns, drawSpectrum, planesOf, symbolOf } from "./cell.js";
import { unpack } from "./decode.js";
import { Grid } from "./grid.js";
import { drawBar, MapView } from "./map.js";
import { framed, inkOf, limitsOf, line, mark, numberText } from "./plots.js";

const el = (tag, attributes = {}, ...children) => {
  const one = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "text") one.textContent = value;
    else if (name.startsWith("on")) one.addEventListener(name.slice(2), value);
    else if (value === true) one.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) one.setAttribute(name, value);
  }
  one.append(...children);
  return one;
};

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
    this.cell = Object.fromEntries(data.axes.map((axis) => [axis.name, 0]));
    this.shown = { variable: data.variables[0]?.name, x: null, y: null, region: true, borders: "own", returns: null };
    this.asked = 0;
  }

  async begin(state) {
    this.build();
    this.choose();
    this.restore(state);
    if (this.shown.variable) await this.grid.load(this.shown.variable);
    if (this.grid.variables.has("hidden_motion")) await this.grid.load("hidden_motion");
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
    this.onScheme = () => this.redraw();
    this.scheme.addEventListener("change", this.onScheme);
    await this.grid.loadAll();
    await this.pick(this.cell);
  }

  destroy() {
    this.resized?.disconnect();
    this.scheme?.removeEventListener("change", this.onScheme);
    this.element.replaceChildren();
  }

  // What is there.

  build() {
    const { data, id } = this;
    this.map = el("canvas", { class: "vx-base", "aria-hidden": "true" });
    this.over = el("canvas", {
      class: "vx-over", tabindex: "0", role: "application", "aria-roledescription": "map", "aria-label": "Map of the lanes; arrow keys choose a cell",
      "aria-describedby": `${id}-live`,
    });
    this.tip = el("div", { class: "vx-tip", hidden: true });
    this.controls = el("div", { class: "vx-controls" });
    this.legend = el("div", { class: "vx-legend" });
    this.live = el("p", { class: "vx-live", id: `${id}-live`, "aria-live": "polite" });
    this.slices = el("div", { class: "vx-slices" });
    this.side = el("div", { class: "vx-side" });
    this.computing = this.source.attach?.(this) ?? null;
    this.table = el("section", { class: "vx-table", "aria-label": "Numbers of the chosen cell" });
    this.view = new MapView(this.map, this.over, this.grid);
    this.theme = el("button", { type: "button", class: "vx-theme", onclick: () => this.switchScheme() });
    const notes = data.notes.length ? [el("p", { class: "vx-notes", text: data.notes.join(". ") })] : [];
    this.element.classList.add("vibrojax");
    this.element.replaceChildren(
      el("header", { class: "vx-head" }, el("div", {}, el("h1", { text: data.title || data.scene }), ...notes), this.theme),
      el("div", { class: "vx-main" },
        el("section", { class: "vx-left", "aria-label": "Map" }, this.controls,
          el("div", { class: "vx-map" }, this.map, this.over, this.tip), this.legend, this.live, this.slices),
        el("section", { class: "vx-side", "aria-label": "The chosen cell" }, ...(this.computing ? [this.computing.element] : []), this.side),
        this.table),
      el("footer", { class: "vx-foot" }, el("p", { text: `${data.scene}${data.source ? `, ${data.source}` : ""}. ` },),
        el("p", { text: "Click a cell, or give the map the focus and use the arrow keys (with Shift ten cells, Home and End the first and last). What is chosen stands in the address: a link restores it." })));
    this.listen();
    this.nameScheme();
  }

  listen() {
    const place = (event) => { const box = this.over.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
    this.over.addEventListener("pointermove", (event) => this.hover(this.view.at(...place(event)), place(event)));
    this.over.addEventListener("pointerleave", () => this.hover(null));
    this.over.addEventListener("click", (event) => { const cell = this.view.at(...place(event)); if (cell) this.pick(cell); });
    this.over.addEventListener("keydown", (event) => {
      const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1], Home: [-1e9, 0], End: [1e9, 0], PageUp: [0, 1e9], PageDown: [0, -1e9] };
      const way = ways[event.key];
      if (!way || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      const by = event.shiftKey ? 10 : 1;
      this.pick(this.view.moved(way[0] * by, way[1] * by));
    });
  }

  // What is shown.

  get variable() { return this.grid.variables.get(this.shown.variable); }

  get directions() { return this.grid.directions(); }

  direction(id) { return this.directions.find((one) => one.id === id) ?? null; }

  /** The directions of the first view: those the document names, else the two longest. */
  choose() {
    const along = this.directions.filter((one) => this.along(one)), wanted = this.data.view ?? [];
    const longest = [...along].sort((a, b) => b.axis.values.length - a.axis.values.length);
    const x = along.find((one) => one.id === wanted[0]) ?? longest[0] ?? null;
    const others = x ? longest.filter((one) => Grid.together(x, one)) : [];
    const y = this.data.family ? null : others.find((one) => one.id === wanted[1]) ?? others.find((one) => one.axis.values.length > 1) ?? null;
    this.shown.x = x?.id ?? null;
    this.shown.y = y?.id ?? null;
    for (const one of [x, y]) if (one) this.cell[one.axis.name] ||= Math.floor(one.axis.values.length / 2);
  }

  /** Whether the variable that is shown runs along a direction. */
  along(direction) { return this.variable?.axes.includes(direction.axis.name); }

  fillControls() {
    const { grid, shown, id } = this, controls = [];
    const select = (name, label, options, value, change) => {
      const one = el("select", { id: `${id}-${name}`, "data-control": name, onchange: (event) => change(event.target.value) },
        ...options.map(([key, text]) => el("option", { value: key, text, selected: key === value })));
      controls.push(el("label", { for: one.id }, el("span", { text: label }), one));
    };
    select("variable", "Variable", [...grid.variables.values()].map((one) => [one.name, one.name.replaceAll("_", " ")]), shown.variable, (value) => this.show({ variable: value }));
    const along = this.directions.filter((one) => this.along(one)), x = this.direction(shown.x), name = (one) => {
      const { label, symbol } = one.column, whole = symbol === one.column.name || symbol === label ? label : `${label}, ${symbol}`;
      return whole.length < 30 ? whole : label.length < 26 && along.filter((other) => other.column.label === label).length === 1 ? label : symbol;
    };
    if (along.length > 1) {
      select("x", "To the right", along.map((one) => [one.id, name(one)]), shown.x, (value) => this.show({ x: value }));
      const ups = along.filter((one) => Grid.together(x, one));
      if (ups.length && !this.data.family) select("y", "Up", [...ups.map((one) => [one.id, name(one)]), ["", "— (a curve)"]].filter(([key]) => key || x.axis === x.column), shown.y ?? "", (value) => this.show({ y: value }));
    }
    for (const facet of this.facets()) {
      const axis = grid.axes.get(facet);
      const text = (k) => (axis.columns.length || !axis.numeric ? (axis.numeric ? `${k}` : axis.values[k]) : grid.coordinateText(axis, k).replace(/^.*= /, ""));
      if (axis.values.length <= 400)
        select(`at-${facet}`, axis.label.length < 26 ? axis.label : axis.symbol, axis.values.map((_, k) => [`${k}`, text(k)]), `${this.cell[facet]}`, (value) => this.pick({ ...this.cell, [facet]: Number(value) }));
      else {
        const one = el("input", { type: "number", id: `${id}-at-${facet}`, "data-control": `at-${facet}`, min: 0, max: axis.values.length - 1, value: this.cell[facet],
          onchange: (event) => this.pick({ ...this.cell, [facet]: Math.max(0, Math.min(axis.values.length - 1, Math.round(Number(event.target.value) || 0))) }) });
        controls.push(el("label", { for: one.id }, el("span", { text: axis.label }), one));
      }
    }
    const check = (name, label, title) => controls.push(el("label", { class: "vx-check", title }, el("input", { type: "checkbox", "data-control": name, checked: shown[name],
      onchange: (event) => this.show({ [name]: event.target.checked }) }), el("span", { text: label })));
    const ends = this.data.region, over = [shown.x, shown.y];
    if (ends && over.every((one) => one in ends)) check("region", "source's region", "The region that the source recommends: beta 0.25 to 0.6, gamma 0.6 to 0.8");
    if (this.data.curves && over.every((one) => one in this.data.curves.list[0].points)) {
      const own = grid.axes.has("start") ? [["own", "from this start"]] : [];
      select("borders", "Borders of the single impact", [...own, ["any", "from any start"], ["off", "none"]], shown.borders, (value) => this.show({ borders: value }));
    }
    const focus = document.activeElement?.dataset?.control;
    this.controls.replaceChildren(...controls);
    if (focus && focus !== "") this.controls.querySelector(`[data-control="${focus}"]`)?.focus();
  }

  facets() { return !this.variable ? [] : this.grid.facets(this.shown.variable, this.direction(this.shown.x), this.direction(this.shown.y)); }

  /** Show another variable, other directions, or lay something over. */
  async show(changes) {
    Object.assign(this.shown, changes);
    if ("y" in changes) this.shown.y = changes.y || null;
    await this.grid.load(this.shown.variable);
    if (!this.direction(this.shown.x) || !this.along(this.direction(this.shown.x))) { this.shown.x = null; this.shown.y = null; this.choose(); }
    const x = this.direction(this.shown.x), y = this.direction(this.shown.y);
    if (y && (!this.along(y) || !Grid.together(x, y))) this.shown.y = "y" in changes ? null : this.directions.find((one) => this.along(one) && Grid.together(x, one))?.id ?? null;
    if ("x" in changes && !this.shown.y && !("y" in changes) && !this.data.family) this.shown.y = this.directions.find((one) => this.along(one) && Grid.together(x, one))?.id ?? null;
    this.fillControls();
    this.draw();
    this.tell();
  }

  draw(anew = true) {
    if (!this.shown.x) { this.drawWhole(); return; }
    const x = this.direction(this.shown.x), y = this.direction(this.shown.y), { region, borders } = this.shown;
    this.element.querySelector(".vx-map").classList.toggle("vx-low", !y || (!y.column.numeric && y.axis.values.length < 4));
    this.view.draw({ x, y, variable: this.variable, cell: this.cell, region, borders: borders !== "off" && borders }, anew);
    if (anew) this.drawLegend();
    this.drawSlices();
  }

  redraw() {
    this.draw();
    this.current?.draw?.();
  }

  /** In place of a map: a trajectory from its beginning. */
  drawWhole() {
    const { history } = this.data;
    this.element.querySelector(".vx-map").hidden = true;
    this.controls.hidden = this.live.hidden = true;
    if (!history || !this.history) return;
    const units = [...new Set(history.columns.map((one) => one.units))];
    if (!this.slices.childElementCount)
      this.slices.replaceChildren(...units.map((unit) => el("figure", { class: "vx-whole" }, el("figcaption", { text: history.columns.filter((one) => one.units === unit).map((one) => one.long_name).join(", ") }), el("canvas", { role: "img", "aria-label": "The whole course over time" }))));
    units.forEach((unit, k) => drawCourse(this.slices.children[k].querySelector("canvas"), this.history, history.columns.filter((one) => one.units === unit), k === units.length - 1));
  }

  /** The cells of the plane that is shown. */
  *plane() {
    const x = this.direction(this.shown.x), y = this.direction(this.shown.y), names = [...new Set([x, y].filter(Boolean).map((one) => one.axis.name))];
    const walk = function* (cell, left) {
      if (!left.length) { yield cell; return; }
      for (let k = 0; k < this.grid.axes.get(left[0]).values.length; k++) yield* walk.call(this, { ...cell, [left[0]]: k }, left.slice(1));
    };
    yield* walk.call(this, this.cell, names);
  }

  drawLegend() {
    const { variable, grid } = this;
    if (variable.flags) {
      const counts = new Map();
      let total = 0;
      for (const cell of this.plane()) { const value = String(grid.value(variable.name, cell)); counts.set(value, (counts.get(value) ?? 0) + 1); total++; }
      const percent = (n) => (n === total ? "100 %" : n / total < 0.01 ? "<1 %" : n / total > 0.99 ? ">99 %" : `${Math.round((100 * n) / total)} %`);
      const items = Object.keys(variable.flags).filter((flag) => counts.has(flag)).sort((a, b) => a - b).map((flag) =>
        el("li", {}, el("span", { class: "vx-swatch", style: `background:${variable.colours[flag]}` }), `${variable.flags[flag]} `, el("small", { text: percent(counts.get(flag)) })));
      this.legend.replaceChildren(el("ul", {}, ...items, ...this.overLegend()));
    } else if (this.shown.y) {
      const bar = el("canvas", { class: "vx-bar", role: "img", "aria-label": `Colours of ${variable.label} from ${numberText(variable.low)} to ${numberText(variable.high)}` });
      this.legend.replaceChildren(el("p", { class: "vx-barname", text: variable.label.replace("\n", " ") }), bar, el("ul", {}, ...this.overLegend()));
      drawBar(bar, grid, variable);
    } else this.legend.replaceChildren(el("ul", {}, ...this.overLegend()));
  }

  overLegend() {
    const found = [], { curves, family } = this.data;
    if (curves && this.shown.borders !== "off" && this.view.view.y)
      for (const kind of [...new Set(curves.list.filter((one) => this.view.onPlane(one)).map((one) => one.kind))])
        found.push(el("li", {}, el("span", { class: "vx-dash", style: `border-color:${curves.colours[kind]}` }), kind));
    if (family) {
      found.push(el("li", {}, el("span", { class: "vx-dash", style: `border-color:${family.runs[0]?.colour}` }), "stable"), el("li", {}, el("span", { class: "vx-dash vx-dashed", style: `border-color:${family.runs[0]?.colour}` }), "not stable"));
      for (const kind of [...new Set(family.special.map((one) => one.kind))]) found.push(el("li", {}, el("span", { class: "vx-swatch vx-round", style: `background:${family.kinds[kind]}` }), kind));
    }
    if (this.variable.name === "regime" && this.grid.variables.has("hidden_motion") && [...this.plane()].some((cell) => this.grid.value("hidden_motion", cell) === 1)) found.push(el("li", {}, el("span", { class: "vx-dot" }), "another start: same label, other motion"));
    return found;
  }

  drawSlices() {
    const x = this.direction(this.shown.x), y = this.direction(this.shown.y), { variable, grid } = this;
    const wanted = y && x.column === x.axis ? [x, y] : [];
    if (this.slices.childElementCount !== wanted.length)
      this.slices.replaceChildren(...wanted.map((_, k) => el("figure", {}, el("figcaption"), el("canvas", { class: "vx-slice", role: "img", "data-slice": k }))));
    wanted.forEach((direction, k) => {
      const figure = this.slices.children[k], canvas = figure.querySelector("canvas"), column = direction.column, other = wanted[1 - k];
      const at = grid.coordinateText(other.column, this.cell[other.axis.name]);
      figure.querySelector("figcaption").textContent = `${variable.name.replaceAll("_", " ")} at ${at}`;
      canvas.setAttribute("aria-label", `${variable.label} along ${column.label} at ${at}`);
      const xs = column.numeric ? column.values.map((v) => v * column.factor) : column.values.map((_, i) => i);
      const cells = xs.map((_, i) => ({ ...this.cell, [direction.axis.name]: i })), values = cells.map((cell) => grid.value(variable.name, cell));
      const known = variable.flags ? [...new Set(values)].sort((a, b) => a - b) : [];
      const ys = variable.flags ? values.map((v) => known.indexOf(v)) : values.map((v) => v * variable.factor), ink = inkOf(canvas);
      const up = variable.flags ? { limits: [-0.6, known.length - 0.4], label: "", ticks: known.map((flag, i) => [i, variable.flags[flag] ?? `${flag}`]) } : { limits: limitsOf([ys]), label: variable.units };
      const named = column.numeric ? undefined : column.values.map((text, i) => [i, text]);
      const frame = framed(canvas, ink, { limits: limitsOf([xs], 0.02), label: column.symbol, log: column.log, ticks: named }, up, (c, sx, sy, box) => {
        if (!variable.flags) line(c, xs, ys, sx, sy, ink.faint, 1.2);
        xs.forEach((value, i) => { if (Number.isFinite(ys[i])) mark(c, "circle", sx(value), sy(ys[i]), 2.6, grid.colour(variable, values[i], ink.undefined), ink.faint); });
        const here = sx(xs[this.cell[direction.axis.name]]);
        c.strokeStyle = ink.ink;
        c.setLineDash([3, 3]);
        c.beginPath(); c.moveTo(here, box.top); c.lineTo(here, box.bottom); c.stroke();
        c.setLineDash([]);
      });
      canvas.onclick = (event) => {
        if (!frame) return;
        const px = event.clientX - canvas.getBoundingClientRect().left;
        let best = 0;
        xs.forEach((value, i) => { if (Math.abs(frame.x(value) - px) < Math.abs(frame.x(xs[best]) - px)) best = i; });
        this.pick(cells[best]);
      };
    });
  }

  hover(cell, place) {
    this.view.drawOver(cell);
    this.tip.hidden = !cell;
    if (!cell) return;
    const value = this.grid.valueText(this.variable, this.grid.value(this.variable.name, cell));
    this.tip.replaceChildren(el("b", { text: value }), el("span", { text: this.grid.cellText(cell) }));
    const box = this.over.getBoundingClientRect(), wide = this.tip.offsetWidth;
    this.tip.style.left = `${Math.max(0, Math.min(place[0] + 14, box.width - wide - 4))}px`;
    this.tip.style.top = `${place[1] > box.height / 2 ? place[1] - this.tip.offsetHeight - 12 : place[1] + 16}px`;
  }

  // The chosen cell.

  async pick(cell) {
    const before = this.cell, anew = !this.current || this.facets().some((axis) => before[axis] !== cell[axis]);
    this.cell = { ...cell };
    // What is said of attractors is said of that which the lane ends in, unless they run along the map.
    const own = this.grid.value("lane_attractor", this.cell);
    if (own >= 0 && "attractor" in this.cell && ![this.shown.x, this.shown.y].includes("attractor")) this.cell.attractor = own;
    this.point = null;
    const number = ++this.asked, lane = this.grid.lane(this.cell);
    for (const facet of this.facets()) { const one = this.controls.querySelector(`[data-control="at-${facet}"]`); if (one) one.value = `${this.cell[facet]}`; }
    this.draw(anew);
    this.tell();
    this.say();
    this.onPick?.({ cell: this.cell, lane, values: this.coordinates() });
    this.computing?.stand(this.coordinates());
    let motion = null;
    try { motion = this.source.cell && lane >= 0 ? await this.source.cell(lane) : await this.computing?.here() ?? null; } catch (error) { motion = { kind: "none", note: String(error.message ?? error) }; }
    if (number === this.asked) this.showMotion(motion);
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
    return found;
  }

  say() {
    if (!this.shown.x) return;
    const main = this.variable, text = `${this.grid.cellText(this.cell)}: ${main.name.replaceAll("_", " ")} ${this.grid.valueText(main, this.grid.value(main.name, this.cell))}`;
    this.live.textContent = text;
  }

  showMotion(motion) {
    const { grid } = this, panels = [], draws = [];
    const regime = grid.variables.get("regime"), value = this.point ? motion?.numbers?.regime : regime && grid.value("regime", this.cell);
    const ofLane = this.point ? Boolean(regime) : regime?.axes.every((axis) => !this.data.lanes || this.data.lanes.axes.includes(axis) || (axis === "attractor" && ![this.shown.x, this.shown.y].includes(axis)));
    const badge = ofLane && value !== undefined ? [el("span", { class: "vx-badge" }, el("span", { class: "vx-swatch", style: `background:${grid.colour(regime, value)}` }), grid.valueText(regime, value))] : [];
    const head = el("div", { class: "vx-cellhead" }, el("h2", { text: this.point?.title || grid.cellText(this.cell) || "The motion" }), ...badge,
      motion ? el("p", { class: "vx-motion", text: described(motion) + (motion.kind !== "none" && motion.note && motion.returns ? ` (${motion.note})` : "") }) : el("p", { class: "vx-motion", text: this.data.without ?? "no motion is kept of this dataset" }));
    const panel = (title, draw, about, extra = "", ...more) => {
      const canvas = el("canvas", { role: "img", "aria-label": `${title}: ${about}` });
      panels.push(el("figure", { class: `vx-panel ${extra}` }, el("figcaption", {}, el("span", { text: title }), ...more), canvas));
      draws.push(() => draw(canvas));
    };
    if (motion && motion.kind !== "none") {
      const about = described(motion), planes = planesOf(motion.columns), inPlanes = new Set(planes.flat().map((one) => one.name));
      const mass = (one) => one.long_name.replace(/^.*(position|displacement) of (the )?/, "").replace(/ (relative|\().*/, "");
      planes.forEach((plane, k) => panel(`Phase plane, ${mass(plane[0])}`, (canvas) => drawPlane(canvas, motion, plane, k), about, planes.length === 1 ? "vx-wide vx-tall" : planes.length === 2 ? "vx-half" : ""));
      const units = [...new Set(motion.columns.map((one) => one.units))];
      units.forEach((unit, k) => { const some = motion.columns.filter((one) => one.units === unit);
        panel(k ? "" : motion.kind === "orbit" ? "Two cycles" : "Time history", (canvas) => drawHistory(canvas, motion, some, k === units.length - 1), `${some.map((one) => one.long_name).join(", ")} over time; ${about}`, "vx-wide"); });
      const positions = planes.map(([position]) => position);
      if (positions.length) panel("Spectrum", (canvas) => drawSpectrum(canvas, motion, positions), `amplitudes of ${positions.map((one) => one.long_name).join(", ")} over frequency`);
      const names = Object.keys(motion.section);
      if (names.length && motion.section[names[0]].length) {
        if (!names.includes(this.shown.returns)) this.shown.returns = names.at(-1);
        const choice = el("select", { "aria-label": "State at the returns", "data-control": "returns", onchange: (event) => { this.shown.returns = event.target.value; this.current.draw(); } },
          ...names.map((name) => el("option", { value: name, text: symbolOf(name), selected: name === this.shown.returns })));
        const unitsOf = (name) => motion.columns.find((one) => one.name === name)?.units ?? "m";
        panel("Returns", (canvas) => drawReturns(canvas, motion, this.shown.returns, unitsOf(this.shown.returns)), `${motion.section[names[0]].length} returns to the section`, "", choice);
      }
      if (motion.multipliers?.length) panel("Multipliers", (canvas) => drawMultipliers(canvas, motion), motion.multipliers.map(([modulus, argument]) => `modulus ${numberText(modulus)}, argument ${numberText(argument)} rad`).join("; "));
    }
    const keys = motion && motion.kind !== "none" ? [this.eventKeys(motion)] : [];
    this.side.replaceChildren(head, ...keys, el("div", { class: "vx-panels" }, ...panels), this.commands());
    this.table.replaceChildren(this.numbers(motion));
    this.current = { motion, draw: () => draws.forEach((draw) => draw()) };
    this.current.draw();
    this.element.dataset.ready = String(this.asked);
  }

  eventKeys(motion) {
    const kinds = { 1: ["stick", "vx-k-stick"], 2: ["slip", "vx-k-slip"], 3: ["impact", "vx-k-impact"] };
    const there = Object.entries(kinds).filter(([kind]) => motion.flags.some((flag) => (flag & 7) === Number(kind)));
    const masses = [["x1", "bit", "vx-k-bit"], ["x2", "striker", "vx-k-striker"], ["x3", "bit on rock", "vx-k-rock"], ["x4", "hole", "vx-k-hole"]].filter(([name]) => name in motion.states);
    return el("ul", { class: "vx-keys" }, ...masses.map(([, text, style]) => el("li", {}, el("span", { class: `vx-line ${style}` }), text)),
      ...there.map(([, [text, style]]) => el("li", {}, el("span", { class: `vx-mark ${style}` }), text)));
  }

  numbers(motion) {
    const { grid } = this, rows = [];
    for (const variable of grid.variables.values()) {
      const value = motion?.numbers && variable.name in motion.numbers ? motion.numbers[variable.name] ?? NaN : this.point ? undefined : grid.value(variable.name, this.cell);
      if (value === undefined) continue;
      rows.push(el("tr", {}, el("th", { scope: "row", text: variable.long_name }), el("td", { "data-name": variable.name, "data-value": value, text: grid.valueText(variable, value, 5) })));
    }
    const wasClosed = this.table.querySelector("details")?.open === false;
    return el("details", { class: "vx-numbers", open: !wasClosed }, el("summary", { text: "Numbers" }), el("table", {}, el("tbody", {}, ...rows)));
  }

  /** The command line and the Python call of the cell. */
  calls() {
    const { run, scene } = this.data, own = this.coordinates(), states = run?.states ?? [];
    const given = { ...run.parameters };
    for (const [name, value] of Object.entries(own)) if ((run.names ?? []).includes(name) || name === "rock") given[name] = value;
    if ("rpm" in own) { given.rpm = own.rpm; if ("bit_radius" in own) given.bit_radius = own.bit_radius; }
    let start = own.start ?? run.start ?? null;
    if (this.point) {
      for (const name of Object.keys(given)) if ((run.names ?? []).includes(name) || ["rock", "rpm", "bit_radius"].includes(name)) delete given[name];
      Object.assign(given, this.point.parameters);
      start = this.point.start;
    }
    const vector = states.map((name) => own[`start_${name}`]);
    if (!this.point && states.length && vector.every((x) => typeof x === "number")) start = `[${vector.join(", ")}]`;
    const text = (value) => (typeof value === "number" ? String(Number(value.toPrecision(10))) : value);
    const shell = (word) => (/^[\w=.,:+-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);
    const words = Object.entries(given).map(([name, value]) => `${name}=${text(value)}`);
    const options = Object.entries(run.options);
    words.push(...options.map(([name, value]) => `${name}=${value}`));
    if (start !== null && typeof start === "string") words.push(`start=${start.replaceAll(" ", "")}`);
    words.push(`duration=${run.duration}`);
    const literal = (value) => (typeof value === "number" ? text(value) : value.startsWith("[") ? value : JSON.stringify(value));
    const args = [...Object.entries(given), ...options, ...(typeof start === "string" ? [["start", start]] : []), ["duration", run.duration]];
    return {
      command: ["vibrojax", "simulate", scene, ...words].map(shell).join(" "),
      python: `vj.simulate(${JSON.stringify(scene)}, ${args.map(([name, value]) => `${name}=${literal(value)}`).join(", ")})`,
    };
  }

  commands() {
    if (!this.data.run || this.data.run.own_scene) return el("p", { class: "vx-motion", text: this.data.run?.own_scene ? "The scene is one of your own: pass its object to vj.simulate." : "" });
    const { command, python } = this.calls();
    const one = (label, text) => {
      const button = el("button", { type: "button", class: "vx-copy", text: "copy", "aria-label": `Copy the ${label}`, onclick: async () => {
        try { await navigator.clipboard.writeText(text); } catch { const area = el("textarea"); area.value = text; this.side.append(area); area.select(); document.execCommand("copy"); area.remove(); button.focus(); }
        button.textContent = "copied";
        setTimeout(() => { button.textContent = "copy"; }, 1500);
      } });
      return el("div", { class: "vx-call" }, el("span", { text: label }), el("code", { text }), button);
    };
    return el("div", { class: "vx-calls" }, one("command line", command), one("Python call", python));
  }

  // The fragment, and the scheme.

  get state() {
    const { shown, data } = this, parts = [["variable", shown.variable]];
    if (shown.x) parts.push(["x", shown.x]);
    if (shown.x) parts.push(["y", shown.y ?? ""]);
    for (const axis of data.axes) if (axis.values.length > 1) parts.push([`at.${axis.name}`, axis.numeric && !axis.columns.length ? Number(axis.values[this.cell[axis.name]].toPrecision(8)) : this.cell[axis.name]]);
    if (!shown.region) parts.push(["region", "off"]);
    if (data.curves) parts.push(["borders", shown.borders]);
    const scheme = this.element.dataset.scheme;
    if (scheme) parts.push(["scheme", scheme]);
    return parts.map(([name, value]) => `${name}=${encodeURIComponent(value)}`).join("&");
  }

  restore(state) {
    const given = new URLSearchParams(state.replace(/^#/, ""));
    if (this.grid.variables.has(given.get("variable"))) { this.shown.variable = given.get("variable"); this.choose(); }
    if (given.has("x") && this.direction(given.get("x")) && this.along(this.direction(given.get("x")))) {
      this.shown.x = given.get("x");
      const y = this.direction(given.get("y"));
      this.shown.y = y && this.along(y) && Grid.together(this.direction(this.shown.x), y) ? y.id : null;
    }
    for (const axis of this.data.axes) {
      const text = given.get(`at.${axis.name}`), value = Number(text);
      if (text === null || text === "" || !Number.isFinite(value)) continue;
      if (axis.numeric && !axis.columns.length) {
        let best = 0;
        axis.values.forEach((one, k) => { if (Math.abs(one - value) < Math.abs(axis.values[best] - value)) best = k; });
        this.cell[axis.name] = best;
      } else this.cell[axis.name] = Math.max(0, Math.min(axis.values.length - 1, Math.round(value)));
    }
    this.shown.region = given.get("region") !== "off";
    if (["own", "any", "off"].includes(given.get("borders"))) this.shown.borders = given.get("borders");
    if (this.shown.borders === "own" && !this.grid.axes.has("start")) this.shown.borders = "any";
    if (["dark", "light"].includes(given.get("scheme"))) this.element.dataset.scheme = given.get("scheme");
    this.nameScheme();
  }

  tell() { this.onState?.(this.state); }

  get dark() {
    return this.element.dataset.scheme ? this.element.dataset.scheme === "dark" : window.matchMedia("(prefers-color-scheme: dark)").matches;
  }

  nameScheme() { this.theme.textContent = this.dark ? "Light" : "Dark"; this.theme.setAttribute("aria-label", `Switch to the ${this.dark ? "light" : "dark"} scheme`); }

  switchScheme() {
    this.element.dataset.scheme = this.dark ? "light" : "dark";
    this.nameScheme();
    this.redraw();
    this.tell();
  }
}
