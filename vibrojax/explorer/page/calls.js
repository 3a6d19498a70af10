// The command line and the Python call that simulate a cell. They are made to be copied and run, and the data of a page
// may come from anywhere: what is written here is a name of the scene, a finite number or a known word.
// vibrojax/explorer/document.py gives no others; they are checked here again.

const NAME = /^[A-Za-z_][A-Za-z0-9_]*$/, WORD = /^[A-Za-z][A-Za-z0-9_-]*$/, NUMBERS = /^\[[-+0-9.eE, ]*\]$/;

const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
const number = (value) => String(Number(value.toPrecision(10)));
const written = (value) => (isNumber(value) ? number(value) : value);
const literal = (value) => (isNumber(value) ? number(value) : value.startsWith("[") ? value : `"${value}"`);
const shell = (word) => (/^[A-Za-z0-9_=.,:+-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

/** Whether a parameter and its value may be written. */
function allowed(run, name, value) {
  if (name === "rock") return run.rocks.includes(value) && WORD.test(value);
  return NAME.test(name) && run.names.includes(name) && isNumber(value);
}

/** A start as it may be written: a word of the scene, or numbers for its states; null for any other. */
function startText(run, start) {
  if (typeof start === "string" && run.starts.includes(start) && WORD.test(start)) return start;
  let vector = start;
  if (typeof start === "string") vector = NUMBERS.test(start) ? start.slice(1, -1).split(",").map(Number) : null;
  if (!Array.isArray(vector) || vector.length !== run.states.length || !vector.every(isNumber)) return null;
  return vector.length ? `[${vector.join(", ")}]` : null;
}

/** Parameters that are not the defaults, and the start, null for the scene's own. */
function givenOf(run, own, point) {
  const given = new Map(Object.entries(run.parameters)), ofScene = (name) => run.names.includes(name);
  for (const [name, value] of Object.entries(own)) if (ofScene(name) || name === "rock") given.set(name, value);
  if (point) {
    for (const name of [...given.keys()]) if (ofScene(name) || name === "rock") given.delete(name);
    for (const [name, value] of Object.entries(point.parameters)) given.set(name, value);
    return { given, start: point.start };
  }
  const vector = run.states.map((name) => own[`start_${name}`]);
  return { given, start: vector.length && vector.every(isNumber) ? vector : own.start ?? run.start };
}

/**
 * {command, python} of a cell, null where no name stands for its scene. run: of the document. own: the cell's
 * coordinates by name. point: {parameters, start} of a motion beside the cell, if one is shown.
 */
export function callsOf({ run }, own, point) {
  if (!run || run.own_scene || !WORD.test(run.scene) || !isNumber(run.duration)) return null;
  const { given, start } = givenOf(run, own, point), chosen = startText(run, start);
  const args = [
    ...[...given].filter(([name, value]) => allowed(run, name, value)),
    ...Object.entries(run.options).filter(([name, value]) => NAME.test(name) && WORD.test(value)),
    ...(chosen === null ? [] : [["start", chosen]]),
    ["duration", run.duration],
  ];
  const words = args.map(([name, value]) => shell(`${name}=${String(written(value)).replaceAll(" ", "")}`));
  return {
    command: ["vibrojax", "simulate", run.scene, ...words].join(" "),
    python: `vj.simulate("${run.scene}", ${args.map(([name, value]) => `${name}=${literal(value)}`).join(", ")})`,
  };
}
