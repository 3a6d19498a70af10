// Below the map: the variable along both directions through the chosen cell; of a trajectory its whole course.
import { colourName, drawCourse, groupsOf } from "./cell.js";
import { el, write } from "./dom.js";
import { labelOf, placesOf } from "./grid.js";
import { interactive } from "./interact.js";
import { csvOf } from "./paper.js";
import { entry, framed, inkOf, leastOf, limitsAndTicks, limitsOf, line, mark, markColour, read, uprightLine } from "./plots.js";

/** Draw the slices of a page's map into its element. */
export function drawSlices(page) {
  const x = page.direction(page.shown.x), y = page.direction(page.shown.y), { slices } = page;
  const wanted = y && x.column === x.axis && x.column.numeric && y.column.numeric ? [x, y] : [];  // between names there is no course
  if (slices.childElementCount !== wanted.length)
    slices.replaceChildren(...wanted.map((_, k) => sliceFigure(k)));
  wanted.forEach((direction, k) => drawSlice(page, slices.children[k], direction, wanted[1 - k]));
}

/** A figure whose `slice` {title, draw, click, table} is what it shows now. */
function sliceFigure(k) {
  const canvas = el("canvas", { class: "vx-slice", role: "img", "data-slice": k }), title = el("span"), figure = el("figure", { class: "vx-panel" });
  const tools = interactive(canvas, (paper) => figure.slice.draw(paper), {
    about: () => figure.slice?.about() ?? { title: `slice ${k + 1}` }, files: [["CSV", "csv", () => csvOf(figure.slice.table())]], click: (place) => figure.slice.click(place),
  });
  figure.append(el("figcaption", {}, title, tools.menu), el("div", { class: "vx-stack" }, canvas, tools.band));
  return figure;
}

function drawSlice(page, figure, direction, other) {
  const { variable, grid } = page, { column } = direction, canvas = figure.querySelector("canvas");
  const at = grid.coordinateText(other.column, page.cell[other.axis.name]), title = `${variable.name.replaceAll("_", " ")} at ${at}`;
  write(figure.querySelector("figcaption span"), title);
  canvas.setAttribute("aria-label", `${variable.label} along ${column.label} at ${at}`);
  const xs = placesOf(column), cells = xs.map((_, i) => ({ ...page.cell, [direction.axis.name]: i })), values = cells.map((cell) => grid.value(variable.name, cell));
  const known = variable.flags ? [...new Set(values)].sort((a, b) => a - b) : [];
  const ys = variable.flags ? values.map((v) => known.indexOf(v)) : values.map((v) => v * variable.factor);
  const up = variable.flags
    ? { limits: [-0.6, known.length - 0.4], label: "", ticks: known.map((flag, i) => [i, variable.flags[flag] ?? `${flag}`]) }
    : { ...limitsAndTicks(ys), label: variable.units };
  const right = { limits: limitsOf([xs], 0.02), label: column.units ? `${column.symbol} [${column.units}]` : column.symbol, log: column.log };
  const draw = (paper, ink = inkOf(paper)) => framed(paper, ink, paper.source ? { ...right, label: labelOf(column) } : right, paper.source && !variable.flags ? { ...up, label: variable.label.replace("\n", " ") } : up, (c, sx, sy, box) => {
    const size = Math.max(1.6, Math.min(2.6, (box.right - box.left) / xs.length / 2));  // a rim would hide the colour of many
    if (!variable.flags && column.numeric) line(c, xs, ys, sx, sy, ink.faint, 1.2);
    read("", xs, ys, { texts: values.map((value) => grid.valueText(variable, value)) });
    xs.forEach((value, i) => {
      if (Number.isFinite(ys[i])) mark(c, "o", sx(value), sy(ys[i]), size, markColour(grid, variable, values[i], ink), size > 2.2 ? ink.faint : null);
    });
    if (!paper.source) uprightLine(c, sx(xs[page.cell[direction.axis.name]]), box, ink.ink, 1.2, [3, 3]);  // a file shows no cursor
  }, { empty: !ys.some(Number.isFinite) });
  const click = ([px]) => {
    const { frame } = canvas;
    if (frame) page.pick(cells[leastOf(xs.map((value) => Math.abs(frame.x(value) - px)))]);
  };
  const name = `${variable.name}_${grid.nameText(page.cell, page.named.filter((one) => one !== direction.axis.name))}`;
  figure.slice = { about: () => page.about(title, { name, notes: page.notesAt([direction.axis.name]) }), draw, click, table: () => page.tableOf(cells) };
  draw(canvas);
}

/** Draw a trajectory from its beginning, a plot for each unit and one for the hole, into a page's element. */
export function drawWhole(page) {
  const { slices, history } = page, every = page.data.history.columns;
  const groups = groupsOf(every);
  const begins = (columns) => (history.observed && columns === groups[0] ? [{ text: "the observation begins", shape: "line", colour: "ink", dash: [4, 3] }] : []);
  const keys = (columns) => [...columns.map(({ name, long_name }, i) => ({ text: long_name, shape: "line", colour: colourName(name, i) })), ...begins(columns)];
  if (!slices.childElementCount) {
    page.courses = groups.map((columns, k) => {
      const canvas = el("canvas", { role: "img", "aria-label": "The whole course over time" }), words = columns.map((one) => one.long_name).join(", ");
      const tools = interactive(canvas, (paper) => drawCourse(paper, history, columns, k === groups.length - 1), {
        about: () => page.about(words, { keys: keys(columns) }), zoomed: () => page.tell(), files: [["CSV", "csv", () => csvOf(Object.fromEntries([["time [s]", history.time], ...columns.map((one) => [one.name, history[one.name]])].map(([name, x]) => [name, Array.from(x)])))]],
      });
      page.keepZoom(canvas, tools);
      const band = el("li", { class: "vx-dense", text: "bands: from the least to the greatest value" });
      return { tools, canvas, band, figure: el("figure", { class: "vx-whole vx-panel" }, el("figcaption", {}, el("ul", { class: "vx-keys" }, ...keys(columns).map((key) => entry(key)), band), tools.menu), el("div", { class: "vx-stack" }, canvas, tools.band)) };
    });
    slices.replaceChildren(...page.courses.map((one) => one.figure));
  }
  for (const { tools, canvas, band } of page.courses) { tools.redraw(); band.hidden = !canvas.dense; }
}
