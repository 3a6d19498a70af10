// The page in a notebook, as anywidget shows it: the chosen cell is the model's, and its kernel computes motions.
import { embeddedSource } from "./decode.js";
import { askingSource } from "./live.js";
import { mount } from "./mount.js";

let views = 0;

/** `ask(question)` of a model's kernel: a promise of a block. */
function kernel(model) {
  const waiting = new Map(), view = `${Math.random()}`.slice(2) + ++views;
  let count = 0;
  const answered = (content, buffers) => {
    const one = waiting.get(content.id);
    if (!one) return;
    waiting.delete(content.id);
    if (content.error) one.reject(new Error(content.error));
    else one.resolve(new Uint8Array(buffers[0].buffer ?? buffers[0], buffers[0].byteOffset ?? 0, buffers[0].byteLength));
  };
  model.on("msg:custom", answered);
  const ask = (question) => new Promise((resolve, reject) => {
    const id = `${view}-${++count}`;
    waiting.set(id, { resolve, reject });
    model.send({ id, ...question });
  });
  return { ask, end: () => model.off("msg:custom", answered) };
}

/** The part of a fragment that says which cell is chosen. */
const places = (data, cell) => data.axes.filter(({ name }) => name in cell)
  .map(({ name, numeric, columns, values }) => `at.${name}=${numeric && !columns.length ? values[cell[name]] : cell[name]}`).join("&");

async function render({ model, el }) {
  const data = model.get("document"), offered = model.get("offered"), blocks = model.get("blocks"), answers = kernel(model);
  const source = data.cells ? embeddedSource(() => blocks.join("\n"), data.cells.size) : {};
  // A kernel may be busy with another cell of the notebook for long: nothing newer is asked until it answers.
  if (offered) Object.assign(source, askingSource(offered, answers.ask, Infinity));
  const element = document.createElement("div");
  element.classList.add("vx-widget");
  el.append(element);
  const page = await mount(element, {
    data,
    source,
    state: `${places(data, model.get("cell"))}&${model.get("fragment")}`,
    onState: (state) => { model.set("fragment", state); model.save_changes(); },
    onPick: ({ cell }) => { model.set("cell", { ...cell }); model.save_changes(); },
  });
  const picked = () => {
    const cell = model.get("cell");
    if (Object.keys(cell).length && JSON.stringify(cell) !== JSON.stringify({ ...page.cell })) page.pick({ ...page.cell, ...cell });
  };
  model.on("change:cell", picked);
  return () => {
    model.off("change:cell", picked);
    answers.end();
    page.destroy();
  };
}

export default { render };
