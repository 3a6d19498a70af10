// What the colours, lines and marks of the map mean.
import { el, explained } from "./dom.js";
import { DASHES } from "./map.js";
import { barElements, entry } from "./plots.js";

/** The cells of the plane that is shown. */
export function* plane(page, cell = page.cell, left = axesOfPlane(page)) {
  if (!left.length) {
    yield cell;
    return;
  }
  const [name, ...others] = left, count = page.grid.axes.get(name).values.length;
  for (let k = 0; k < count; k++) yield* plane(page, { ...cell, [name]: k }, others);
}

function axesOfPlane(page) {
  const directions = [page.direction(page.shown.x), page.direction(page.shown.y)].filter(Boolean);
  return [...new Set(directions.map((one) => one.axis.name))];
}

/** The variable whose colours the map has: of several values of a cell that of their lanes. */
const coloured = ({ grid, variable }) => (variable.inner ? grid.variables.get("regime") ?? variable : variable);

/** The values of a variable on the part of the map that is shown: of what was computed anew, else of the dataset. */
function shownValues(page, { name }) {
  const anew = page.view.view.patch?.variables.get(name), shows = page.view.shown();
  return anew ? [...anew] : [...plane(page)].filter(shows).map((cell) => page.grid.value(name, cell));
}

const percent = (share) => (share === 1 ? "100 %" : share < 0.01 ? "<1 %" : share > 0.99 ? ">99 %" : `${Math.round(100 * share)} %`);

/** The entries of the legend of the map and of its files, see `drawSign`: with a sentence on what it is and a share of cells. */
export function keysOf(page) {
  const { grid, data } = page, variable = coloured(page), { curves, family, meanings = {} } = data, values = shownValues(page, variable), found = [], look = page.view.hasCells ? { shape: "patch" } : { shape: "o", size: 4, rim: true };
  const count = (wanted) => values.reduce((n, value) => n + (value === wanted), 0);
  for (const flag of Object.keys(variable.flags ?? {}).map(Number).sort((a, b) => a - b)) {
    const text = variable.flags[flag], n = count(flag);
    if (n) found.push({ text, ...look, colour: variable.colours[flag], share: percent(n / values.length), why: variable.name === "regime" && meanings[text] });
  }
  if (page.shown.y && values.some(Number.isNaN) && !values.every(Number.isNaN)) found.push({ text: "no value", shape: "patch", colour: "hatched" });
  if (page.among) found.push({ text: "other motions", shape: "patch", colour: "grid" });
  if (variable.nothing_at_zero && page.shown.y && count(0)) found.push({ text: "zero", shape: "patch", colour: "plate" });
  if (page.shown.region && data.region && [page.shown.x, page.shown.y].every((name) => name in data.region)) found.push({ text: "source's best region", shape: "line", colour: "ink" });
  for (const kind of new Set(page.view.curves.map((one) => one.kind)))
    found.push({ text: kind, shape: "line", colour: curves.colours[kind] ?? "#222222", dash: DASHES[kind], why: meanings[kind] });
  const corners = [...new Set(page.view.corners.map((one) => one.kind))];
  if (corners.length) found.push({ text: `where curves meet: ${corners.join(", ")}`, shape: "s", colour: "ink", hollow: true });
  if (family) {
    const line = { shape: "line", colour: family.runs[0]?.colour ?? "ink" }, stable = family.runs.map((run) => run.stable === 1);
    if (stable.includes(true)) found.push({ ...line, text: "stable" });
    if (stable.includes(false)) found.push({ ...line, text: "not stable", dash: [5, 4] });
    for (const [kind, shape] of new Map(family.special.map((one) => [one.kind, one.shape]))) found.push({ text: kind, shape, colour: family.kinds[kind], why: meanings[kind] });
  }
  for (const text of ["followed orbits, stable", "followed orbits, not stable"]) {
    const line = page.view.over.find(({ kind, dash }) => kind === "line" && dash.length > 0 === text.includes("not"));
    if (line) found.push({ text, shape: "line", colour: line.colour, dash: line.dash });
  }
  const hides = page.variable.name === "regime" && grid.variables.has("hidden_motion");
  if (hides && [...plane(page)].some((cell) => grid.value("hidden_motion", cell) === 1)) found.push({ text: "another start: same label, other motion", shape: "o", colour: "#222222" });
  return found;
}

/** The bar of the map's colours, null where it has none. */
export function barOf(page) {
  const variable = coloured(page), values = variable.flags || !page.shown.y ? [] : shownValues(page, variable);
  const [only, ...others] = new Set(values);  // in a set, NaN equals itself
  if (!others.length && !only) return null;
  return { ...variable, label: variable.label.replace("\n", " "), map: page.grid.data.maps[variable.map] };
}

/** Buttons that choose the cells with the greatest and the least value, on the map and in the whole dataset. */
function extremes(page) {
  const { grid, variable, among } = page, every = variable.axes.filter((name) => !grid.axes.get(name).inner);
  const ends = (cells) => {
    let least = null, most = null;
    for (const cell of cells) {
      const value = grid.value(variable.name, cell);
      if (!Number.isFinite(value) || (among && !among(cell))) continue;
      if (!least || value < least.value) least = { cell, value };
      if (!most || value > most.value) most = { cell, value };
    }
    return [most, least];
  };
  const [most, least] = ends([...plane(page)].filter(page.view.shown())), whole = page.facets().length ? ends(plane(page, page.cell, every))[0] : most;
  if (!whole || variable.inner) return [];
  const button = (text, end) => el("button", { type: "button", class: "vx-copy", text: `${text}: ${grid.valueText(variable, end.value, 4)}`, onclick: () => page.pick(end.cell) });
  const found = most ? [button("greatest here", most), ...(least.value < most.value ? [button("least here", least)] : [])] : [];
  if (!most || whole.value > most.value) found.push(button("greatest of all maps", whole));
  return [el("p", { class: "vx-extremes" }, "Go to", ...found)];
}

/** Draw the legend of what a page's map shows into its element. */
export function drawLegend(page) {
  const variable = coloured(page), bar = barOf(page);
  const list = el("ul", {}, ...keysOf(page).map((key) => entry(key, explained(el("span", {}, `${key.text} `, el("small", { text: key.share ?? "" })), key.why))));
  if (variable.flags || !page.shown.y) page.legend.replaceChildren(list, ...(variable.flags ? [] : extremes(page)));
  else if (bar) page.legend.replaceChildren(...barElements(bar), ...extremes(page), list);
  else page.legend.replaceChildren(el("p", { class: "vx-barname", text: `${variable.label.replace("\n", " ")}: ${shownValues(page, variable)[0] === 0 ? "0 everywhere" : "no value"} here` }), list);
}
