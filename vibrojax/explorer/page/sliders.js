// Sliders and numbers for what a source that computes may be asked for: every parameter of the scene, and the start.
import { el } from "./dom.js";
import { numberText } from "./plots.js";

const STEPS = 1000;
const VECTOR = "a state";

/** Where a value stands between the ends of a slider, from 0 to STEPS, and back. */
const placed = ({ low, high, log }, value) => {
  const share = log ? Math.log(Math.max(value, low) / low) / Math.log(high / low) : (value - low) / (high - low);
  return Math.round(STEPS * Math.min(1, Math.max(0, share)));
};
const valueAt = ({ low, high, log }, place) => {
  const share = place / STEPS, value = log ? low * (high / low) ** share : low + (high - low) * share;
  return Number(value.toPrecision(4));
};

let forms = 0;

/** A form of them; `onChange(parameters, start)`, in SI, hears of each change. */
export class Sliders {
  constructor(offered, onChange) {
    Object.assign(this, { offered, onChange, id: `vx-s${++forms}`, values: { ...offered.values }, start: offered.start });
    this.rows = new Map(offered.parameters.map((one) => [one.name, this.row(one)]));
    this.said = el("span", { class: "vx-said", role: "status" });
    this.back = el("button", { type: "button", class: "vx-copy", text: "back to the cell" });
    const rows = [...this.rows.values()].map(({ element }) => element);
    this.element = el("details", { class: "vx-sliders", open: true },
      el("summary", { text: `Simulate, for ${offered.duration} s${offered.whole > offered.duration ? ` of ${numberText(offered.whole)} s` : ""}` }),
      el("div", { class: "vx-asked" }, ...this.startControls(), this.back, this.said), el("div", { class: "vx-rows" }, ...rows));
    this.set(offered.values, offered.start);
  }

  row(one) {
    const range = el("input", { type: "range", min: 0, max: STEPS, step: 1, id: `${this.id}-${one.name}`, "data-parameter": one.name });
    const number = el("input", { type: "number", step: "any", name: one.name, "aria-label": one.units ? `${one.label} [${one.units}]` : one.label });
    const label = el("label", { for: range.id, title: one.label },
      el("span", { text: `${one.symbol} ` }, el("small", { text: one.label.replace(/ \(.*/, "") })), el("small", { text: one.units }));
    range.addEventListener("input", () => this.change(one, valueAt(one, Number(range.value)), range));
    number.addEventListener("input", () => {
      const value = Number(number.value);
      if (number.value.trim() !== "" && Number.isFinite(value)) this.change(one, Number((value / one.factor).toPrecision(12)), number);
    });
    return { element: el("div", { class: "vx-row" }, label, range, number), range, number, one };
  }

  startControls() {
    const { starts, states, state_labels: labels } = this.offered;
    if (!starts.length && !states.length) return [];
    const options = [...starts, ...(states.length ? [VECTOR] : [])];
    this.which = el("select", { id: `${this.id}-start`, onchange: () => this.started() }, ...options.map((text) => el("option", { value: text, text })));
    this.vector = labels.map((label) => el("input", { type: "number", step: "any", value: "0", "aria-label": label, oninput: () => this.started() }));
    this.states = el("span", { class: "vx-vector" }, ...states.flatMap((name, k) => [el("small", { text: ` ${name} ` }), this.vector[k]]));
    return [el("span", {}, el("label", { for: this.which.id, text: "start " }), this.which), this.states];
  }

  started() {
    const states = this.vector.map((one) => (one.value.trim() === "" ? NaN : Number(one.value)));
    this.states.hidden = this.which.value !== VECTOR;
    this.start = this.which.value === VECTOR ? states : this.which.value;
    if (this.which.value !== VECTOR || states.every(Number.isFinite)) this.onChange({ ...this.values }, this.start);
  }

  change(one, value, by) {
    this.values[one.name] = value;
    this.write(one.name, by);
    this.onChange({ ...this.values }, this.start);
  }

  /** Show a parameter's value, but in the input that it is being written in. */
  write(name, by = null) {
    const { range, number, one } = this.rows.get(name), value = this.values[name];
    if (by !== range) range.value = placed(one, value);
    if (by !== number) number.value = String(Number((value * one.factor).toPrecision(6)));
    range.setAttribute("aria-valuetext", `${numberText(value * one.factor, 4)} ${one.units}`.trim());
  }

  /** Stand at a point, in SI; what is not given stays where it is. Nobody hears of it. */
  set(values, start = undefined) {
    for (const name of Object.keys(this.values)) if (typeof values[name] === "number") this.values[name] = values[name];
    for (const name of this.rows.keys()) this.write(name);
    if (start === undefined || start === null || !this.which) return;
    this.start = start;
    this.which.value = typeof start === "string" ? start : VECTOR;
    this.states.hidden = typeof start === "string";
    if (typeof start !== "string") start.forEach((x, k) => { this.vector[k].value = String(Number(x.toPrecision(10))); });
  }

  /** A line below the heading: that something is wrong, or how long the motion took. */
  say(text, wrong = false) {
    this.said.textContent = text;
    this.said.classList.toggle("vx-wrong", wrong);
  }
}
