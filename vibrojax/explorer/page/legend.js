// What the colours and lines of the map mean.
import { el } from "./dom.js";
import { drawBar } from "./map.js";
import { numberText } from "./plots.js";

const dash = (colour, text, style = "") => el("li", {}, el("span", { class: `vx-dash${style}`, style: `border-color:${colour}` }), text);

/** The cells of the plane that is shown. */
function* plane(page, cell = page.cell, left = axesOfPlane(page)) {
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
  const { variable, grid } = page, counts = new Map();
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
    el("li", {}, el("span", { class: "vx-swatch", style: `background:${variable.colours[flag]}` }), `${variable.flags[flag]} `,
      el("small", { text: percent(counts.get(flag)) })));
}

/** What lies over the map: borders, branches, cells of a hidden motion. */
function overItems(page) {
  const found = [], { curves, family } = page.data;
  if (curves && page.shown.borders !== "off" && page.view.view.y)
    for (const kind of new Set(curves.list.filter((one) => page.view.onPlane(one)).map((one) => one.kind)))
      found.push(dash(curves.colours[kind], kind));
  if (family) {
    const colour = family.runs[0]?.colour;
    found.push(dash(colour, "stable"), dash(colour, "not stable", " vx-dashed"));
    for (const kind of new Set(family.special.map((one) => one.kind)))
      found.push(el("li", {}, el("span", { class: "vx-swatch vx-round", style: `background:${family.kinds[kind]}` }), kind));
  }
  const hides = page.variable.name === "regime" && page.grid.variables.has("hidden_motion");
  if (hides && [...plane(page)].some((cell) => page.grid.value("hidden_motion", cell) === 1))
    found.push(el("li", {}, el("span", { class: "vx-dot" }), "another start: same label, other motion"));
  return found;
}

/** Draw the legend of what a page's map shows into its element. */
export function drawLegend(page) {
  const { variable, grid, legend } = page;
  if (variable.flags || !page.shown.y) {
    legend.replaceChildren(el("ul", {}, ...(variable.flags ? flagItems(page) : []), ...overItems(page)));
    return;
  }
  const about = `Colours of ${variable.label} from ${numberText(variable.low)} to ${numberText(variable.high)}`;
  const bar = el("canvas", { class: "vx-bar", role: "img", "aria-label": about });
  legend.replaceChildren(el("p", { class: "vx-barname", text: variable.label.replace("\n", " ") }), bar, el("ul", {}, ...overItems(page)));
  drawBar(bar, grid, variable);
}
