// What is chosen, as it stands in the fragment of an address, to and fro.
import { leastOf } from "./plots.js";

const byValue = (axis) => axis.numeric && !axis.columns.length;

/** The fragment, without its #, of {shown, cell, scheme, pins, zoom, zooms} of a page; a scheme only where one was chosen. */
export function fragmentOf(data, { shown, cell, scheme, pins, zoom, zooms = [] }) {
  const parts = [["variable", shown.variable]];
  if (shown.x) parts.push(["x", shown.x], ["y", shown.y ?? ""]);
  for (const axis of data.axes) {
    const k = cell[axis.name];
    if (axis.values.length > 1) parts.push([`at.${axis.name}`, byValue(axis) ? Number(axis.values[k].toPrecision(8)) : k]);
  }
  if (shown.only) parts.push(["only", shown.only]);
  if (!shown.region) parts.push(["region", "off"]);
  if (data.curves) parts.push(["borders", shown.borders]);
  if (pins) parts.push(["pins", pins]);
  [zoom, ...zooms].forEach((one, k) => { if (one) parts.push([k ? `zoom.${k - 1}` : "zoom", one.flat().map((end) => Number(end.toPrecision(6))).join("_")]); });
  if (scheme) parts.push(["scheme", scheme]);
  return parts.map(([name, value]) => `${name}=${encodeURIComponent(value)}`).join("&");
}

/** What a fragment says: {variable, x, y, cell, region, borders, zoom, zooms: of plots by number, scheme}, null or left out what it does not say. */
export function readFragment(data, text) {
  const given = new URLSearchParams(text.replace(/^#/, "")), cell = {};
  for (const axis of data.axes) {
    const said = given.get(`at.${axis.name}`), value = Number(said);
    if (said === null || said === "" || !Number.isFinite(value)) continue;
    cell[axis.name] = byValue(axis) ? leastOf(axis.values.map((one) => Math.abs(one - value))) : Math.max(0, Math.min(axis.values.length - 1, Math.round(value)));
  }
  const limits = (text) => {
    const [left, right, low, high] = (text ?? "").split("_").map(Number);
    return left < right && low < high ? [[left, right], [low, high]] : null;
  };
  const oneOf = (name, known) => (known.includes(given.get(name)) ? given.get(name) : null);
  return {
    variable: given.get("variable"), x: given.get("x"), y: given.get("y"), cell,
    region: given.get("region") !== "off",
    only: /^(stable|(stable )?\d+)$/.test(given.get("only") ?? "") ? given.get("only") : "",
    borders: oneOf("borders", ["own", "any", "off"]),
    scheme: oneOf("scheme", ["dark", "light"]),
    zoom: limits(given.get("zoom")),
    zooms: Object.fromEntries([...given].filter(([name]) => /^zoom\.\d+$/.test(name)).map(([name, text]) => [name.slice(5), limits(text)])),
    pins: given.get("pins") ?? "",
  };
}
