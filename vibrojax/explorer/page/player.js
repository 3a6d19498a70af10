// The cursor in time of the motion that is shown: the machine at that moment, and a mark in every plot.
import { shownIn } from "./cell.js";
import { el } from "./dom.js";
import { drawMachine, isDrawn } from "./machine.js";
import { numberText } from "./plots.js";

const SPEEDS = [["1", "as fast as it is"], ["0.25", "4 times slower"], ["0.1", "10 times slower"], ["0.02", "50 times slower"]];
const PLAY_STEPS = 1000, STEPS_OF_CYCLE = 24;

export class Player {
  constructor(page) {
    Object.assign(this, { page, time: 0, speed: 0.1, motion: null, panels: [], frame: 0 });
    this.calm = window.matchMedia("(prefers-reduced-motion: reduce)");
    this.onCalm = () => { this.stop(); this.name(); };
    this.calm.addEventListener("change", this.onCalm);
    this.canvas = el("canvas", { class: "vx-drawing", role: "img", "aria-label": "The machine at the cursor: rock, bit, springs and striker" });
    this.button = el("button", { type: "button", class: "vx-play", onclick: () => this.toggle() });
    this.pace = el("select", { "aria-label": "Speed of the animation", onchange: (event) => { this.speed = Number(event.target.value); } },
      ...SPEEDS.map(([value, text]) => el("option", { value, text, selected: Number(value) === this.speed })));
    this.range = el("input", { type: "range", min: 0, max: PLAY_STEPS, value: 0, "aria-label": "Time of the cursor",
      oninput: (event) => this.to((Number(event.target.value) / PLAY_STEPS) * this.motion.duration) });
    this.said = el("output", { class: "vx-time" });
    this.element = el("section", { class: "vx-machine", "aria-label": "The machine in motion", hidden: true },
      this.canvas, el("div", { class: "vx-playbar" }, this.button, this.range, this.said, this.pace));
    let from = null;
    this.canvas.addEventListener("pointerdown", (event) => { from = { x: event.clientX, time: this.time }; this.canvas.setPointerCapture(event.pointerId); });
    this.canvas.addEventListener("pointermove", (event) => {
      if (from) this.to(from.time + ((event.clientX - from.x) / this.canvas.clientWidth) * this.motion.duration);
    });
    for (const name of ["pointerup", "pointercancel"]) this.canvas.addEventListener(name, () => { from = null; });
    this.name();
  }

  get playing() { return this.frame !== 0; }

  name() {
    this.button.textContent = this.playing ? "Pause" : this.calm.matches ? "Step" : "Play";
  }

  /** Show another motion; `panels` have `cursor(time)`. */
  set(motion, panels) {
    const moves = motion && motion.kind !== "none" && motion.duration > 0;
    Object.assign(this, { motion: moves ? motion : null, panels });
    this.element.hidden = !moves;
    this.canvas.hidden = !isDrawn(motion);
    if (!moves) this.stop();
    else if (this.time > motion.duration) this.time %= motion.duration;
  }

  toggle() {
    if (this.calm.matches) this.to(this.time + this.motion.duration / STEPS_OF_CYCLE);
    else if (this.playing) this.stop();
    else this.play();
  }

  play() {
    let before = performance.now();
    const next = (now) => {
      this.frame = requestAnimationFrame(next);
      this.to(this.time + (Math.min(100, now - before) / 1000) * this.speed);
      before = now;
    };
    this.frame = requestAnimationFrame(next);
    this.name();
  }

  stop() {
    cancelAnimationFrame(this.frame);
    this.frame = 0;
    this.name();
  }

  to(time) {
    const { motion } = this;
    if (!motion) return;
    this.time = ((time % motion.duration) + motion.duration) % motion.duration;
    this.draw();
  }

  draw() {
    const { motion, time } = this;
    if (!motion) return;
    const [factor, unit] = shownIn("s", [motion.duration]);
    this.range.value = Math.round((time / motion.duration) * PLAY_STEPS);
    this.said.textContent = `${numberText(time * factor, 3)} ${unit}`;
    this.range.setAttribute("aria-valuetext", this.said.textContent);
    if (!this.canvas.hidden) drawMachine(this.canvas, motion, time, this.page.machineOf());
    for (const panel of this.panels) panel.cursor?.(time);
  }

  destroy() {
    this.stop();
    this.calm.removeEventListener("change", this.onCalm);
  }
}
