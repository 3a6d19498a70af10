// Reads what vibrojax/explorer/encoding.py writes. See there for the form.

export const EVENTS = ["none", "stick", "slip", "impact", "release", "section", "switch", "slide"];
export const STUCK = 8, TOUCHING = 16;

export function bytesOf(base64) {
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

export async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** {dtype, shape, data} as a typed array. */
export async function unpack(one) {
  const planes = await inflated(bytesOf(one.data));
  const width = one.dtype === "i1" ? 1 : 4, count = planes.length / width, bytes = new Uint8Array(planes.length);
  for (let k = 0; k < width; k++) for (let i = 0; i < count; i++) bytes[i * width + k] = planes[k * count + i];
  return new { f4: Float32Array, i1: Int8Array, i4: Int32Array }[one.dtype](bytes.buffer);
}

/** The cells of a block (ArrayBuffer or bytes), or of these the one of a lane; states and section are {name: Float64Array}. */
export function decodeCells(buffer, lane = null) {
  const bytes = buffer instanceof Uint8Array ? buffer : new Uint8Array(buffer);
  const length = new DataView(bytes.buffer, bytes.byteOffset, 4).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
  const { columns, section } = header, wide = 1 + columns.length, payload = bytes.subarray(4 + length);
  let total = 0;
  for (const one of header.cells) total += wide * one.samples + section.length * one.passed;
  let at = 0, flagAt = 2 * total;
  const read = (count, differences, least, greatest, levels) => {
    const values = new Float64Array(count), step = (greatest - least) / levels;
    let slope = 0, level = 0;
    for (let i = 0; i < count; i++, at++) {
      const number = payload[at] | (payload[total + at] << 8);
      if (differences) { slope = (slope + number) & 0xffff; level = (level + slope) & 0xffff; } else level = number;
      values[i] = least + level * step;
    }
    return values;
  };
  return header.cells.flatMap((one) => {
    if (lane !== null && one.lane !== lane) {
      at += wide * one.samples + section.length * one.passed;
      flagAt += one.samples;
      return [];
    }
    const cell = { ...one, columns, states: {}, section: {} };
    cell.time = read(one.samples, true, 0, one.duration, 16383);
    columns.forEach((column, k) => {
      const [least, greatest] = one.scales[k] ?? [0, 0];
      cell.states[column.name] = read(one.samples, true, least, greatest, 2047);
    });
    section.forEach((name, k) => {
      const [least, greatest] = one.section_scales[k] ?? [0, 0];
      cell.section[name] = read(one.passed, false, least, greatest, 2047);
    });
    cell.flags = payload.slice(flagAt, flagAt + one.samples);
    flagAt += one.samples;
    return [cell];
  });
}

/** The source of a page that holds its cells: `text()` gives, or promises, a block a line, `size` cells each. */
export function embeddedSource(text, size) {
  let lines = null;
  const blocks = new Map(), cells = new Map();
  return {
    async cell(lane) {
      lines ??= (await text()).trim().split("\n");
      const index = Math.floor(lane / size);
      if (!(index in lines)) return null;
      if (!blocks.has(index)) blocks.set(index, inflated(bytesOf(lines[index])));
      const block = await blocks.get(index);
      if (!cells.has(lane)) cells.set(lane, decodeCells(block, lane)[0] ?? null);
      return cells.get(lane);
    },
  };
}
