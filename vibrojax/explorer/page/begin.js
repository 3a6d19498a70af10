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
  let told = location.hash;
  try {
    const page = await mount(element, {
      data: held,
      source,
      state: location.hash,
      onState: (state) => { told = `#${state}`; history.replaceState(null, "", told); },
    });
    window.vibrojax = page;  // for who wants to go on from here in the browser's console
    window.addEventListener("hashchange", async () => {
      if (location.hash === told) return;
      page.restore(location.hash);
      await page.show({});
      await page.pick(page.cell);
    });
  } catch (error) {
    element.textContent = `The page cannot be shown: ${error.message}`;
    throw error;
  }
}
