"use strict";
// What both pages share: elements made of text only, and the page's data.

const SVG = "http://www.w3.org/2000/svg";

/** An element with attributes, listeners (onclick: function) and children; texts stay texts. */
function element(tag, attributes = {}, ...children) {
  const drawn = ["svg", "path", "line", "text", "g", "rect"].includes(tag);
  const made = drawn ? document.createElementNS(SVG, tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children);
  return made;
}

const byId = (id) => document.getElementById(id);
const data = JSON.parse(byId("data").textContent);
const TYPES = { float32: Float32Array, uint16: Uint16Array, uint32: Uint32Array, uint8: Uint8Array };

/** The page's arrays by name; each has its `shape`. */
async function readArrays() {
  const packed = Uint8Array.from(atob(byId("arrays").textContent), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const out = {};
  for (const [name, { type, shape, offset }] of Object.entries(data.arrays)) {
    const count = shape.reduce((product, length) => product * length, 1);
    out[name] = Object.assign(new TYPES[type](buffer, offset, count), { shape });
  }
  return out;
}
