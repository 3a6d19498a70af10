// Sources of motions that are computed when they are asked for: by a server (--live), or by a notebook's kernel.
// A source has `offered` (what may be asked for) and `motion(parameters, start)`, a promise of a cell (see cells.py).

import { decodeCells } from "./decode.js";

/** What a question is refused with that a newer one has overtaken; nothing to be said of it. */
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

const pause = (seconds) => new Promise((done) => setTimeout(done, 1000 * seconds));

/** The source that asks the server whose page this is. */
export function serverSource(offered, address = "motion") {
  const client = `${Math.random()}`.slice(2) + Date.now();
  const ask = async ({ parameters, start }, number) => {
    for (;;) {
      const body = JSON.stringify({ client, number, parameters, start });
      let answer;
      try {
        answer = await fetch(address, { method: "POST", headers: { "Content-Type": "application/json" }, body });
      } catch {
        throw new Error("the server does not answer; it may have been stopped");
      }
      if (answer.ok) return decodeCells(await answer.arrayBuffer())[0];
      if (answer.status === 409) throw new Overtaken();
      if (answer.status !== 503) throw new Error((await answer.json()).error);
      await pause(Number(answer.headers.get("Retry-After")) || 1);
    }
  };
  const asked = newest(ask);
  return { offered, motion: (parameters, start) => asked({ parameters, start }) };
}
