// The machine at one moment of a motion, in the frame of its drive: rock, bit, springs, lever and striker.
import { STUCK, TOUCHING } from "./decode.js";
import { inkOf, prepared } from "./plots.js";

const WIDE = 720, HIGH = 425;  // the drawing's own units

/** The index of the last sample at or before a time. */
export function sampleAt({ time }, t) {
  let low = 0, high = time.length - 1;
  while (low < high) { const middle = (low + high + 1) >> 1; if (time[middle] <= t) low = middle; else high = middle - 1; }
  return low;
}

/** A state at a time, between its samples. */
export function stateAt(motion, name, t) {
  const values = motion.states[name], k = sampleAt(motion, t), next = Math.min(k + 1, values.length - 1);
  const span = motion.time[next] - motion.time[k];
  return values[k] + (span > 0 ? Math.min(1, Math.max(0, (t - motion.time[k]) / span)) : 0) * (values[next] - values[k]);
}

const ends = (values) => values.reduce(([low, high], x) => [Math.min(low, x), Math.max(high, x)], [Infinity, -Infinity]);

/** Whether there is a drawing of a motion's machine. */
export const isDrawn = (motion) => Boolean(motion?.states && (("x1" in motion.states && "x2" in motion.states) || "x4" in motion.states));

function spring(c, x0, x1, y, coils, size, upright = false) {
  const at = (u, w) => (upright ? [y + w, u] : [u, y + w]), lead = Math.min(10, Math.abs(x1 - x0) / 6) * Math.sign(x1 - x0);
  c.beginPath();
  c.moveTo(...at(x0, 0));
  c.lineTo(...at(x0 + lead, 0));
  for (let k = 0; k < 2 * coils; k++) c.lineTo(...at(x0 + lead + ((k + 0.5) / (2 * coils)) * (x1 - x0 - 2 * lead), (k % 2 ? 1 : -1) * size));
  c.lineTo(...at(x1 - lead, 0));
  c.lineTo(...at(x1, 0));
  c.stroke();
}

function block(c, ink, x, y, w, h, colour, text) {
  c.fillStyle = colour;
  c.fillRect(x, y, w, h);
  c.strokeStyle = ink.ink;
  c.strokeRect(x, y, w, h);
  c.fillStyle = "#ffffff";
  c.font = "600 17px system-ui, sans-serif";
  c.textAlign = "center";
  c.textBaseline = "middle";
  c.fillText(text, x + w / 2, y + h / 2);
}

function drawDrill(c, ink, motion, t, { v = 0, delta = 0, strikes = true }) {
  const { states } = motion, flags = motion.flags[sampleAt(motion, t)], [low1, high1] = ends(states.x1), [low2, high2] = ends(states.x2);
  const scale = 58 / Math.max(Math.abs(low1), Math.abs(high1), Math.abs(low2), Math.abs(high2), 1e-9);
  const x1 = stateAt(motion, "x1", t) * scale, position = stateAt(motion, "x2", t), x2 = position * scale;
  const drop = strikes ? 75 / Math.max(delta - low2, 1e-9) : scale, bottom = 214 + Math.min(10, (position - delta) * drop);
  const stuck = Boolean(flags & STUCK), touching = strikes && Boolean(flags & TOUCHING);
  c.lineWidth = 2;
  c.fillStyle = ink.rock;
  c.globalAlpha = 0.55;
  c.fillRect(10, 390, 690, 30);
  c.globalAlpha = 1;
  c.strokeStyle = ink.ink;
  c.beginPath();
  c.moveTo(10, 390); c.lineTo(700, 390);
  const pitch = 46, shift = (v * t * scale) % pitch;
  for (let x = 700 - shift + pitch; x > 10; x -= pitch) if (x < 700) { c.moveTo(x, 390); c.lineTo(Math.max(x - 14, 10), 418); }
  c.stroke();
  c.fillStyle = ink.faint;
  c.globalAlpha = 0.35;
  c.beginPath();
  for (const [k, point] of [[640, 60], [640, 378], [672, 378], [672, 30], [470, 30], [470, 60]].entries()) if (k) c.lineTo(...point); else c.moveTo(...point);
  c.closePath();
  c.fill();
  c.globalAlpha = 1;
  c.stroke();
  // The lever turns on a pin of the drive: its lower end goes along by x2, its other end down.
  const tilt = -x2 / 175, pin = [542, 130], low = [pin[0] - 175 * Math.sin(tilt), pin[1] + 175 * Math.cos(tilt)];
  c.beginPath();
  c.moveTo(522, 60); c.lineTo(pin[0], pin[1]); c.lineTo(562, 60);
  c.stroke();
  c.lineWidth = 7;
  c.beginPath();
  c.moveTo(367, bottom - 34); c.lineTo(...pin); c.lineTo(...low);
  c.stroke();
  c.lineWidth = 2;
  const right = 450 + x1;
  spring(c, right, low[0], low[1], 5, 8);
  spring(c, right, 640, 360, 7, 9);
  spring(c, low[0], 640, low[1], 2, 5);
  const top = Math.min(262, Math.max(214, bottom));
  if (strikes) {
    c.strokeStyle = touching ? ink.impact : ink.ink;
    c.lineWidth = touching ? 4 : 2;
    spring(c, top, 262, 375 + x1, 3, 9, true);
    c.beginPath();
    c.moveTo(345 + x1, top); c.lineTo(405 + x1, top);
    c.stroke();
    c.lineWidth = 2;
  }
  block(c, ink, 325, bottom - 62, 84, 62, "#b65209", "striker");
  block(c, ink, 300 + x1, 262, 150, 128, "#00598c", "bit");
  if (stuck) {
    c.strokeStyle = ink.stick;
    c.lineWidth = 6;
    c.beginPath();
    c.moveTo(300 + x1, 390); c.lineTo(450 + x1, 390);
    c.stroke();
  }
  c.fillStyle = touching ? ink.impact : ink.ink;
  c.font = "17px system-ui, sans-serif";
  c.textAlign = "left";
  c.fillText(touching ? "impact" : stuck ? "the bit sticks to the rock" : "the bit slides", 20, 366);
}

/** The bit on the hole's ground, at a scale of its own. */
function drawHole(c, ink, motion, t, left, wide) {
  const bit = stateAt(motion, "x3", t), hole = stateAt(motion, "x4", t), [low, high] = ends([...motion.states.x3, ...motion.states.x4]);
  const y = (x) => 150 + ((x - low) / (high - low || 1)) * 190;
  c.fillStyle = ink.rock;
  c.globalAlpha = 0.55;
  c.fillRect(left, y(hole), wide, HIGH - 5 - y(hole));
  c.globalAlpha = 1;
  c.lineWidth = 2;
  c.strokeStyle = ink.ink;
  c.beginPath();
  c.moveTo(left, y(hole)); c.lineTo(left + wide, y(hole));
  c.stroke();
  block(c, ink, left + wide / 2 - 55, y(bit) - 80, 110, 80, "#00598c", "bit");
  c.fillStyle = ink.ink;
  c.font = "17px system-ui, sans-serif";
  c.textAlign = "center";
  c.fillText("hole, enlarged", left + wide / 2, 30);
}

export function drawMachine(canvas, motion, t, about) {
  const ink = inkOf(canvas), { context: c, width, height } = prepared(canvas), { states } = motion;
  const drill = "x1" in states && "x2" in states, hole = "x4" in states, units = (drill ? WIDE : 0) + (hole ? 200 : 0);
  const scale = Math.min(width / units, height / HIGH);
  c.save();
  c.translate((width - units * scale) / 2, (height - HIGH * scale) / 2);
  c.scale(scale, scale);
  c.lineJoin = "round";
  if (drill) drawDrill(c, ink, motion, t, about);
  if (hole) drawHole(c, ink, motion, t, drill ? WIDE + 10 : 0, 180);
  c.restore();
}
