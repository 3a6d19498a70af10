// What a page does that can compute: sliders beside the chosen cell, and the motion at what they say.
import { unpack } from "./decode.js";
import { edgesOf } from "./grid.js";
import { numberText } from "./plots.js";
import { Sliders } from "./sliders.js";

export class Computing {
  /** `page`: whose chosen cell it is; `offered`, `motion`: of the source. */
  constructor(page, offered, motion) {
    Object.assign(this, { page, offered, motion, at: { ...offered.values }, from: offered.start });
    this.sliders = new Sliders(offered, (parameters, start) => this.compute(parameters, start));
    this.sliders.back.addEventListener("click", () => page.pick(page.cell));
    this.element = this.sliders.element;
  }

  /** Stand at the point of a cell that is no lane, of which the coordinates are given by name. */
  stand(own) {
    const { offered } = this, values = { ...offered.values, ...offered.rocks?.[own.rock] };
    for (const name of Object.keys(offered.values)) if (typeof own[name] === "number") values[name] = own[name];
    const vector = offered.states.map((name) => own[`start_${name}`]);
    this.place(values, vector.length && vector.every((x) => typeof x === "number") ? vector : own.start ?? offered.start);
  }

  /** Stand at a point. Of a lane, whose coordinates may replace parameters, the source says the parameters. */
  place(values, start) {
    Object.assign(this, { at: values, from: start });
    this.sliders.set(values, start);
    this.sliders.say("");
  }

  /** The motion at the cell's point; its numbers are the dataset's. */
  async here() { return { ...(await this.motion(this.at, this.from)), numbers: undefined }; }

  async compute(parameters, start) {
    const { page } = this, number = ++page.asked, began = performance.now();
    try {
      const motion = await this.motion(parameters, start);
      if (number !== page.asked) return;
      page.showPoint({ title: this.title(parameters, start), parameters: this.given(parameters), start }, motion);
      this.sliders.say(`simulated in ${Math.round(performance.now() - began)} ms`);
    } catch (error) {
      if (number === page.asked) this.sliders.say(error.message, true);
    }
  }

  /** The motion at other values of some parameters than the chosen cell's. */
  beside(values) {
    const parameters = { ...this.at, ...values };
    this.sliders.set(parameters, this.from);
    return this.compute(parameters, this.from);
  }

  /** Compute the part of the map that is zoomed into, at the chosen cell's other coordinates. */
  async box(zoom) {
    const { page } = this, { x, y } = page.view.view, lane = page.grid.lane(page.cell);
    page.patch = null;
    if (!zoom || !page.source.box || !y || lane < 0 || x.column !== x.axis || !x.axis.numeric || !y.axis.numeric) { page.draw(); return; }
    const at = page.facetKey(), limits = (way, [low, high]) => {
      const { edges } = edgesOf(way.column), ends = [Math.min(edges[0], edges.at(-1)), Math.max(edges[0], edges.at(-1))];
      return [Math.max(low, ends[0]) / way.column.factor, Math.min(high, ends[1]) / way.column.factor].sort((a, b) => a - b);
    };
    this.sliders.say("computing the box …");
    const began = performance.now();
    try {
      const answer = await page.source.box({ [x.axis.name]: limits(x, zoom[0]), [y.axis.name]: limits(y, zoom[1]) }, lane);
      const variables = new Map();
      for (const [name, packed] of Object.entries(answer.variables)) variables.set(name, await unpack(packed));
      page.patch = { axes: answer.axes, variables, at };
      this.sliders.say(`the box was computed in ${numberText((performance.now() - began) / 1000, 2)} s`);
      page.draw();
    } catch (error) {
      this.sliders.say(error.message, true);
    }
  }

  /** In words what differs from the chosen cell. */
  title(parameters, start) {
    const changed = this.offered.parameters.filter(({ name }) => parameters[name] !== this.at[name]);
    const texts = changed.map(({ name, symbol, factor, units }) => `${symbol} = ${numberText(parameters[name] * factor, 4)} ${units}`.trim());
    if (JSON.stringify(start) !== JSON.stringify(this.from)) texts.push(`start ${Array.isArray(start) ? `[${start.join(", ")}]` : start}`);
    return texts.length ? `With ${texts.join(", ")}` : "";
  }

  given(parameters) {
    const usual = new Map(this.offered.parameters.map((one) => [one.name, one.default]));
    return Object.fromEntries(Object.entries(parameters).filter(([name, value]) => value !== usual.get(name)));
  }
}
