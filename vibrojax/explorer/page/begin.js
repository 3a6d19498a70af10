// What the file and the served page have in common: what the page holds is mounted, and the fragment kept.
import { embeddedSource } from "./decode.js";
import { mount } from "./mount.js";

export const held = JSON.parse(document.getElementById("vibrojax-data").textContent);

/** The source of the motions that the page holds, if it holds any. */
export function heldSource() {
  if (!held.cells) return {};
  // The cells come last in the file: the map is drawn before they have been read.
  const whole = new Promise((done) => { if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", done); else done(); });
  return embeddedSource(async () => { await whole; return document.getElementById("vibrojax-cells").textContent; }, held.cells.size);
}

export async function begin(source) {
  const element = document.getElementById("vibrojax");
  let told = location.hash, began = false, last = 0;
  try {
    const page = await mount(element, {
      data: held,
      source,
      state: location.hash,
      // Back leads to the cell that was chosen before; of a quick run of keys to that before the run.
      onState: (state, picked) => {
        const now = performance.now(), adds = picked && began && now - last > 700;
        if (picked) last = now;
        if (told === `#${state}`) return;
        told = `#${state}`;
        history[adds ? "pushState" : "replaceState"](null, "", told);
      },
    });
    began = true;
    window.vibrojax = page;  // for who wants to go on from here in the browser's console
    window.addEventListener("hashchange", async () => {
      if (location.hash === told) return;
      page.restore(location.hash);
      await page.show({});
      told = location.hash;
      await page.pick(page.cell);
      await page.pins.restore(new URLSearchParams(location.hash.slice(1)).get("pins"));
    });
  } catch (error) {
    element.textContent = `The page cannot be shown: ${error.message}`;
    throw error;
  }
}
