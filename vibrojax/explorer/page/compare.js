// Pinned motions: up to four, drawn with the chosen one, their numbers beside its own.
import { el } from "./dom.js";

const PIN_COLOURS = ["#b5468b", "#1a9850", "#7b5cd6", "#c98a00"];

/** A cell as it stands in an address, its indices over the axes, and back; null for one that is not of the dataset. */
const cellText = (data, cell) => data.axes.map((axis) => cell[axis.name] ?? 0).join(".");
function cellOf(data, text) {
  const indices = text.split(".").map(Number);
  const fits = indices.length === data.axes.length && data.axes.every((axis, k) => Number.isInteger(indices[k]) && indices[k] >= 0 && indices[k] < axis.values.length);
  return fits ? Object.fromEntries(data.axes.map((axis, k) => [axis.name, indices[k]])) : null;
}

export class Pins {
  constructor(page) {
    this.page = page;
    this.list = [];
    this.element = el("div", { class: "vx-pins", role: "group", "aria-label": "Pinned motions", hidden: true });
  }

  /** What stands in the fragment: the pinned cells. */
  get state() { return this.list.filter((pin) => pin.cell).map((pin) => cellText(this.page.data, pin.cell)).join("_"); }

  /** The pin of the motion that is shown, if it is pinned. */
  get here() { return this.list.find((pin) => pin.motion === this.page.current?.motion) ?? null; }

  /** The numbers of a motion, or of a lane, by name. */
  valuesOf(motion) {
    const cells = this.page.numbers(motion, []).querySelectorAll("td[data-value]");
    return Object.fromEntries([...cells].map((one) => [one.dataset.name, Number(one.dataset.value)]));
  }

  add(motion, title, cell) {
    const colour = PIN_COLOURS.find((one) => !this.list.some((pin) => pin.colour === one));
    if (colour) this.list.push({ motion, title, cell, colour, values: this.valuesOf(motion) });
  }

  /** Pin the motion that is shown, or take its pin away. */
  toggle() {
    const { page, here } = this;
    if (here) this.list = this.list.filter((pin) => pin !== here);
    else this.add(page.current.motion, page.titleOf(), page.point ? null : { ...page.cell });
    this.changed();
  }

  /** The motions of the cells that a fragment names. */
  async restore(text) {
    const { page } = this, before = page.cell, wanted = (text ?? "").split("_").map((one) => cellOf(page.data, one)).filter(Boolean);
    if (text === this.state) return;
    this.list = [];
    for (const cell of wanted.slice(0, PIN_COLOURS.length)) {
      const lane = page.grid.lane(cell), motion = lane >= 0 ? await page.source.cell?.(lane) : null;
      if (!motion || motion.kind === "none") continue;
      page.cell = cell;
      this.add(motion, page.titleOf(), cell);
      page.cell = before;
    }
    this.changed();
  }

  changed() {
    const { page } = this;
    this.element.hidden = !this.list.length;
    this.element.replaceChildren(el("span", { text: "Pinned:" }), ...this.list.map((pin) => {
      const remove = el("button", { type: "button", text: "×", "aria-label": `Unpin ${pin.title}`, onclick: () => { this.list = this.list.filter((one) => one !== pin); this.changed(); } });
      const name = pin.cell ? el("button", { type: "button", class: "vx-goto", text: pin.title, onclick: () => page.pick(pin.cell) }) : pin.title;
      return el("span", { class: "vx-pin" }, el("span", { class: "vx-swatch", style: `background:${pin.colour}` }), name, remove);
    }));
    if (page.current) page.showMotion(page.current.motion);
    page.tell();
  }

  /** The button that pins the motion that is shown. */
  button() {
    const { here } = this, full = !here && this.list.length >= PIN_COLOURS.length;
    return el("button", { type: "button", class: "vx-copy vx-pinbutton", "aria-pressed": here ? "true" : "false", disabled: full,
      title: full ? "Four motions are pinned" : "Keep this motion to compare others with it", text: here ? "Unpin" : "Pin", onclick: () => { this.toggle(); this.page.side.querySelector(".vx-pinbutton")?.focus(); } });
  }
}
