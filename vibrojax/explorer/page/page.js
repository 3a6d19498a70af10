// The self-contained page: what it holds is mounted, and the fragment kept.
import { embeddedSource } from "./decode.js";
import { mount } from "./mount.js";

const data = JSON.parse(document.getElementById("vibrojax-data").textContent);
const cells = document.getElementById("vibrojax-cells");
const source = data.cells ? embeddedSource(() => cells.textContent, data.cells.size) : {};
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
