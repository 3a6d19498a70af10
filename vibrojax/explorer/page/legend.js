// What the colours and lines of the map mean.
import { el, explained } from "./dom.js";
import { DASHES, drawBar } from "./map.js";
import { GLYPHS, inkOf, legible, numberText, ticks } from "./plots.js";

/** A line as it lies over the map: its colour and dashes, with the white edge it has there. */
function dash(colour, text, dashes = []) {
  const svg = (tag, attributes) => {
    const one = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(attributes)) one.setAttribute(name, value);
    return one;
  };
  const picture = svg("svg", { class: "vx-stroke", width: 30, height: 8, "aria-hidden": "true" }), way = { x1: 1, x2: 29, y1: 4, y2: 4 };
  picture.append(svg("line", { ...way, stroke: "#FFFFFF", "stroke-width": 5 }), svg("line", { ...way, stroke: colour, "stroke-width": 2.4, "stroke-dasharray": dashes.join(" ") }));
  return el("li", {}, picture, text);
}

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

/** Each label that occurs on the plane, with its share. */
function flagItems(page) {
  const { grid } = page, variable = page.variable.inner ? grid.variables.get("regime") : page.variable, counts = new Map();
  let total = 0;
  for (const cell of plane(page)) {
    const value = String(grid.value(variable.name, cell));
    counts.set(value, (counts.get(value) ?? 0) + 1);
    total++;
  }
  const percent = (n) => {
    if (n === total) return "100 %";
    return n / total < 0.01 ? "<1 %" : n / total > 0.99 ? ">99 %" : `${Math.round((100 * n) / total)} %`;
  };
  return Object.keys(variable.flags).filter((flag) => counts.has(flag)).sort((a, b) => a - b).map((flag) =>
    el("li", {}, explained(el("span", {}, el("span", { class: "vx-swatch", style: `background:${variable.colours[flag]}` }), ` ${variable.flags[flag]} `,
      el("small", { text: percent(counts.get(flag)) })), variable.name === "regime" && page.data.meanings?.[variable.flags[flag]])));
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
  const [most, least] = ends(plane(page)), whole = page.facets().length ? ends(plane(page, page.cell, every))[0] : most;
  if (!whole || variable.inner) return [];
  const button = (text, end) => el("button", { type: "button", class: "vx-copy", text: `${text}: ${grid.valueText(variable, end.value, 4)}`, onclick: () => page.pick(end.cell) });
  const found = most ? [button("greatest here", most), ...(least.value < most.value ? [button("least here", least)] : [])] : [];
  if (!most || whole.value > most.value) found.push(button("greatest of all maps", whole));
  return [el("p", { class: "vx-extremes" }, "Go to", ...found)];
}

/** What lies over the map: borders, branches, cells of a hidden motion. */
function overItems(page) {
  const found = [], { curves, family } = page.data;
  if (curves && page.shown.borders !== "off" && page.view.view.y) {
    for (const kind of new Set(curves.list.filter((one) => page.view.onPlane(one)).map((one) => one.kind)))
      found.push(dash(curves.colours[kind] ?? "#222222", explained(el("span", { text: kind }), page.data.meanings?.[kind]), DASHES[kind]));
    const corners = [...new Set(page.view.corners().map((one) => one.kind))];
    if (corners.length) found.push(el("li", {}, el("span", { class: "vx-corner" }), `where curves meet: ${corners.join(", ")}`));
  }
  if (family) {
    const ink = inkOf(page.element), colour = legible(family.runs[0]?.colour ?? ink.ink, ink), stable = family.runs.map((run) => run.stable === 1);
    if (stable.includes(true)) found.push(dash(colour, "stable"));
    if (stable.includes(false)) found.push(dash(colour, "not stable", [5, 4]));
    for (const [kind, shape] of new Map(family.special.map((one) => [one.kind, one.shape])))
      found.push(el("li", {}, el("span", { class: "vx-glyph", style: `color:${legible(family.kinds[kind], ink)}`, text: GLYPHS[shape] }), explained(el("span", { text: kind }), page.data.meanings?.[kind])));
  }
  const hides = page.variable.name === "regime" && page.grid.variables.has("hidden_motion");
  if (hides && [...plane(page)].some((cell) => page.grid.value("hidden_motion", cell) === 1))
    found.push(el("li", {}, el("span", { class: "vx-dot" }), "another start: same label, other motion"));
  return found;
}

/** The entries of the legend of an exported map: its labels, or some values of its bar, and the lines over it. */
export function legendKeys(page) {
  const { grid } = page, variable = page.variable.inner ? grid.variables.get("regime") ?? page.variable : page.variable, found = [];
  if (variable.flags) {
    const there = new Set([...plane(page)].map((cell) => String(grid.value(variable.name, cell))));
    for (const [flag, text] of Object.entries(variable.flags)) if (there.has(flag)) found.push({ text, colour: variable.colours[flag], shape: "patch" });
  } else if (page.shown.y)
    for (const value of ticks(variable.low, variable.high, 5, variable.log))
      found.push({ text: `${numberText(value, 3)} ${variable.units}`.trim(), colour: grid.colour(variable, value / variable.factor, "#888888"), shape: "patch" });
  const { curves } = page.data;
  if (curves && page.shown.borders !== "off" && page.view.view.y)
    for (const kind of new Set(curves.list.filter((one) => page.view.onPlane(one)).map((one) => one.kind)))
      found.push({ text: kind, colour: curves.colours[kind] ?? "#222222", shape: "line", dash: DASHES[kind] });
  return found;
}

/** Draw the legend of what a page's map shows into its element. */
export function drawLegend(page) {
  const { grid, legend } = page, variable = page.variable.inner ? grid.variables.get("regime") ?? page.variable : page.variable;
  if (variable.flags || !page.shown.y) {
    legend.replaceChildren(el("ul", {}, ...(variable.flags ? flagItems(page) : []), ...overItems(page)), ...(variable.flags ? [] : extremes(page)));
    return;
  }
  const [only, ...others] = new Set([...plane(page)].map((cell) => grid.value(variable.name, cell)));
  if (!others.length && !only) {
    const text = `${variable.label.replace("\n", " ")}: ${only === 0 ? "0 everywhere" : "no value"} here`;
    legend.replaceChildren(el("p", { class: "vx-barname", text }), el("ul", {}, ...overItems(page)));
    return;
  }
  const about = `Colours of ${variable.label} from ${numberText(variable.low)} to ${numberText(variable.high)}`;
  const bar = el("canvas", { class: "vx-bar", role: "img", "aria-label": about });
  legend.replaceChildren(el("p", { class: "vx-barname", text: variable.label.replace("\n", " ") }), bar, ...extremes(page), el("ul", {}, ...overItems(page)));
  drawBar(bar, grid, variable);
}
