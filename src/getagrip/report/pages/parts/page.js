"use strict";
// What all pages share: elements made of text only, and the page's data.

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
