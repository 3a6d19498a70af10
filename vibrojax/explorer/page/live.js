// Sources of motions that are computed when they are asked for: by a server (--live), or by a notebook's kernel.
// Beside `cell(lane)` and `motion(parameters, start)`, promises of a cell (see encoding.py), such a source has
// `attach(page)`, by which the page shows sliders.

import { decodeCells } from "./decode.js";
import { Computing } from "./computing.js";

/** What a question is refused with that a newer one has overtaken; nothing is to be said of it. */
export class Overtaken extends Error {
  constructor() { super("overtaken by a newer question"); }
}

/**
 * Of many quick questions the newest: one is under way, one waits, and those between are refused as overtaken.
 * `ask(question, number)` gives a promise; after `patience` milliseconds the next is asked without waiting for it.
 */
export function newest(ask, patience = 400) {
  let number = 0, underway = 0, began = 0, waiting = null, timer = 0;
  const next = () => {
    clearTimeout(timer);
    if (!waiting) return;
    const left = underway ? began + patience - performance.now() : 0;
    if (left === Infinity) return;
    if (left > 0) { timer = setTimeout(next, left); return; }
    const { question, resolve, reject } = waiting, mine = ++number;
    waiting = null;
    underway++;
    began = performance.now();
    ask(question, mine)
      .then((answer) => (mine === number ? resolve(answer) : reject(new Overtaken())), reject)
      .finally(() => { underway--; next(); });
  };
  return (question) => new Promise((resolve, reject) => {
    waiting?.reject(new Overtaken());
    waiting = { question, resolve, reject };
    next();
  });
}

/** The source of what `offered` says, by `ask(question, number)`, a promise of a block of one cell. */
export function askingSource(offered, ask, patience) {
  const read = (question, answer) => (question.box ? JSON.parse(new TextDecoder().decode(answer)) : decodeCells(answer)[0]);
  const asked = newest(async (question, number) => read(question, await ask(question, number)), patience);
  const source = {
    cell: (lane) => asked({ lane }),
    motion: (parameters, start) => asked({ parameters, start }),
    attach: (page) => new Computing(page, offered, source.motion),
  };
  if (offered.lanes) source.box = (box, lane) => asked({ box, lane });
  else delete source.cell;
  return source;
}

const pause = (seconds) => new Promise((done) => setTimeout(done, 1000 * seconds));

/** The source that asks the server whose page this is. */
export function serverSource(offered, address = "motion") {
  const client = `${Math.random()}`.slice(2) + Date.now();
  return askingSource(offered, async (question, number) => {
    for (;;) {
      const body = JSON.stringify({ client, number, ...question });
      let answer;
      try {
        answer = await fetch(address, { method: "POST", headers: { "Content-Type": "application/json" }, body });
      } catch {
        throw new Error("the server does not answer; it may have been stopped");
      }
      if (answer.ok) return answer.arrayBuffer();
      if (answer.status === 409) throw new Overtaken();
      if (answer.status !== 503) throw new Error((await answer.json()).error);
      await pause(Number(answer.headers.get("Retry-After")) || 1);
    }
  });
}
