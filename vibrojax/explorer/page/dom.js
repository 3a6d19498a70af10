// Elements of the page.

/** An element with attributes (`text`: its text, `on...`: a listener; none where false or null) and children. */
export const el = (tag, attributes = {}, ...children) => {
  const one = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "text") write(one, value);
    else if (name === "style") one.style.cssText = value;  // as an attribute, the page's policy would refuse it
    else if (name.startsWith("on")) one.addEventListener(name.slice(2), value);
    else if (value === true) one.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) one.setAttribute(name, value);
  }
  one.append(...children);
  return one;
};

/** The parts of a text around the indices of symbols such as v_cr: what is before, the symbol, its index, and so on. */
export const indexed = (text) => String(text ?? "").split(/(?<![\p{L}\d_])(\p{L})_([a-z]{1,3})(?![\p{L}\d_])/u);

/** Write a text into an element, with lowered indices except in code. */
export function write(one, text) {
  if (/^(code|option|title)$/i.test(one.tagName)) one.textContent = text;
  else one.replaceChildren(...indexed(text).map((part, k) => (k % 3 === 2 ? el("sub", { text: part }) : part)));
}

/** Where an event is in an element. */
export const placeIn = (one, { clientX, clientY }) => { const { left, top } = one.getBoundingClientRect(); return [clientX - left, clientY - top]; };

let tips = 0;

/** An element with a sentence that is shown where it is pointed at or has the focus; unchanged without a sentence. */
export function explained(one, sentence) {
  if (!sentence) return one;
  const id = `vx-why${++tips}`;
  one.classList.add("vx-why");
  one.tabIndex = 0;
  one.setAttribute("aria-describedby", id);
  one.append(el("span", { class: "vx-sentence", role: "tooltip", id, text: sentence }));
  return one;
}
