// The chosen cell beside the map: its head, panels and keys, its numbers, and the calls that simulate it.
import { described, drawHistory, drawMultipliers, drawPlane, drawReturns, drawSpectrum, planesOf, symbolOf } from "./cell.js";
import { el } from "./dom.js";
import { numberText } from "./plots.js";

const EVENT_KEYS = { 1: ["stick", "vx-k-stick"], 2: ["slip", "vx-k-slip"], 3: ["impact", "vx-k-impact"] };
const MASS_KEYS = [["x1", "bit", "vx-k-bit"], ["x2", "striker", "vx-k-striker"], ["x3", "bit on rock", "vx-k-rock"], ["x4", "hole", "vx-k-hole"]];

/** The regime of the motion that is shown, where it is known of the lane. */
function badge(page, motion) {
  const { grid, point, named } = page, regime = grid.variables.get("regime");
  const value = point ? motion?.numbers?.regime : regime && grid.value("regime", page.cell);
  const ofLane = point ? Boolean(regime) : page.apart !== "attractor" && regime?.axes.every((axis) => named.includes(axis));
  if (!ofLane || value === undefined) return [];
  const swatch = el("span", { class: "vx-swatch", style: `background:${grid.colour(regime, value)}` });
  return [el("span", { class: "vx-badge" }, swatch, grid.valueText(regime, value))];
}

function head(page, motion) {
  let text = page.data.without ?? "no motion is kept of this dataset";
  if (motion) text = described(motion) + (motion.kind !== "none" && motion.note && motion.returns ? ` (${motion.note})` : "");
  return el("div", { class: "vx-cellhead" }, el("h2", { text: page.point?.title || page.grid.cellText(page.cell, page.named) || "The motion" }),
    ...badge(page, motion), el("p", { class: "vx-motion", text }));
}

/** A figure, and what draws it. */
function panel(title, draw, about, extra = "", ...more) {
  const canvas = el("canvas", { role: "img", "aria-label": `${title}: ${about}` });
  const figure = el("figure", { class: `vx-panel ${extra}` }, el("figcaption", {}, el("span", { text: title }), ...more), canvas);
  return { figure, draw: () => draw(canvas) };
}

function planePanels(motion, planes) {
  const mass = (one) => one.long_name.replace(/^.*(position|displacement) of (the )?/, "").replace(/ (relative|\().*/, "");
  const size = { 1: "vx-wide vx-tall", 2: "vx-half" }[planes.length] ?? "";
  const names = planes.map(([position]) => mass(position));
  const title = (k) => names[k] + (names.filter((name) => name === names[k]).length > 1 ? `: ${symbolOf(planes[k][0].name)}` : "");
  return planes.map((plane, k) => panel(`Phase plane, ${title(k)}`, (canvas) => drawPlane(canvas, motion, plane, k), described(motion), size));
}

function historyPanels(motion) {
  const units = [...new Set(motion.columns.map((one) => one.units))];
  return units.map((unit, k) => {
    const some = motion.columns.filter((one) => one.units === unit), title = motion.kind === "orbit" ? "Two cycles" : "Time history";
    return panel(k ? "" : title, (canvas) => drawHistory(canvas, motion, some, k === units.length - 1),
      `${some.map((one) => one.long_name).join(", ")} over time; ${described(motion)}`, "vx-wide");
  });
}

/** The states at the returns, of which one is chosen. */
function returnsPanel(page, motion) {
  const names = Object.keys(motion.section), { shown } = page;
  if (!names.length || !motion.section[names[0]].length) return [];
  if (!names.includes(shown.returns)) shown.returns = names.at(-1);
  const choice = el("select", { "aria-label": "State at the returns", "data-control": "returns",
    onchange: (event) => { shown.returns = event.target.value; page.current.draw(); } },
    ...names.map((name) => el("option", { value: name, text: symbolOf(name), selected: name === shown.returns })));
  const unitsOf = (name) => motion.columns.find((one) => one.name === name)?.units ?? "m";
  return [panel("Returns", (canvas) => drawReturns(canvas, motion, shown.returns, unitsOf(shown.returns)),
    `${motion.section[names[0]].length} returns to the section`, "", choice)];
}

function panelsOf(page, motion) {
  const planes = planesOf(motion.columns), positions = planes.map(([position]) => position);
  const found = [...planePanels(motion, planes), ...historyPanels(motion)];
  if (positions.length)
    found.push(panel("Spectrum", (canvas) => drawSpectrum(canvas, motion, positions),
      `amplitudes of ${positions.map((one) => one.long_name).join(", ")} over frequency`));
  found.push(...returnsPanel(page, motion));
  if (motion.multipliers?.length)
    found.push(panel("Multipliers", (canvas) => drawMultipliers(canvas, motion),
      motion.multipliers.map(([modulus, argument]) => `modulus ${numberText(modulus)}, argument ${numberText(argument)} rad`).join("; ")));
  return found;
}

/** What the lines and marks of the panels mean. */
function keys(motion) {
  const events = Object.entries(EVENT_KEYS).filter(([kind]) => motion.flags.some((flag) => (flag & 7) === Number(kind)));
  const masses = MASS_KEYS.filter(([name]) => name in motion.states);
  return el("ul", { class: "vx-keys" }, ...masses.map(([, text, style]) => el("li", {}, el("span", { class: `vx-line ${style}` }), text)),
    ...events.map(([, [text, style]]) => el("li", {}, el("span", { class: `vx-mark ${style}` }), text)));
}

/** The numbers of the chosen cell, or of a motion at a point beside it. */
export function numbersOf(page, motion) {
  const { grid, named } = page, rows = [], apart = [...grid.startAxes, "attractor"].filter((axis) => !named.includes(axis));
  for (const variable of grid.variables.values()) {
    const { name } = variable, ofMotion = motion?.numbers && name in motion.numbers;
    if (!page.point && variable.axes.some((axis) => apart.includes(axis))) continue;
    // An attractor without a start has a share of zero, and no motion.
    if (!page.point && page.apart === "attractor" && variable.axes.includes("attractor") && !name.startsWith("share")) continue;
    // A smallest push that was not found ends in no regime.
    const push = name.startsWith("regime_") ? grid.value(name.replace("regime", "push"), page.cell) : 0;
    const value = Number.isNaN(push) ? NaN : ofMotion ? motion.numbers[name] ?? NaN : page.point ? undefined : grid.value(name, page.cell);
    if (value === undefined) continue;
    const text = grid.valueText(variable, value, 5);
    const at = page.point ? "" : grid.cellText(page.cell, variable.axes.filter((axis) => !named.includes(axis)));
    rows.push(el("tr", {}, el("th", { scope: "row", text: variable.long_name + (at && ` (${at})`) }), el("td", { "data-name": name, "data-value": value, text })));
  }
  const wasClosed = page.table.querySelector("details")?.open === false;
  return el("details", { class: "vx-numbers", open: !wasClosed }, el("summary", { text: "Numbers" }), el("table", {}, el("tbody", {}, ...rows)));
}

async function copy(text, beside, button) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    const area = el("textarea");
    area.value = text;
    beside.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
    button.focus();
  }
  button.textContent = "copied";
  setTimeout(() => { button.textContent = "copy"; }, 1500);
}

function commands(page) {
  const calls = page.calls();
  if (!calls) {
    const text = page.data.run && !page.apart ? "This system is known only to the Python session that defined it: pass its object to vj.simulate there." : "";
    return el("p", { class: "vx-motion", text });
  }
  const { command, python } = calls;
  const one = (label, text) => {
    const button = el("button", { type: "button", class: "vx-copy", text: "copy", "aria-label": `Copy the ${label}`,
      onclick: () => copy(text, page.side, button) });
    return el("div", { class: "vx-call" }, el("span", { text: label }), el("code", { text }), button);
  };
  return el("div", { class: "vx-calls" }, one("command line", command), one("Python call", python));
}

/** Fill a page's side and table with a motion, null where there is none; gives what draws its panels. */
export function fillChosen(page, motion) {
  const moves = motion && motion.kind !== "none", panels = moves ? panelsOf(page, motion) : [];
  page.side.replaceChildren(head(page, motion), ...(moves ? [keys(motion)] : []),
    el("div", { class: "vx-panels" }, ...panels.map((one) => one.figure)), commands(page));
  page.table.replaceChildren(numbersOf(page, motion));
  return () => panels.forEach((one) => one.draw());
}
