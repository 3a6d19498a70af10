// The controls above the map: what it shows, along which directions, at which cell of the others, and what lies over it.
import { el } from "./dom.js";
import { Grid } from "./grid.js";

/** Above so many values of an axis a field for their number stands in place of a list. */
const MOST_OPTIONS = 400;

/** Elements that make controls: their names are those of `data-control`. */
function maker(id) {
  return {
    select: (name, label, options, value, change) => {
      const one = el("select", { id: `${id}-${name}`, "data-control": name, onchange: (event) => change(event.target.value) },
        ...options.map(([key, text]) => el("option", { value: key, text, selected: key === value })));
      return el("label", { for: one.id }, el("span", { text: label }), one);
    },
    number: (name, label, value, last, change) => {
      const inside = (text) => Math.max(0, Math.min(last, Math.round(Number(text) || 0)));
      const one = el("input", { type: "number", id: `${id}-${name}`, "data-control": name, min: 0, max: last, value,
        onchange: (event) => change(inside(event.target.value)) });
      return el("label", { for: one.id }, el("span", { text: label }), one);
    },
    check: (name, label, title, checked, change) => el("label", { class: "vx-check", title },
      el("input", { type: "checkbox", "data-control": name, checked, onchange: (event) => change(event.target.checked) }),
      el("span", { text: label })),
  };
}

/** How directions are called in lists: by label and symbol, by the symbol alone where that is longer than `most`. */
function namer(along, most) {
  return ({ column }) => {
    const { symbol } = column, label = column.label.replace(/ \(.*/, "");  // as on the axis
    const whole = symbol === column.name || symbol === label ? label : `${label}, ${symbol}`;
    if (whole.length <= most) return whole;
    return label.length < most && along.filter((other) => other.column.label.replace(/ \(.*/, "") === label).length === 1 ? label : symbol;
  };
}

function directionControls(page, make, most) {
  const { shown } = page, along = page.directions.filter((one) => page.along(one)), x = page.direction(shown.x), name = namer(along, most);
  if (along.length < 2) return [];
  const listed = (some) => some.map((one) => [one.id, name(one)]);
  const found = [make.select("x", "To the right", listed(along), shown.x, (value) => page.show({ x: value }))];
  const ups = along.filter((one) => Grid.together(x, one));
  if (ups.length && !page.data.family && !page.variable.inner) {
    const curve = x.axis === x.column ? [["", "— (a curve)"]] : [];
    found.push(make.select("y", "Up", [...listed(ups), ...curve], shown.y ?? "", (value) => page.show({ y: value })));
  }
  return found;
}

/** What the map may be limited to: the stable motions, those of a regime, and of these the stable ones. */
function amongControl(page, make) {
  const { grid, shown } = page, regime = grid.variables.get("regime"), stable = grid.variables.get("stable");
  const runsAlong = (one) => one?.axes.every((name) => page.variable.axes.includes(name));
  const there = new Set(grid.values.get("regime")), options = [["", "all motions"]];
  if (!page.variable || page.variable.inner) return [];
  if (runsAlong(stable) && grid.values.has("stable") && new Set(grid.values.get("stable")).size > 1) options.push(["stable", "stable"]);
  for (const [flag, name] of runsAlong(regime) ? Object.entries(regime.flags ?? {}) : []) {
    if (!there.has(Number(flag))) continue;
    options.push([flag, name]);
    if (runsAlong(stable) && /impact|subharmonic/.test(name)) options.push([`stable ${flag}`, `stable ${name}`]);
  }
  return options.length > 2 || options[1]?.[0] === "stable" ? [make.select("only", "Show", options, shown.only, (value) => page.show({ only: value }))] : [];
}

/** A short name of an axis: its label without what stands in brackets, and its symbol. */
function shortName({ label, symbol, name }) {
  const words = label.replace(/\s*\([^)]*\)/g, "");
  if (words.length > 26) return `${words.split(" ")[0]}, ${symbol}`;
  return symbol && ![name, words].includes(symbol) ? `${words}, ${symbol}` : words;
}

/** The index along an axis that the map does not run along. */
function facetControl(page, make, facet) {
  const { grid } = page, axis = grid.axes.get(facet), name = `at-${facet}`, at = page.cell[facet];
  const pick = (value) => page.pick({ ...page.cell, [facet]: value });
  if (axis.values.length > MOST_OPTIONS) return make.number(name, shortName(axis), at, axis.values.length - 1, pick);
  const columns = axis.columns.filter((one) => !one.silent && new Set(one.values).size > 1);
  const text = (k) => {
    if (columns.length === 1) return grid.coordinateText(columns[0], k);
    if (!axis.numeric) return axis.values[k];
    return axis.columns.length ? `${k}` : grid.coordinateText(axis, k).replace(/^.*= /, "");
  };
  const options = axis.values.map((_, k) => [`${k}`, text(k)]);
  return make.select(name, shortName(axis), options, `${at}`, (value) => pick(Number(value)));
}

function overControls(page, make) {
  const { shown, grid, data } = page, over = [shown.x, shown.y], found = [];
  if (data.region && over.every((one) => one in data.region))
    found.push(make.check("region", "source's region", "The region that the source recommends: β 0.25 to 0.6, γ 0.6 to 0.8", shown.region,
      (value) => page.show({ region: value })));
  if (data.curves?.list.length && over.every((one) => one in data.curves.list[0].points)) {
    if (data.curves.of === "curves") {
      found.push(make.check("borders", "curves", "Special points of orbits, stable or not, continued in both parameters", shown.borders !== "off",
        (value) => page.show({ borders: value ? "any" : "off" })));
      return found;
    }
    const own = grid.axes.has("start") ? [["own", "from this start"]] : [];
    found.push(make.select("borders", "Borders of the single impact", [...own, ["any", "from any start"], ["off", "none"]], shown.borders,
      (value) => page.show({ borders: value })));
  }
  return found;
}

/** The controls of what a page shows. */
export function controlsOf(page) {
  const make = maker(page.id), variables = [...page.grid.variables.values()].map((one) => [one.name, one.name.replaceAll("_", " ")]);
  if (!page.shown.x) return page.facets().filter((name) => name === "start").map((name) => facetControl(page, make, name));
  const controls = (most) => [
    make.select("variable", "Variable", variables, page.shown.variable, (value) => page.show({ variable: value })),
    ...directionControls(page, make, most),
    ...page.facets().map((facet) => facetControl(page, make, facet)),
    ...amongControl(page, make),
    ...overControls(page, make),
  ];
  const all = controls(26);
  return all.length > 4 && page.element.clientWidth < 480 ? controls(16) : all;  // on a phone, many stand in three columns
}
