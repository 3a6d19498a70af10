// The self-contained page: what it holds is mounted, and the fragment kept.
import { embeddedSource } from "./decode.js";
import { mount } from "./mount.js";

const data = JSON.parse(document.getElementById("vibrojax-data").textContent);
// The cells come last in the file: the map is drawn before they have been read.
const whole = new Promise((done) => { if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", done); else done(); });
const cells = async () => { await whole; return document.getElementById("vibrojax-cells").textContent; };
const source = data.cells ? embeddedSource(cells, data.cells.size) : {};
const element = document.getElementById("vibrojax");
const start = async () => {
  let told = location.hash;
  const page = await mount(element, {
    data,
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
};
start().catch((error) => { element.textContent = `The page cannot be shown: ${error.message}`; throw error; });
