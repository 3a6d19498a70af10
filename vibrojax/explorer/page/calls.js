// The command line and the Python call that simulate a cell.

const number = (value) => (typeof value === "number" ? String(Number(value.toPrecision(10))) : value);
const literal = (value) => (typeof value === "number" ? number(value) : value.startsWith("[") ? value : JSON.stringify(value));
const shell = (word) => (/^[\w=.,:+-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

/** Parameters that are not the defaults, and the start, null for the scene's own. */
function givenOf(run, own, point) {
  const given = { ...run.parameters }, ofScene = (name) => (run.names ?? []).includes(name);
  for (const [name, value] of Object.entries(own)) if (ofScene(name) || name === "rock") given[name] = value;
  if ("rpm" in own) {
    given.rpm = own.rpm;
    if ("bit_radius" in own) given.bit_radius = own.bit_radius;
  }
  if (point) {
    for (const name of Object.keys(given)) if (ofScene(name) || ["rock", "rpm", "bit_radius"].includes(name)) delete given[name];
    return { given: Object.assign(given, point.parameters), start: point.start };
  }
  const states = run.states ?? [], vector = states.map((name) => own[`start_${name}`]);
  const isVector = states.length && vector.every((x) => typeof x === "number");
  return { given, start: isVector ? `[${vector.join(", ")}]` : own.start ?? run.start ?? null };
}

/**
 * {command, python} of a cell. run, scene: of the document. own: the cell's coordinates by name.
 * point: {parameters, start} of a motion beside the cell, if one is shown.
 */
export function callsOf({ run, scene }, own, point) {
  const { given, start } = givenOf(run, own, point), options = Object.entries(run.options), hasStart = typeof start === "string";
  const words = [
    ...Object.entries(given).map(([name, value]) => `${name}=${number(value)}`),
    ...options.map(([name, value]) => `${name}=${value}`),
    ...(hasStart ? [`start=${start.replaceAll(" ", "")}`] : []),
    `duration=${run.duration}`,
  ];
  const args = [...Object.entries(given), ...options, ...(hasStart ? [["start", start]] : []), ["duration", run.duration]];
  return {
    command: ["vibrojax", "simulate", scene, ...words].map(shell).join(" "),
    python: `vj.simulate(${JSON.stringify(scene)}, ${args.map(([name, value]) => `${name}=${literal(value)}`).join(", ")})`,
  };
}
