// The data of a page: axes, variables, which cell is chosen, and what a value looks like.
import { unpack } from "./decode.js";
import { numberText } from "./plots.js";

/** What is known of a dataset, by the document of vibrojax.explorer. */
export class Grid {
  constructor(data) {
    this.data = data;
    this.axes = new Map(data.axes.map((axis) => [axis.name, axis]));
    this.variables = new Map(data.variables.map((one) => [one.name, one]));
    // A variable may hold several values of each cell, such as its returns: they run along an axis of their own.
    for (const { inner, count } of data.variables) if (inner) this.axes.set(inner, { name: inner, values: Array.from({ length: count }, (_, k) => k), columns: [], inner: true });
    this.values = new Map();
    this.lanes = null;
  }

  /** Read what the first map needs; the other variables come when they are asked for. */
  async load(name) {
    if (!this.values.has(name)) this.values.set(name, await unpack(this.variables.get(name).data));
    if (this.data.lanes && !this.lanes) this.lanes = await unpack(this.data.lanes);
  }

  async loadAll() {
    await Promise.all([...this.variables.keys()].map((name) => this.load(name)));
  }

  /** The place of a cell {axis: index} in an array over `axes`. */
  place(axes, cell) {
    let flat = 0;
    for (const name of axes) flat = flat * this.axes.get(name).values.length + (cell[name] ?? 0);
    return flat;
  }

  value(name, cell) {
    const values = this.values.get(name);
    return values ? values[this.place(this.variables.get(name).axes, cell)] : undefined;
  }

  lane(cell) {
    return this.lanes ? this.lanes[this.place(this.data.lanes.axes, cell)] : -1;
  }

  /** The axes that the starts of the lanes run along. */
  get startAxes() {
    return (this.variables.get("lane_attractor")?.axes ?? []).filter((name) => name === "start" || name.startsWith("start_"));
  }

  /** The cell of the first start that ends in the cell's attractor, null where none does. */
  startOf(cell, left = this.startAxes) {
    if (!left.length) return this.value("lane_attractor", cell) === cell.attractor ? cell : null;
    const [name, ...others] = left;
    for (let k = 0; k < this.axes.get(name).values.length; k++) {
      const found = this.startOf({ ...cell, [name]: k }, others);
      if (found) return found;
    }
    return null;
  }

  /** What may run to the right or up: numeric axes, and columns along one that is a list, as "axis:column". */
  directions() {
    const found = [];
    for (const axis of this.data.axes) {
      if (axis.columns.length === 0 || !axis.columns.some((one) => one.numeric)) {
        if (axis.values.length > 1) found.push({ id: axis.name, axis, column: axis });
      } else
        for (const column of axis.columns)
          if (column.numeric && !column.silent && new Set(column.values).size > 1) found.push({ id: `${axis.name}:${column.name}`, axis, column });
    }
    return found;
  }

  /** Whether two directions make a map: two axes, or two columns along one. */
  static together(one, other) {
    return one.id !== other.id && (one.column !== one.axis) === (other.column !== other.axis) &&
      (one.column === one.axis || one.axis === other.axis);
  }

  /** The axes of a variable that a view over `x` and `y` does not run along. */
  facets(name, x, y) {
    const along = new Set([x?.axis.name, y?.axis.name]);
    return this.variables.get(name).axes.filter((axis) => !along.has(axis) && !this.axes.get(axis).inner && this.axes.get(axis).values.length > 1)
      .concat((this.data.lanes?.axes ?? []).filter((axis) =>
        !along.has(axis) && !this.variables.get(name).axes.includes(axis) && this.axes.get(axis).values.length > 1));
  }

  /** The value of an axis (or a column along it) in words, with its unit. */
  coordinateText(column, index, digits = 5) {
    const value = column.values[index];
    if (!column.numeric) return `${column.name.replaceAll("_", " ")} ${value}`;
    const unit = column.units ? ` ${column.units}` : "";
    return `${column.symbol} = ${numberText(value * column.factor, digits)}${unit}`;
  }

  /** Where a cell is along the axes named `along`, in words; `short`: a start of many numbers by its own number. */
  cellText(cell, along, text = (column, k) => this.coordinateText(column, k), short = false) {
    const parts = [];
    for (const axis of this.data.axes) {
      if (!(axis.name in cell) || !along.includes(axis.name)) continue;
      const columns = axis.columns.filter((one) => !one.silent && (new Set(one.values).size > 1 || !one.numeric));
      if (short && axis.name === "start" && columns.length > 2) parts.push(`start ${cell.start}`);
      else for (const column of columns.length ? columns : [axis]) parts.push(text(column, cell[axis.name]));
    }
    return parts.join(", ");
  }

  /** Where a cell is, for the name of a file. */
  nameText(cell, along) {
    return this.cellText(cell, along, ({ name, numeric, values, factor, units }, k) => `${name}=${numeric ? numberText(values[k] * factor, 5) + units : values[k]}`).replaceAll(", ", "_");
  }

  /** A variable's value in words, with its unit. */
  valueText(variable, value, digits = 4) {
    if (value === undefined) return "…";
    if (variable.flags && !Number.isNaN(value)) return (variable.flags[String(value)] ?? `${value}`).replaceAll("-", "‑");
    if (Number.isNaN(value)) return "no value";
    const number = variable.whole ? String(value) : numberText(value * variable.factor, digits);
    return variable.units ? `${number} ${variable.units}` : number;
  }

  /** The colour of a value, as in the pictures. */
  colour(variable, value, ink = {}) {
    if (variable.flags) return variable.colours[String(value)] ?? ink.undefined;
    if (Number.isNaN(value) || value === undefined) return ink.undefined;
    if (variable.nothing_at_zero && value === 0) return ink.plate;
    const shown = value * variable.factor, { low, high } = variable;
    const share = variable.log ? Math.log(shown / low) / Math.log(high / low) : (shown - low) / (high - low);
    const map = this.data.maps[variable.map];
    return map[Math.max(0, Math.min(map.length - 1, Math.floor(share * map.length)))];
  }
}

/** Where the values of an axis, or of a column, are in a plot; names are numbered. */
export const placesOf = ({ numeric, values, factor }) => values.map((value, k) => (!numeric ? k : value === null ? NaN : value * factor));

/** The ticks of names. */
export const ticksOf = ({ numeric, values }) => (numeric ? undefined : values.map((text, k) => [k, text]));

/** The ends of the cells around values: half-way, in the logarithm for geometric ones. */
export function edgesOf(axis) {
  const n = axis.values.length, values = placesOf(axis);
  if (n === 1) { const half = Math.abs(values[0]) * 0.1 || 0.5; return { values, edges: [values[0] - half, values[0] + half] }; }
  const map = axis.log ? Math.log : (x) => x, back = axis.log ? Math.exp : (x) => x, at = values.map(map);
  const edges = [at[0] - (at[1] - at[0]) / 2];
  for (let k = 0; k + 1 < n; k++) edges.push((at[k] + at[k + 1]) / 2);
  edges.push(at[n - 1] + (at[n - 1] - at[n - 2]) / 2);
  return { values, edges: edges.map(back) };
}

/** What stands along a direction. */
export function labelOf(column) {
  let words = column.label.replace(/\s*\([^)]*\)/g, "");
  if (words.length > 44) words = words.split(",")[0];
  if (words.length > 44) words = column.name.replaceAll("_", " ");
  const symbol = column.symbol && column.symbol !== column.name && column.symbol !== words ? `, ${column.symbol}` : "";
  return `${words}${symbol}${column.units ? ` [${column.units}]` : ""}`;
}
