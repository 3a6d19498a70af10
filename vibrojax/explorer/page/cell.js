// The chosen cell: its orbit in phase planes, its time history, spectrum, returns and multipliers.
import { EVENTS, STUCK } from "./decode.js";
import { framed, inkOf, limitsOf, line, mark, numberText, read, uprightLine } from "./plots.js";

const COLOURED = { x1: "bit", v1: "bit", x2: "striker", v2: "striker", x3: "bit", v3: "bit", x4: "rock",
  applied_force: "faint", rock_force: "ink", impact_force: "impact", friction_force: "ink" };
const NAMES = { x1: "x₁", v1: "x₁′", x2: "x₂", v2: "x₂′", x3: "x₃", v3: "x₃′", x4: "x₄", compression: "x₃ − x₄" };

export const symbolOf = (name) => NAMES[name] ?? name.replaceAll("_", " ");

/** A unit as it is printed: rad/s for rad s-1, as `pretty_unit` of the axes. */
function prettyUnit(units) {
  if (units === "1") return "";
  const parts = units.split(" ").map((part) => /^([^\d\s-]+)(-?\d+)?$/.exec(part));
  if (parts.some((part) => !part)) return units;
  const power = (part) => Number(part[2] ?? 1), raised = (n) => (n === 1 ? "" : String(n).replace(/\d/g, (d) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[d]));
  const text = (part) => part[1] + raised(Math.abs(power(part)));
  const above = parts.filter((part) => power(part) > 0).map(text), below = parts.filter((part) => power(part) < 0).map(text);
  return below.length > 1 ? units : (above.join(" ") || "1") + (below.length ? `/${below[0]}` : "");
}

/** The unit that values read well in: [factor, unit]. */
export function shownIn(units, values) {
  const pretty = prettyUnit(units);
  let most = 0;
  for (const x of values) if (Math.abs(x) > most) most = Math.abs(x);
  if (units === "m" && most < 1) return [1e3, "mm"];
  if (units === "s" && most < 0.1) return [1e3, "ms"];
  if (units === "N" && most >= 1e3) return [1e-3, "kN"];
  return [1, pretty];
}

export const withUnit = (text, unit) => (unit ? `${text} [${unit}]` : text);

/** Positions with their velocities: [[position, velocity], ...] as columns. */
export function planesOf(columns) {
  const byName = new Map(columns.map((one) => [one.name, one])), found = [];
  for (const one of columns)
    if (/^x/.test(one.name) && byName.has(one.name.replace(/^x/, "v"))) found.push([one, byName.get(one.name.replace(/^x/, "v"))]);
  if (found.length === 0 && columns.length > 1) found.push([columns[0], columns[1]]);
  return found;
}

/** The states that share a plot over time: of one unit, and the hole apart from the machine. */
export const groupsOf = (columns) => {
  const key = ({ name, units }) => `${/^([xv][34]|(rock|applied)_force)$/.test(name) ? "hole" : /force/.test(name) ? "force" : ""} ${units}`;
  return [...new Set(columns.map(key))].map((one) => columns.filter((column) => key(column) === one));
};

/** The name of a state's colour, of the k-th state in its plot. */
export const colourName = (name, k) => COLOURED[name] ?? ["bit", "striker", "rock", "accent"][k % 4];
const colourOf = (ink, name, k) => ink[colourName(name, k)];

/** Which events belong to a state's plane: impacts to both masses, stick and slip to what slides. */
const SHAPES = { stick: ["s", "stick"], slip: ["^", "slip"], impact: ["D", "impact"] };

function markEvents(c, cell, xs, ys, sx, sy, ink, kinds) {
  for (let i = 0; i < xs.length; i++) {
    const kind = EVENTS[cell.flags[i] & 7], k = i % cell.time.length;
    if (!kinds.includes(kind)) continue;
    for (const j of cell.time[k + 1] === cell.time[k] ? [i, i + 1] : [i]) mark(c, SHAPES[kind][0], sx(xs[j]), sy(ys[j]), kind === "impact" ? 4.2 : 3.4, ink[SHAPES[kind][1]], ink.plate);  // before and after a jump
  }
}

/** The parts of a line where the bit sticks. */
function stuckParts(cell, values) {
  return values.map((value, i) => (cell.flags[i] & STUCK || (i > 0 && cell.flags[i - 1] & STUCK) ? value : NaN));
}

/** By how much a state grows over what is shown, as the hole does; 0 where it comes back. */
function growth(values) {
  const [low, high] = limitsOf([values], 0), grown = values.at(-1) - values[0];
  return Math.abs(grown) > 0.02 * (high - low) ? grown : 0;
}

const scaled = (values, factor) => Array.from(values, (x) => x * factor);

export function drawPlane(canvas, cell, [position, velocity], k, others = []) {
  const ink = inkOf(canvas), x = cell.states[position.name], y = cell.states[velocity.name];
  const [fx, ux] = shownIn(position.units, x), [fy, uy] = shownIn(velocity.units, y), xs = scaled(x, fx), ys = scaled(y, fy);
  const bit = position.name === "x1" || !/^x\d/.test(position.name);
  const all = (own, name, factor) => limitsOf([own, ...others.filter(({ motion }) => name in motion.states).map(({ motion }) => scaled(motion.states[name], factor))], 0.09);
  framed(canvas, ink,
    { limits: all(xs, position.name, fx), label: withUnit(symbolOf(position.name), ux) },
    { limits: all(ys, velocity.name, fy), label: withUnit(symbolOf(velocity.name), uy) },
    (c, sx, sy) => {
      for (const { motion: { states }, colour, title } of others) {
        if (!(position.name in states)) continue;
        const [us, vs] = [scaled(states[position.name], fx), scaled(states[velocity.name], fy)];
        line(c, us, vs, sx, sy, colour, 1.6);
        read(title, us, vs, { joined: true });
      }
      line(c, xs, ys, sx, sy, colourOf(ink, position.name, k), cell.kind === "orbit" ? 2 : 1.2);
      read("", xs, ys, { joined: true });
      if (bit) line(c, stuckParts(cell, xs), ys, sx, sy, ink.stick, 4);
      markEvents(c, cell, xs, ys, sx, sy, ink, bit ? ["impact", "stick", "slip"] : ["impact"]);
    });
}

/** Two cycles of what repeats, or what there is of another motion: states of one unit. */
export function drawHistory(canvas, cell, columns, isLast) {
  const ink = inkOf(canvas), twice = cell.kind === "orbit" ? 2 : 1, length = cell.duration;
  const times = [...cell.time, ...(twice === 2 ? Array.from(cell.time, (t) => t + length) : [])];
  const [ft, ut] = shownIn("s", [times.at(-1) ?? 1]);
  const every = columns.map((one) => cell.states[one.name]), [fy, uy] = shownIn(columns[0].units, every.flatMap((x) => [Math.min(...x), Math.max(...x)]));
  const xs = scaled(times, ft), rows = every.map((x) => { const one = scaled(x, fy); return twice === 2 ? [...one, ...one.map((v) => v + growth(one))] : one; });
  framed(canvas, ink,
    { limits: [0, (xs.at(-1) ?? 1) || 1], label: isLast || canvas.source ? withUnit("time", ut) : "", said: withUnit("time", ut) },
    { limits: limitsOf(rows, 0.09), label: withUnit(columns.map((one) => symbolOf(one.name)).join(", "), uy) },
    (c, sx, sy) => {
      const first = twice === 2 ? { ...cell, flags: [...cell.flags, ...cell.flags] } : cell;
      layered(columns).forEach(([one, k, wide]) => {
        line(c, xs, rows[k], sx, sy, colourOf(ink, one.name, k), wide ?? 1.7);
        read(symbolOf(one.name), xs, rows[k], { joined: true });
        if (one.name === "x1" || one.name === "v1") {
          line(c, stuckParts(first, xs), rows[k], sx, sy, ink.stick, 3.5);
          markEvents(c, first, xs, rows[k], sx, sy, ink, ["stick", "slip"]);
        }
        if (one.name === "x2" || one.name === "v2") markEvents(c, first, xs, rows[k], sx, sy, ink, ["impact"]);
        if (!/^[xv]\d$/.test(one.name)) markEvents(c, first, xs, rows[k], sx, sy, ink, ["impact", "stick", "slip"]);
      });
    }, { left: 62 });
}

/** A state of several motions {motion, colour} over their returns, as shares of each; null is the colour of the shown one. */
export function drawPhase(canvas, all, { name, units }) {
  const ink = inkOf(canvas), [f, unit] = shownIn(units, all.flatMap(({ motion }) => limitsOf([motion.states[name]], 0)));
  const rows = all.map(({ motion }) => scaled(motion.states[name], f)), span = Math.max(1, ...all.map(({ motion }) => motion.returns || 1));
  framed(canvas, ink, { limits: [0, span], label: "returns" }, { limits: limitsOf(rows, 0.09), label: withUnit(symbolOf(name), unit) }, (c, sx, sy) => {
    all.forEach(({ motion, colour, title = "" }, k) => {
      const xs = scaled(motion.time, (motion.returns || 1) / motion.duration);
      line(c, xs, rows[k], sx, sy, colour ?? colourOf(ink, name, 0), colour ? 1.5 : 2.2);
      read(title, xs, rows[k], { joined: true });
    });
  }, { left: 62 });
}

/** The states of a plot in the order in which they are drawn, with their numbers: the hole below the bit, as a wider line. */
const layered = (columns) => columns.map((one, k) => [one, k, one.name === "x4" ? 3.2 : undefined]).sort(([a], [b]) => (b.name === "x4") - (a.name === "x4"));

const CYCLE_PIXELS = 5, BAND_PIXELS = 6;

/** Whether a line over what is shown of an axis has more oscillations than can be told apart. */
function isDense(xs, ys, sx, { left, right }) {
  let path = 0, low = Infinity, high = -Infinity;
  xs.forEach((x, i) => {
    if (sx(x) < left || sx(x) > right) return;
    if (i) path += Math.abs(ys[i] - ys[i - 1]);
    [low, high] = [Math.min(low, ys[i]), Math.max(high, ys[i])];
  });
  return path / (2 * (high - low)) > (right - left) / CYCLE_PIXELS;
}

/** A band from the least to the greatest value, as in the pictures. */
function drawBand(c, xs, ys, sx, sy, { left, right }, colour) {
  const ends = Array.from({ length: Math.ceil((right - left) / BAND_PIXELS) }, () => [Infinity, -Infinity]);
  xs.forEach((x, i) => {
    const k = Math.floor((sx(x) - left) / BAND_PIXELS);
    if (k in ends) ends[k] = [Math.min(ends[k][0], ys[i]), Math.max(ends[k][1], ys[i])];
  });
  c.fillStyle = colour;
  c.globalAlpha = 0.25;
  ends.forEach(([low, high], k) => { if (high >= low) c.fillRect(left + k * BAND_PIXELS, sy(high), BAND_PIXELS, Math.max(1, sy(low) - sy(high))); });
  c.globalAlpha = 1;
  const edge = (which) => line(c, ends.flatMap((_, k) => [k, k + 1]), ends.flatMap((one) => [one[which], one[which]]), (k) => left + k * BAND_PIXELS, sy, colour, 1.4);
  edge(0);
  edge(1);
}

/** The whole course of a trajectory: states of one unit, from the beginning; a line where the observation begins. */
export function drawCourse(canvas, course, columns, isLast) {
  const ink = inkOf(canvas), [fy, uy] = shownIn(columns[0].units, columns.flatMap((one) => Array.from(course[one.name])));
  const forces = columns.length > 1 && columns.every(({ name }) => name.endsWith("_force"));
  framed(canvas, ink,
    { limits: [course.time[0], course.time.at(-1)], label: isLast || canvas.source ? "time [s]" : "", said: "time [s]" },
    { limits: limitsOf(columns.map((one) => scaled(course[one.name], fy)), 0.06), label: withUnit(forces ? "force" : columns.map((one) => symbolOf(one.name)).join(", "), uy) },
    (c, sx, sy, box) => {
      canvas.dense = columns.some((one) => isDense(course.time, course[one.name], sx, box));
      layered(columns).forEach(([one, k, wide]) => {
        const ys = scaled(course[one.name], fy);
        if (canvas.dense) drawBand(c, course.time, ys, sx, sy, box, colourOf(ink, one.name, k)); else line(c, course.time, ys, sx, sy, colourOf(ink, one.name, k), wide ?? 0.9);
        read(forces ? one.long_name : symbolOf(one.name), course.time, ys, { joined: true });
      });
      if (course.observed) uprightLine(c, sx(course.observed), box, ink.ink, 1.2, [4, 3]);
    }, { left: 62 });
}

/** Values at even times: of an orbit over one repeat, which closes on itself. */
export function resampled(cell, name, count) {
  const { time } = cell, values = cell.states[name], found = new Float64Array(count);
  let k = 0;
  for (let i = 0; i < count; i++) {
    const t = (i / count) * cell.duration;
    while (k + 2 < time.length && time[k + 1] < t) k++;
    const span = time[k + 1] - time[k], share = span > 0 ? Math.min(1, Math.max(0, (t - time[k]) / span)) : 0;
    found[i] = values[k] + share * (values[k + 1] - values[k]);
  }
  return found;
}

const COSINES = Float64Array.from({ length: 1024 }, (_, i) => Math.cos((2 * Math.PI * i) / 1024));

/** Amplitudes of a motion at multiples of one over its duration, a Hann window over what does not repeat. */
export function spectrumOf(cell, name, lines) {
  const count = COSINES.length, values = resampled(cell, name, count), windowed = cell.kind !== "orbit";
  const grown = growth(Array.from(cell.states[name]));
  for (let i = 0; i < count; i++) values[i] -= (grown * i) / count;
  let mean = 0;
  for (const x of values) mean += x / count;
  for (let i = 0; i < count; i++) values[i] = (values[i] - mean) * (windowed ? 1 - COSINES[i] : 1);
  const found = new Float64Array(lines);
  for (let h = 1; h <= lines; h++) {
    let re = 0, im = 0;
    for (let i = 0; i < count; i++) {
      re += values[i] * COSINES[(h * i) % count];
      im += values[i] * COSINES[(h * i + 3 * (count / 4)) % count];
    }
    found[h - 1] = (2 * Math.hypot(re, im)) / count;
  }
  return found;
}

export function drawSpectrum(canvas, cell, columns) {
  const ink = inkOf(canvas), returns = Math.max(cell.returns, 1), lines = Math.min(Math.max(12 * returns, 12), 120);
  const [f, unit] = shownIn(columns[0].units, columns.flatMap((one) => [Math.max(...cell.states[one.name].map(Math.abs))]));
  const all = columns.map((one) => scaled(spectrumOf(cell, one.name, lines), f)), greatest = Math.max(...all.flat(), 1e-300);
  const low = greatest * 1e-4, at = (h) => (h + 1) / cell.duration;
  framed(canvas, ink,
    { limits: [0, at(lines - 1) * 1.04], label: "frequency [Hz]" },
    { limits: [low, greatest * 2], label: withUnit("amplitude", unit), log: true },
    (c, sx, sy, box) => {
      all.forEach((values, k) => {
        const colour = colourOf(ink, columns[k].name, k), aside = (k - (all.length - 1) / 2) * 3;
        read(symbolOf(columns[k].name), values.map((_, h) => at(h)), values.map((v) => Math.max(v, low)));
        if (cell.kind !== "orbit") { line(c, values.map((_, h) => at(h)), values.map((v) => Math.max(v, low)), sx, sy, colour, 1.4); return; }
        c.strokeStyle = c.fillStyle = colour;
        c.lineWidth = 2;
        values.forEach((value, h) => {
          if (!(value > low)) return;
          c.beginPath();
          c.moveTo(sx(at(h)) + aside, box.bottom); c.lineTo(sx(at(h)) + aside, sy(value));
          c.stroke();
          mark(c, "o", sx(at(h)) + aside, sy(value), 2.2, colour);
        });
      });
    });
}

/** A state at each return over that at the one before. */
export function drawReturns(canvas, cell, name, units) {
  const ink = inkOf(canvas), [f, unit] = shownIn(units, cell.section[name]), values = scaled(cell.section[name], f);
  const from = cell.kind === "orbit" ? values : values.slice(0, -1);
  const to = cell.kind === "orbit" ? [...values.slice(1), values[0]] : values.slice(1);
  let limits = limitsOf([values], 0.12);
  if (cell.kind === "orbit" && values.length === 1) limits = limitsOf([[values[0]]]);
  const text = symbolOf(name);
  framed(canvas, ink, { limits, label: withUnit(`${text} at a return`, unit) }, { limits, label: withUnit(`${text} at the next`, unit) }, (c, sx, sy) => {
    line(c, limits, limits, sx, sy, ink.faint, 1, [4, 3]);
    read("", from, to);
    from.forEach((value, k) => mark(c, "o", sx(value), sy(to[k]), cell.kind === "orbit" ? 4.2 : 2.6, ink.accent, ink.plate));
  }, { square: true });
}

/** Multipliers in the complex plane, with their conjugates. */
export function drawMultipliers(canvas, cell) {
  const ink = inkOf(canvas), most = Math.min(Math.max(1, ...cell.multipliers.map(([modulus]) => modulus)), 4) * 1.18;
  framed(canvas, ink, { limits: [-most, most], label: "real part" }, { limits: [-most, most], label: "imaginary part" }, (c, sx, sy) => {
    c.strokeStyle = ink.ink;
    c.lineWidth = 1.3;
    c.beginPath();
    c.ellipse(sx(0), sy(0), sx(1) - sx(0), sy(0) - sy(1), 0, 0, 2 * Math.PI);
    c.stroke();
    const texts = cell.multipliers.map(([modulus, argument]) => `modulus ${numberText(modulus)}, argument ${numberText(argument)} rad`);
    for (const way of [1, -1]) read("", cell.multipliers.map(([modulus, argument]) => modulus * Math.cos(argument)), cell.multipliers.map(([modulus, argument]) => way * modulus * Math.sin(argument)), { texts });
    for (const [modulus, argument] of cell.multipliers)
      for (const way of [1, -1])
        mark(c, modulus < 1 ? "o" : "x", sx(modulus * Math.cos(argument)), sy(way * modulus * Math.sin(argument)), 4.2, modulus < 1 ? ink.accent : ink.impact, modulus < 1 ? ink.plate : null);
  }, { square: true });
}

/**
 * What a picture of the cell shows, in words, for who does not see it. `labelled`: after how many returns the motion
 * repeats by its label, 0 if it does not, null if the label does not say; without a label the motion itself tells. The
 * motion is simulated anew, and where rounding decides it may be another than the one with the label.
 */
export function described(cell, labelled = cell.kind === "orbit" ? cell.returns : 0) {
  if (cell.kind === "none") return cell.note;
  const events = ["stick", "slip", "impact"].map((kind) => [kind, cell.flags.reduce((n, flag) => n + (EVENTS[flag & 7] === kind), 0)]);
  const listed = events.filter(([, n]) => n).map(([kind, n]) => `${n} × ${kind}`).join(", ");
  const [f, unit] = shownIn("s", [cell.duration]), own = cell.kind === "orbit" ? cell.returns : 0;
  const long = `${numberText(cell.duration * f, 4)} ${unit}`, after = (n) => `${n} return${n === 1 ? "" : "s"}`;
  const shown = cell.returns ? `${after(cell.returns)} are shown, ${long}` : `${cell.note}; ${long} are shown`;
  const repeats = labelled ? `repeats after ${after(labelled)}` : "does not repeat";
  let what = shown;
  if (labelled === own && cell.returns) what = own ? `${repeats}, ${long}` : `${repeats}; ${shown}`;
  else if (labelled !== own && labelled !== null) what = `${repeats}; simulated anew it ends in another motion: ${shown}`;
  return listed ? `${what}: ${listed}` : what;
}
