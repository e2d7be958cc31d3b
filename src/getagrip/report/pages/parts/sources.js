"use strict";
// Where a column's frames come from: all of them are in the page, or a server is asked for each.

const TYPES = { float32: Float32Array, uint16: Uint16Array, uint32: Uint32Array, uint8: Uint8Array };
const MOVING = ["hand_vertices", "hand_near", "object_near", "other_hand_vertices", "other_hand_near", "true_hand_vertices"];
const KEPT = 300;  // frames of a column, about 0.1 MB each

/** Arrays by name; each has its `shape`. */
async function unpack(where, packed) {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const out = {};
  for (const [name, { type, shape, offset }] of Object.entries(where)) {
    const count = shape.reduce((product, length) => product * length, 1);
    out[name] = Object.assign(new TYPES[type](buffer, offset, count), { shape });
  }
  return out;
}

/** One block of an array that has one for each frame. */
function block(array, n) {
  const length = array.length / array.shape[0];
  return array.subarray(n * length, (n + 1) * length);
}

/** JSON of the server that the page comes from. Throws with its words. */
async function ask(path) {
  let answer;
  try {
    answer = await fetch(path);
  } catch (error) {
    throw new Error("the server does not answer: getagrip view has ended, or the tunnel to it");
  }
  const content = await answer.json();
  if (!answer.ok) throw new Error(content.error);
  return content;
}

class Embedded {
  constructor(column, arrays) {
    Object.assign(this, { column, arrays });
  }

  /** A frame with one of the candidates; how near the surfaces are is known of the result alone. */
  async frame(rank, n) {
    const { views, ...own } = this.column.pictures[n];
    const shown = ({ picture, place, outlines, others, met }) =>
      rank === 0 ? { picture, place, outlines, met } : { picture, place, outlines: { ...outlines, object: others[rank - 1] } };
    const names = MOVING.filter((name) => this.arrays[name] && (rank === 0 || !name.endsWith("_near")));
    return {
      ...shown(own),
      views: views.map(shown),
      arrays: Object.fromEntries(names.map((name) => [name, block(this.arrays[name], n)])),
    };
  }
}

class Fetched {
  constructor(entry, column) {
    Object.assign(this, { place: `${entry}/${column}`, kept: new Map() });
  }

  frame(rank, n) {
    const path = `frame/${this.place}/${rank}/${n}`;
    const known = this.kept.get(path) || this.read(path);
    this.kept.delete(path);
    this.kept.set(path, known);  // the latest stand last
    if (this.kept.size > KEPT) this.kept.delete(this.kept.keys().next().value);
    known.catch(() => this.kept.delete(path));
    return known;
  }

  async read(path) {
    const { arrays, packed, ...drawn } = await ask(path);
    return { ...drawn, arrays: await unpack(arrays, packed) };
  }

  gap() {
    return ask(`gap/${this.place}`);
  }

  candidates() {
    return ask(`candidates/${this.place}`);
  }
}
