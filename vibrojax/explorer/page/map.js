// The map: cells over two axes, dots over two columns of a list, or a curve along one axis; and what lies over it.
import { drawItems } from "./figure.js";
import { edgesOf, labelOf, placesOf, ticksOf } from "./grid.js";
import { fillCell, framed, inkOf, distance, leastOf, legible, levelLine, limitsAndTicks, limitsOf, line, mark, markColour, nearestOn, prepared, uprightLine } from "./plots.js";

export const DASHES = {
  fold: [], "period-doubling": [], torus: [8, 2], grazing: [6, 2, 2, 2], stick: [], section: [2, 2], hopf: [9, 2, 2, 2], end: [1, 2],
  basin: [5, 4], "not-settled": [2, 2],
};

/** The map's view: draws, says which cell is at a place, and where a cell is. */
export class MapView {
  constructor(canvas, overlay, grid) {
    this.canvas = canvas;
    this.overlay = overlay;
    this.grid = grid;
    this.frame = null;
  }

  /** Draw a view; where only the chosen cell differs from what is there, no more than what lies over the map. */
  draw(view, anew = true) {
    this.view = view;
    if (anew) this.paint(this.canvas);
    this.drawOver();
  }

  /** Draw the map on its canvas, or on the paper of an export. */
  paint(canvas) {
    const { x, y, variable } = this.view, ink = inkOf(canvas);
    let frame = null;
    if (!x) prepared(canvas);
    else if (!y) frame = this.drawCurve(canvas, x, variable, ink);
    else if (this.hasCells) frame = this.drawCells(canvas, x, y, variable, ink);
    else frame = this.drawDots(canvas, x, y, variable, ink);
    if (canvas === this.canvas) Object.assign(this, { frame, ink });
  }

  /** Whether the view has cells, not dots or a curve. */
  get hasCells() { return this.view.y && this.view.x.column === this.view.x.axis; }

  /** The cell with other indices along some axes. */
  cellAt(changes) {
    return { ...this.view.cell, ...changes };
  }

  /** The colour of a cell; one that the map is not limited to has that of the grid. */
  colourAt(variable, cell, ink, colour = (grid, variable, value) => grid.colour(variable, value, ink)) {
    return this.view.only && !this.view.only(cell) ? ink.grid : colour(this.grid, variable, this.grid.value(variable.name, cell), ink);
  }

  axisOf(direction) {
    const { edges, values } = edgesOf(direction.column);
    const low = Math.min(edges[0], edges.at(-1)), high = Math.max(edges[0], edges.at(-1));
    return { limits: [low, high], label: labelOf(direction.column), log: direction.column.log, edges, values, ticks: ticksOf(direction.column) };
  }

  drawCells(canvas, x, y, variable, ink) {
    const across = this.axisOf(x), up = this.axisOf(y), grid = this.grid;
    const hidden = variable.name === "regime" && grid.variables.get("hidden_motion");
    return framed(canvas, ink, across, up, (c, sx, sy) => {
      for (let i = 0; i < across.values.length; i++) {
        const [x0, x1] = [sx(across.edges[i]), sx(across.edges[i + 1])];
        for (let j = 0; j < up.values.length; j++) {
          const cell = this.cellAt({ [x.axis.name]: i, [y.axis.name]: j });
          const [y0, y1] = [sy(up.edges[j]), sy(up.edges[j + 1])];
          c.fillStyle = this.colourAt(variable, cell, ink);
          fillCell(c, x0, x1, y0, y1);
          if (hidden && grid.value("hidden_motion", cell) === 1 && Math.abs(x1 - x0) > 4)
            mark(c, "o", (x0 + x1) / 2, (y0 + y1) / 2, Math.min(1.8, Math.abs(x1 - x0) / 5), "#222222", "#FFFFFF");
        }
      }
      this.drawPatch(c, sx, sy, x, y, variable, ink);
      this.drawRegion(c, sx, sy, x, y);
      this.drawCurves(c, sx, sy, x, y);
    }, { grid: false });
  }

  /** The part of the map that was computed anew, over the cells of the dataset. */
  drawPatch(c, sx, sy, x, y, variable, ink) {
    const { patch } = this.view, values = patch?.variables.get(variable.name);
    if (!values) return;
    const [first, second] = Object.keys(patch.axes), count = patch.axes[second].length;
    const ends = (way) => edgesOf({ ...way.column, values: patch.axes[way.axis.name], log: false }).edges;
    const [across, up] = [ends(x), ends(y)];
    patch.axes[x.axis.name].forEach((_, i) => patch.axes[y.axis.name].forEach((_, j) => {
      const [p, q] = x.axis.name === first ? [i, j] : [j, i];
      c.fillStyle = this.grid.colour(variable, values[p * count + q], ink);
      fillCell(c, sx(across[i]), sx(across[i + 1]), sy(up[j]), sy(up[j + 1]));
    }));
  }

  /** Where a place is in the part that was computed anew: its coordinates by axis, and the variable's value. */
  patchAt([px, py]) {
    const { frame, view } = this, { patch, x, y, variable } = view, values = patch?.variables.get(variable.name);
    if (!frame || !values) return null;
    const at = {}, index = {};
    for (const [way, value] of [[x, frame.x.inverse(px) / x.column.factor], [y, frame.y.inverse(py) / y.column.factor]]) {
      const all = patch.axes[way.axis.name], step = (all.at(-1) - all[0]) / (all.length - 1), k = Math.round((value - all[0]) / step);
      if (!(k >= 0 && k < all.length)) return null;
      index[way.axis.name] = k;
      at[way.axis.name] = all[k];
    }
    const [first, second] = Object.keys(patch.axes);
    return { at, value: values[index[first] * patch.axes[second].length + index[second]] };
  }

  /** The border of the source's best region; it is open where the map cuts the region. */
  drawRegion(c, sx, sy, x, y) {
    const ends = this.grid.data.region;
    if (!this.view.region || !ends || !(x.axis.name in ends) || !(y.axis.name in ends)) return;
    const [[left, right], [low, high]] = [[x, sx], [y, sy]].map(([way, scale]) => ends[way.axis.name].map((v) => scale(v * way.column.factor)));
    for (const [strokeStyle, lineWidth] of [["#FFFFFF", 3.5], ["#222222", 1.5]])
      Object.assign(c, { strokeStyle, lineWidth }).strokeRect(left, high, right - left, low - high);
  }

  drawCurves(c, sx, sy, x, y) {
    const { curves } = this.grid.data;
    for (const curve of this.curves) {
      const xs = curve.points[x.axis.name].map((v) => v * x.column.factor), ys = curve.points[y.axis.name].map((v) => v * y.column.factor);
      line(c, xs, ys, sx, sy, "#FFFFFF", 3.6);
      line(c, xs, ys, sx, sy, curves.colours[curve.kind] ?? "#222222", 1.8, DASHES[curve.kind] ?? []);
    }
    for (const corner of this.corners) {
      const place = [x, y].map((way) => corner.point[way.axis.name] * way.column.factor);
      mark(c, "s", sx(place[0]), sy(place[1]), 3.2, "#FFFFFF", "#222222");
    }
  }

  /** Those of a list of curves, or of their corners, that are on the map. */
  onMap(list, pointsOf) {
    const { x, y, borders } = this.view;
    return borders && y && x.column === x.axis ? (list ?? []).filter((one) => [x, y].every((way) => way.axis.name in pointsOf(one)) && this.onPlane(one)) : [];
  }

  get curves() { return this.onMap(this.grid.data.curves?.list, (one) => one.points); }

  /** The points of codimension two. */
  get corners() { return this.onMap(this.grid.data.curves?.corners, (one) => one.point); }

  /** The kind of the border within some pixels of a place, empty where there is none. */
  borderAt(place) {
    const { frame, view: { x, y } } = this, curves = place && frame ? this.curves : [];
    const near = curves.find(({ points }) => {
      const [us, vs] = [[x, frame.x], [y, frame.y]].map(([way, scale]) => points[way.axis.name].map((v) => scale(v * way.column.factor)));
      return us.some((u, k) => k && distance(place, nearestOn(place, [us[k - 1], vs[k - 1]], [u, vs[k]])) < 6);
    });
    return near?.kind ?? "";
  }

  /** The names of the points of codimension two within some pixels of a place, or within a cell. */
  namesAt(place, cell) {
    const { frame, view: { x, y } } = this;
    const near = !frame ? [] : this.corners.filter(({ point }) => {
      const [u, v] = [x, y].map((way) => point[way.axis.name] * way.column.factor);
      if (place) return distance(place, [frame.x(u), frame.y(v)]) < 9;
      return [[x, u], [y, v]].every(([way, value]) => {
        const { edges } = edgesOf(way.column), k = cell[way.axis.name];
        return (value - edges[k]) * (value - edges[k + 1]) <= 0;
      });
    });
    return [...new Set(near.map((one) => one.kind))];
  }

  /** Whether a cell is on the part of the map that is zoomed into. */
  shown() {
    const { canvas: { zoom }, view } = this, inside = [[view.x, zoom?.[0]], [view.y, zoom?.[1]]].map(([way, limits]) => {
      if (!way || !limits) return null;
      const { values, edges } = edgesOf(way.column), ends = (k) => (way.column === way.axis ? [edges[k], edges[k + 1]] : [values[k], values[k]]);
      return new Set(values.flatMap((_, k) => (Math.max(...ends(k)) >= limits[0] && Math.min(...ends(k)) <= limits[1] ? [k] : [])));
    });
    return (cell) => [view.x, view.y].every((way, n) => !inside[n] || inside[n].has(cell[way.axis.name]));
  }

  /** Whether a curve is of the plane and the start that are shown. */
  onPlane(curve) {
    const { cell } = this.view, any = this.view.borders === "any";
    return Object.entries(curve.at).every(([name, value]) => {
      const axis = this.grid.axes.get(name);
      if (name === "start") return any || !axis ? value === "any" : axis.values[cell.start ?? 0] === value;
      if (!axis) return true;
      const here = axis.values[cell[name] ?? 0];
      return axis.numeric ? Math.abs(here - value) <= 1e-4 * Math.abs(value) : here === value;
    });
  }

  drawDots(canvas, x, y, variable, ink) {
    const xs = placesOf(x.column), ys = placesOf(y.column);
    this.dots = { xs, ys, axis: x.axis.name };
    const size = Math.max(2.2, Math.min(6, 260 / Math.sqrt(xs.length + 1)));
    const of = (direction, values) => ({ limits: limitsOf([values], 0.04), label: labelOf(direction.column) });
    return framed(canvas, ink, of(x, xs), of(y, ys), (c, sx, sy) => {
      xs.forEach((value, k) => {
        const cell = this.cellAt({ [x.axis.name]: k });
        mark(c, "o", sx(value), sy(ys[k]), size, this.colourAt(variable, cell, ink, markColour), ink.faint);
      });
    });
  }

  /** A variable along one axis; over a family its branches, solid where stable. */
  drawCurve(canvas, x, variable, ink) {
    const column = x.column, grid = this.grid, family = grid.data.family, flags = variable.flags;
    if (variable.inner) return this.drawReturns(canvas, x, variable, ink);
    const xs = placesOf(column), ys = xs.map((_, k) => {
      const cell = this.cellAt({ [x.axis.name]: k });
      return this.view.only && !this.view.only(cell) ? NaN : grid.value(variable.name, cell) * (flags ? 1 : variable.factor);
    });
    const known = flags ? Object.keys(flags).map(Number).filter((flag) => ys.includes(flag)).sort((a, b) => a - b) : [];
    const rows = flags ? ys.map((value) => known.indexOf(value)) : ys;
    const up = flags
      ? { limits: [-0.5, known.length - 0.5], label: "", ticks: known.map((flag, k) => [k, flags[flag]]) }
      : { ...limitsAndTicks(ys), label: variable.label.replace("\n", " ") };
    this.dots = { xs, ys: rows, axis: x.axis.name };
    const across = { limits: limitsOf([xs], 0.03), label: labelOf(column), log: column.log, ticks: ticksOf(column) };
    return framed(canvas, ink, across, up, (c, sx, sy) => {
      for (const { points, stable, colour } of family?.runs ?? []) {
        const shade = legible(colour, ink), [first] = points;
        line(c, points.map((k) => xs[k]), points.map((k) => rows[k]), sx, sy, shade, stable === 1 ? 2.4 : 1.4, stable === 1 ? [] : [5, 4]);
        if (points.length === 1) mark(c, "o", sx(xs[first]), sy(rows[first]), 1.6, shade);
      }
      if (!family && !flags && column.numeric) line(c, xs, rows, sx, sy, ink.bit, 1.4);
      const size = Math.max(1.8, Math.min(4.5, 700 / xs.length));
      if (!family) xs.forEach((value, k) => {
        const colour = flags ? markColour(grid, variable, ys[k], ink) : ink.bit;
        if (Number.isFinite(rows[k]) && rows[k] >= (flags ? 0 : -Infinity)) mark(c, "o", sx(value), sy(rows[k]), size, colour, flags ? ink.faint : null);
      });
      for (const one of family?.special ?? []) mark(c, one.shape, sx(xs[one.point]), sy(rows[one.point]), 4.5, legible(family.kinds[one.kind], ink), ink.plate);
    }, { empty: !ys.some(Number.isFinite) });
  }

  /** The orbits that were followed, over a diagram of returns. */
  get over() {
    const { overlay } = this.grid.data, { x, variable } = this.view;
    return overlay?.variable === variable.name && overlay.along === x.axis.name ? overlay.items : [];
  }

  /** Every stored return over an axis, in the colour of its lane's regime; families lie over them. */
  drawReturns(canvas, x, variable, ink) {
    const { column, axis } = x, grid = this.grid, count = grid.axes.get(variable.inner).values.length, regime = grid.variables.get("regime"), places = placesOf(column);
    const xs = [], ys = [], index = [];
    axis.values.forEach((_, k) => {
      for (let r = 0; r < count; r++) {
        const value = grid.value(variable.name, this.cellAt({ [axis.name]: k, [variable.inner]: r }));
        if (!Number.isFinite(value)) continue;
        xs.push(places[k]);
        ys.push(value * variable.factor);
        index.push(k);
      }
    });
    this.dots = { xs, ys, index, axis: axis.name };
    const over = this.over, heights = over.flatMap((item) => item.y ?? []).filter((y) => y !== null);
    const across = { limits: limitsOf([places], 0.03), label: labelOf(column), log: column.log, ticks: ticksOf(column) };
    const colours = axis.values.map((_, k) => (regime ? markColour(grid, regime, grid.value("regime", this.cellAt({ [axis.name]: k })), ink) : ink.bit));
    return framed(canvas, ink, across, { ...limitsAndTicks([...ys, ...heights]), label: variable.label.replace("\n", " ") }, (c, sx, sy, box) => {
      const size = Math.max(1.2, Math.min(3.2, (0.36 * (box.right - box.left)) / axis.values.length));  // neighbours do not merge
      const rim = xs.length < 300 ? ink.faint : null;  // rims of many would hide their colours
      xs.forEach((value, k) => mark(c, "o", sx(value), sy(ys[k]), size, colours[index[k]], rim));
      drawItems(c, over, sx, sy, ink);
    }, { empty: !xs.length });
  }

  /** The cell at a place of the canvas, null outside. */
  at(px, py) {
    const { frame, view } = this;
    if (!frame || px < frame.box.left || px > frame.box.right || py < frame.box.top || py > frame.box.bottom) return null;
    if (this.hasCells) {
      const index = (direction, value) => {
        const { edges } = edgesOf(direction.column);
        const k = edges.findIndex((edge, i) => i > 0 && (value - edges[i - 1]) * (value - edge) <= 0) - 1;
        return Math.max(0, k);
      };
      return this.cellAt({ [view.x.axis.name]: index(view.x, frame.x.inverse(px)), [view.y.axis.name]: index(view.y, frame.y.inverse(py)) });
    }
    const best = leastOf(this.dots.xs.map((value, k) => distance([px, py], [frame.x(value), frame.y(this.dots.ys[k])])));
    return best < 0 ? null : this.cellAt({ [this.dots.axis]: this.dots.index?.[best] ?? best });
  }

  /** The cell that an arrow key leads to from the chosen one. */
  moved(dx, dy) {
    const { x, y, cell } = this.view;
    const step = (axis, by) => Math.max(0, Math.min(axis.values.length - 1, cell[axis.name] + by));
    if (this.hasCells) {
      const way = (direction) => (edgesOf(direction.column).values.at(-1) >= edgesOf(direction.column).values[0] ? 1 : -1);
      return this.cellAt({ [x.axis.name]: step(x.axis, dx * way(x)), [y.axis.name]: step(y.axis, dy * way(y)) });
    }
    if (!y) return this.cellAt({ [x.axis.name]: step(x.axis, dx + dy) });
    const { frame, dots } = this, from = cell[dots.axis], [fx, fy] = [frame.x(dots.xs[from]), frame.y(dots.ys[from])];
    const best = leastOf(dots.xs.map((value, k) => {  // the nearest dot within a quarter turn of the way
      const [vx, vy] = [frame.x(value) - fx, fy - frame.y(dots.ys[k])];
      const along = vx * Math.sign(dx) + vy * Math.sign(dy), aside = Math.abs(dx ? vy : vx);
      return along > 0 && aside <= along ? along + 2 * aside : NaN;
    }));
    return this.cellAt({ [dots.axis]: best < 0 ? from : best });
  }

  /** Where a cell is drawn: [left, top, width, height], or a dot's [x, y]. */
  drawOver(hover = null) {
    const { context: c } = prepared(this.overlay), { frame, view } = this;
    if (!frame) return;
    const { box } = frame;
    c.save();
    c.beginPath();
    c.rect(box.left - 8, box.top - 8, box.right - box.left + 16, box.bottom - box.top + 16);
    c.clip();
    for (const [cell, strong] of [[hover, false], [view.cell, true]]) {
      if (!cell) continue;
      if (this.hasCells) {
        const ends = (direction, scale) => { const { edges } = edgesOf(direction.column), k = cell[direction.axis.name]; return [scale(edges[k]), scale(edges[k + 1])]; };
        const [x0, x1] = ends(view.x, frame.x), [y0, y1] = ends(view.y, frame.y);
        const [left, top, wide, high] = [Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0)];
        if (strong) {
          uprightLine(c, left + wide / 2, box, "rgba(128,128,128,0.75)", 1, [3, 3]);
          levelLine(c, top + high / 2, box, "rgba(128,128,128,0.75)", 1, [3, 3]);
        }
        for (const [strokeStyle, lineWidth, more] of strong ? [["#FFFFFF", 4, 2], ["#111111", 2, 2]] : [["#FFFFFF", 2.5, 1], ["#111111", 1, 1]])
          Object.assign(c, { strokeStyle, lineWidth }).strokeRect(left - more, top - more, wide + 2 * more, high + 2 * more);
      } else {
        const k = cell[this.dots.axis], { index } = this.dots;
        if (index) {
          const of = index.flatMap((one, i) => (one === k ? [i] : []));
          if (!of.length) continue;
          uprightLine(c, Math.round(frame.x(this.dots.xs[of[0]])) + 0.5, box, this.ink.ink, strong ? 1.4 : 0.8, strong ? [] : [3, 3]);
          continue;
        }
        c.beginPath();
        c.arc(frame.x(this.dots.xs[k]), frame.y(this.dots.ys[k]), strong ? 8 : 6, 0, 2 * Math.PI);
        for (const [strokeStyle, lineWidth] of [[this.ink.plate, strong ? 4.5 : 3], [this.ink.ink, strong ? 2.2 : 1.2]]) Object.assign(c, { strokeStyle, lineWidth }).stroke();
      }
    }
    c.restore();
  }
}
