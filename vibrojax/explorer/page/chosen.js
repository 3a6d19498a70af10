// The chosen cell beside the map: its head, panels and keys, its numbers, and the calls that simulate it.
import { colourName, described, drawHistory, drawMultipliers, drawPhase, drawPlane, drawReturns, drawSpectrum, groupsOf, planesOf, shownIn, symbolOf } from "./cell.js";
import { el, explained } from "./dom.js";
import { interactive } from "./interact.js";
import { stateAt } from "./machine.js";
import { csvOf, download, fileName } from "./paper.js";
import { distance, drawSigns, entry, inkOf, leastOf, mark, numberText, prepared, uprightLine } from "./plots.js";

const EVENT_KEYS = { 1: ["stick", "s"], 2: ["slip", "^"], 3: ["impact", "D"] };
const MASS_KEYS = [["x1", "bit", "bit"], ["x2", "striker", "striker"], ["x3", "bit", "bit"], ["x4", "hole", "rock"]];

/** Values of flags that say nothing. */
const SILENT = new Set(["done", "none", "found", "identified"]);

/** Magnitude up to which coefficients of a law are rounding errors of zero. */
const ROUNDING = 1e-12;

/** Number of lines from which a summary is closed at first. */
const MOST_SUMMARY_LINES = 20;

const PERIODIC = [2, 3, 4, 5], IRREGULAR = 6;

/** The regime of the motion that is shown, where it is known of the lane. */
function regimeValue(page, motion) {
  const { grid, point, named } = page, regime = grid.variables.get("regime");
  if (!regime) return undefined;
  if (point) return motion?.numbers?.regime;
  return page.apart !== "attractor" && regime.axes.every((axis) => named.includes(axis)) ? grid.value("regime", page.cell) : undefined;
}

/** The regime as a badge, and what it means. */
function regimeOf(page, motion) {
  const { grid } = page, regime = grid.variables.get("regime"), value = regimeValue(page, motion), own = grid.variables.get("lane_attractor");
  if (value === undefined) return [[], ""];
  // The plots have the colours of attractors, not of regimes.
  const colour = own && !page.point ? grid.colour(own, page.cell.attractor) : grid.colour(regime, value);
  const swatch = el("span", { class: "vx-swatch", style: `background:${colour}` });
  return [[el("span", { class: "vx-badge" }, swatch, grid.valueText(regime, value))], page.data.meanings?.[regime.flags?.[String(value)]] ?? ""];
}

/** The motion in words that agree with the badge. */
function textOf(page, motion) {
  const value = regimeValue(page, motion);
  return described(motion, value === undefined ? undefined : PERIODIC.includes(value) ? cyclesOf(page, motion) : value === IRREGULAR ? 0 : null);
}

function head(page, motion) {
  let text = (page.data.without || (page.data.lanes ? "no motion is kept here" : "")).replace(/^./, (first) => first.toUpperCase());
  if (motion) text = textOf(page, motion) + (motion.kind !== "none" && motion.note && motion.returns ? ` (${motion.note})` : "");
  const [badge, meaning] = regimeOf(page, motion), moves = motion && motion.kind !== "none";
  return el("div", { class: "vx-cellhead" }, el("h2", { text: page.titleOf() }), ...badge,
    ...(moves ? [el("span", { class: "vx-cellbuttons" }, page.pins.button(), fileButton(page, motion))] : []),
    ...startOf(page), el("p", { class: "vx-motion", text }), ...(meaning ? [el("p", { class: "vx-motion vx-meaning", text: meaning })] : []));
}

/** The numbers of a start that the title calls by its number. */
function startOf({ grid, cell, named, point }) {
  const [full, short] = [undefined, true].map((short) => grid.cellText(cell, ["start"], undefined, short));
  return named.includes("start") && !point && full !== short ? [el("p", { class: "vx-motion", text: `${short}: ${full}` })] : [];
}

/** The chosen cell as a JSON file: its coordinates, numbers, command and motion. */
function fileButton(page, motion) {
  const content = () => JSON.stringify({
    title: page.titleOf(), scene: page.data.scene, coordinates: page.point ? page.point.parameters : page.coordinates(), numbers: page.pins.valuesOf(motion), ...page.calls(),
    motion: { kind: motion.kind, duration: motion.duration, returns: motion.returns, multipliers: motion.multipliers, time: Array.from(motion.time),
      states: Object.fromEntries(motion.columns.map(({ name, units, long_name }) => [name, { units, long_name, values: Array.from(motion.states[name]) }])) },
  }, null, 1);
  return el("button", { type: "button", class: "vx-copy", text: "JSON", title: "Save this cell as a JSON file", onclick: () => download(content(), fileName(page.about("cell").name, "json")) });
}

/**
 * A figure, what draws it, and what marks a moment in it. `at(time)`: the places of the moment, as [x, y, colour] with
 * null for a line across; `table()`: its columns for a file; `keys()`: its legend in a file; `file`: its name there,
 * where it is not the title; `options` of `interactive`.
 */
function panel(page, title, draw, about, { extra = "", more = [], at, table, keys = () => [], file = title, ...options } = {}) {
  const canvas = el("canvas", { role: "img", "aria-label": `${file}: ${about}` }), over = at ? [el("canvas", { class: "vx-moment", "aria-hidden": "true" })] : [];
  const files = table ? { files: [["CSV", "csv", () => csvOf(table())]] } : {};
  let last = null;
  const cursor = (time) => {
    last = time;
    const { frame } = canvas;
    if (!at || !frame || time === null) return;
    const { context: c } = prepared(over[0]), { box } = frame, ink = inkOf(canvas);
    for (const [x, y, colour] of at(time)) {
      if (y === null) uprightLine(c, frame.x(x), box, ink.ink);
      else mark(c, "o", frame.x(x), frame.y(y), 5, ink[colour] ?? colour, ink.plate);
    }
  };
  const tools = interactive(canvas, draw, { about: () => page.about(file, { keys: keys() }), ...files, ...options, zoomed: () => cursor(last) });
  const figure = el("figure", { class: `vx-panel ${extra}` }, el("figcaption", {}, el("span", { text: title }), ...more, tools.menu),
    el("div", { class: "vx-stack" }, canvas, ...over, tools.band));
  return { figure, canvas, cursor, draw: () => { draw(canvas); cursor(last); } };
}

/** A motion as columns for a file. */
function motionTable(motion) {
  const table = { "time [s]": Array.from(motion.time) };
  for (const { name, units } of motion.columns) table[units && units !== "1" ? `${name} [${units}]` : name] = Array.from(motion.states[name]);
  return table;
}

/** The legend of a file: of the pinned motions in it, and of the lines and marks of some states. */
const pinKeys = (page, motion) => page.pinned(motion).map(({ title, colour }) => ({ text: title, colour, shape: "line" }));
const stateKeys = (page, motion, columns, events = [1, 2, 3]) => [...keysOfMotion(motion, columns, events), ...pinKeys(page, motion)];

function planePanels(page, motion, planes) {
  const mass = (one) => one.long_name.replace(/^.*(position|displacement) of (the )?/, "").replace(/ (relative|\().*/, "");
  const size = { 1: "vx-wide vx-tall", 2: "vx-half" }[planes.length] ?? "";
  const names = planes.map(([position]) => mass(position));
  const title = (k) => names[k] + (names.filter((name) => name === names[k]).length > 1 ? `: ${symbolOf(planes[k][0].name)}` : "");
  return planes.map((plane, k) => {
    const [x, y] = plane, factors = () => plane.map((one) => shownIn(one.units, motion.states[one.name])[0]);
    const at = (time) => { const [fx, fy] = factors(); return [[stateAt(motion, x.name, time) * fx, stateAt(motion, y.name, time) * fy, "accent"]]; };
    const click = (place) => {  // the cursor goes to the nearest sample
      const [fx, fy] = factors(), { frame } = page.player.panels[k].canvas ?? {};
      if (!frame) return;
      const away = Array.from(motion.time, (_, i) => distance(place, [frame.x(motion.states[x.name][i] * fx), frame.y(motion.states[y.name][i] * fy)]));
      page.player.to(motion.time[leastOf(away)]);
    };
    const events = x.name === "x2" ? [3] : [1, 2, 3];
    return panel(page, `Phase plane, ${title(k)}`, (canvas) => drawPlane(canvas, motion, plane, k, page.pinned(motion)), textOf(page, motion),
      { extra: size, at, click, keys: () => stateKeys(page, motion, plane.slice(0, 1), events), table: () => motionTable(motion) });
  });
}

function historyPanels(page, motion) {
  const groups = groupsOf(motion.columns), twice = motion.kind === "orbit" ? 2 : 1, length = motion.duration * twice;
  return groups.map((some, k) => {
    const title = twice === 2 ? "Two cycles" : "Time history", [ft] = shownIn("s", [length]);
    const at = (time) => Array.from({ length: twice }, (_, i) => [(time + i * motion.duration) * ft, null]);
    const one = panel(page, k ? "" : title, (canvas) => drawHistory(canvas, motion, some, k === groups.length - 1),
      `${some.map((column) => column.long_name).join(", ")} over time; ${textOf(page, motion)}`,
      { extra: "vx-wide", at, file: `${title}, ${some.map((column) => symbolOf(column.name)).join(", ")}`, keys: () => stateKeys(page, motion, some), table: () => motionTable(motion), scrub: ([px]) => { const { frame } = one.canvas; if (frame) page.player.to(frame.x.inverse(px) / ft); } });
    return one;
  });
}

/** A list of states; at first the striker's velocity is chosen, where it is among them. */
function stateChoice({ shown, current }, key, names, label) {
  if (!names.includes(shown[key])) shown[key] = names.includes("v2") ? "v2" : names.at(-1);
  return el("select", { "aria-label": label, "data-control": key, onchange: (event) => { shown[key] = event.target.value; current.draw(); } },
    ...names.map((name) => el("option", { value: name, text: symbolOf(name), selected: name === shown[key] })));
}

/** A state of the shown and of the pinned motions over the share of a return, where one is pinned. */
function phasePanel(page, motion) {
  const others = page.pinned(motion), { shown } = page, names = motion.columns.map((one) => one.name);
  if (!others.length) return [];
  const choice = stateChoice(page, "phase", names, "State over the phase");
  const all = () => [...others, { motion, colour: null }].filter((one) => shown.phase in one.motion.states);
  return [panel(page, "Over the phase", (canvas) => drawPhase(canvas, all(), motion.columns.find((one) => one.name === shown.phase)),
    `${shown.phase} of the shown and the pinned motions over the share of a return`, { extra: "vx-wide", more: [choice], keys: () => pinKeys(page, motion) })];
}

/** The states at the returns, of which one is chosen. */
function returnsPanel(page, motion) {
  const names = Object.keys(motion.section), { shown } = page;
  if (!names.length || !motion.section[names[0]].length) return [];
  const choice = stateChoice(page, "returns", names, "State at the returns");
  const unitsOf = (name) => motion.columns.find((one) => one.name === name)?.units ?? "m";
  return [panel(page, "Returns", (canvas) => drawReturns(canvas, motion, shown.returns, unitsOf(shown.returns)),
    `${motion.section[names[0]].length} returns to the section`, { more: [choice], table: () => Object.fromEntries(names.map((name) => [name, Array.from(motion.section[name])])) })];
}

function panelsOf(page, motion) {
  const planes = planesOf(motion.columns), positions = planes.map(([position]) => position).filter(({ name }, _, all) => name !== "x3" || all.length === 1);
  const found = [...planePanels(page, motion, planes), ...historyPanels(page, motion), ...phasePanel(page, motion)];
  if (positions.length)
    found.push(panel(page, "Spectrum", (canvas) => drawSpectrum(canvas, motion, positions),
      `amplitudes of ${positions.map((one) => one.long_name).join(", ")} over frequency`, { keys: () => keysOfMotion(motion, positions, []) }));
  found.push(...returnsPanel(page, motion));
  if (motion.multipliers?.length)
    found.push(panel(page, `Largest multiplier ${numberText(Math.max(...motion.multipliers.map(([modulus]) => modulus)), 3)}`, (canvas) => drawMultipliers(canvas, motion),
      motion.multipliers.map(([modulus, argument]) => `modulus ${numberText(modulus)}, argument ${numberText(argument)} rad`).join("; ")));
  // The last row is filled.
  const narrow = found.map(({ figure }) => figure).filter(({ classList }) => !/vx-wide|vx-half/.test(classList)), last = narrow.slice(planes.length > 2 ? 3 : 0);
  if (last.length < 3) last.forEach(({ classList }) => classList.add(...(last.length === 2 ? ["vx-half"] : ["vx-wide", "vx-tall"])));
  return found;
}

/** The entries of a legend: of some states of a motion, and of the events that occur in it. */
function keysOfMotion(motion, columns = motion.columns, kinds = [1, 2, 3]) {
  const line = (text, colour) => ({ text, shape: "line", colour }), names = columns.map(({ name }) => name.replace("v", "x"));
  const masses = MASS_KEYS.filter(([name]) => names.includes(name) && !(name === "x3" && names.includes("x1"))).map(([, text, colour]) => line(text, colour));
  // A state alone in its plot is named by the axis.
  const states = masses.length ? masses : groupsOf(columns).flatMap((some) => (some.length > 1 ? some.map(({ name }, k) => line(symbolOf(name), colourName(name, k))) : []));
  const events = kinds.filter((kind) => motion.flags.some((flag) => (flag & 7) === kind)).map((kind) => ({ text: EVENT_KEYS[kind][0], shape: EVENT_KEYS[kind][1], colour: EVENT_KEYS[kind][0] }));
  return [...states, ...events];
}

/** A number of a pinned motion, and how far that of the shown one is from it. */
function pinnedNumber(grid, variable, value, pin) {
  const other = pin.values[variable.name];
  if (other === undefined) return el("td", { class: "vx-other", text: "—" });
  const change = (value - other) * variable.factor, cell = el("td", { class: "vx-other", text: grid.valueText(variable, other, 4) });
  if (!variable.flags && Number.isFinite(change) && change !== 0) cell.append(el("small", { text: ` ${change > 0 ? "+" : ""}${numberText(change, 3)} ${variable.units}`.trimEnd() }));
  return cell;
}

/** After how many returns the chosen lane, or the motion at a point beside it, repeats; 0 if it does not. */
function cyclesOf(page, motion) {
  return page.point ? motion?.numbers?.cycles : page.grid.value("cycles", page.cell);
}

/** A mean of a motion that does not repeat: as many digits as it has, with the least and greatest where they are known. */
function spreadText(page, motion, variable, value) {
  const { grid } = page;
  const [low, high] = ["min", "max"].map((end) => {
    const name = `${variable.name}_${end}`;
    return page.point ? motion?.numbers?.[name] : grid.variables.has(name) ? grid.value(name, page.cell) : undefined;
  });
  if (variable.flags || variable.whole || !Number.isFinite(value)) return grid.valueText(variable, value, 5);
  const text = grid.valueText(variable, value, 2);
  if (!Number.isFinite(low) || !Number.isFinite(high)) return `≈ ${text}`;
  return `≈ ${text}, from ${numberText(low * variable.factor, 2)} to ${grid.valueText(variable, high, 2)}`;
}

/** The numbers of the chosen cell, or of a motion at a point beside it. */
export function numbersOf(page, motion, pins = []) {
  const { grid, named } = page, irregular = cyclesOf(page, motion) === 0, rows = [], missing = [], apart = [...grid.startAxes, "attractor"].filter((axis) => !named.includes(axis));
  for (const variable of grid.variables.values()) {
    if (variable.inner || ["form", "lane"].some((axis) => variable.axes.includes(axis)) || grid.variables.has(variable.name.replace(/_worst$/, "")) && variable.name.endsWith("_worst")) continue;
    const { name } = variable, worst = grid.variables.get(`${name}_worst`), ofMotion = motion?.numbers && name in motion.numbers;
    if (!page.point && variable.axes.some((axis) => apart.includes(axis))) continue;
    // An attractor without a start has a share of zero, and no motion.
    if (!page.point && page.apart === "attractor" && variable.axes.includes("attractor") && !name.startsWith("share")) continue;
    // A smallest push that was not found ends in no regime.
    const push = name.startsWith("regime_") ? grid.value(name.replace("regime", "push"), page.cell) : 0;
    const value = Number.isNaN(push) ? NaN : ofMotion ? motion.numbers[name] ?? NaN : page.point ? undefined : grid.value(name, page.cell);
    if (value === undefined) continue;
    if (Number.isNaN(value) && !pins.length) { missing.push(name); continue; }
    if (variable.flags ? SILENT.has(variable.flags[value]) : name === "sensitive" && !value) continue;
    const text = irregular && !/^(share|lyapunov|multiplier)/.test(name) ? spreadText(page, motion, variable, value) : grid.valueText(variable, value, 5);
    const least = worst && !worst.flags ? `, worst ${grid.valueText(worst, grid.value(worst.name, page.cell), 5)}` : "";
    const at = page.point ? "" : grid.cellText(page.cell, variable.axes.filter((axis) => !named.includes(axis)));
    rows.push(el("tr", {}, el("th", { scope: "row", text: `${variable.long_name}${at && ` (${at})`} ` }, el("code", { text: name })), el("td", { "data-name": name, "data-value": value, text: text + least }), ...pins.map((pin) => pinnedNumber(grid, variable, value, pin))));
  }
  if (pins.length)
    rows.unshift(el("tr", {}, el("td"), el("th", { scope: "col", text: "this" }), ...pins.map((pin) =>
      el("th", { scope: "col" }, el("span", { class: "vx-swatch", style: `background:${pin.colour}` }), ` ${pin.title}`, el("small", { text: "difference: this − pinned" })))));
  if (missing.length) rows.push(el("tr", {}, el("th", { colspan: 2 }, "without a value: ", el("code", { text: missing.join(", ") }))));
  return el("details", { class: "vx-numbers", open: page.table.querySelector("details.vx-numbers")?.open ?? true }, el("summary", { text: "Numbers" }), el("table", {}, el("tbody", {}, ...rows)));
}

/** The coefficients of the forms of a law, with their standard errors, side by side. */
function formsOf({ grid, cell }) {
  const form = grid.axes.get("form"), C = grid.variables.get("C");
  if (!form || !C) return [];
  const of = (variable, k) => grid.value(variable.name, { ...cell, form: k }), known = [...form.values.keys()].filter((k) => Number.isFinite(of(C, k)));
  const text = (variable, k) => {
    const error = grid.variables.get(`${variable.name}_stderr`), value = Math.abs(of(variable, k)) < ROUNDING ? 0 : of(variable, k);
    if (Number.isNaN(value)) return "—";
    return variable.flags || !error || Number.isNaN(of(error, k)) ? grid.valueText({ ...variable, units: "" }, value) : `${numberText(value * variable.factor)} ±\u00a0${numberText(of(error, k) * variable.factor, 2)}`;
  };
  const rows = [...grid.variables.values()].filter(({ name, axes }) => axes.includes("form") && !/_stderr$/.test(name))
    .map((variable) => [variable, known.map((k) => text(variable, k))]).filter(([, texts]) => new Set(texts).size > 1);
  const signs = { eta0: "η₀", r_squared: "R²", aic: "AIC" }, name = ({ name, units, long_name }) => explained(el("span", {}, signs[name] ?? name.replaceAll("_", " "), units ? ` [${units}]` : ""), long_name);
  return [el("div", { class: "vx-numbers vx-forms" }, el("p", { text: "η = P/D: mean force P divided by the threshold D of the rock; ± standard error" }), el("table", {}, el("tbody", {}, el("tr", {}, el("td"), ...known.map((k) => el("th", { scope: "col", text: form.values[k] }))),
    ...rows.map(([variable, texts]) => el("tr", {}, el("th", { scope: "row" }, name(variable)), ...texts.map((one) => el("td", { text: one })))))))];
}

/** What the analysis says of the dataset. */
function summaryOf(page) {
  const { summary } = page.data;
  if (!summary?.length) return [];
  const few = !page.data.lanes || (page.data.figure && summary.flatMap(({ lines }) => lines).length < MOST_SUMMARY_LINES);
  const parts = summary.map(({ name, lines }) => el("div", {}, el(page.data.kind === "plots" ? "h2" : "h3", { class: "vx-part", text: name }), ...lines.map((text) => el("pre", { text }))));
  return [el("details", { class: "vx-summary", open: page.table.querySelector(".vx-summary")?.open ?? few }, el("summary", { text: "Summary" }), ...parts)];
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
    const text = page.data.run && !page.apart && !page.data.without ? "This system is known only to the Python session that defined it: pass its object to vj.simulate there." : "";
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
  if (page.data.kind === "plots") page.side.replaceChildren();
  else page.side.replaceChildren(head(page, motion), ...(moves ? [page.player.element, el("ul", { class: "vx-keys" }, ...keysOfMotion(motion).map((key) => entry(key)))] : []),
    el("div", { class: "vx-panels" }, ...panels.map((one) => one.figure)), commands(page));
  page.player.set(motion, panels);
  const summary = summaryOf(page), numbers = [page.numbers(motion)].filter((one) => one.querySelector("tr"));
  if (page.data.map === false && !page.data.lanes) page.side.append(...formsOf(page), ...numbers.splice(0));
  page.table.replaceChildren(...formsOf(page).slice(page.data.map === false), ...(page.data.figure ? [...summary, ...numbers] : [...numbers, ...summary]));
  return () => { panels.forEach((one) => one.draw()); page.player.draw(); drawSigns(page.side); };
}
