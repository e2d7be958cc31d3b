// Looking closer: what part of the picture is on the screen. Points are in pixels of the footage.

import { $, on, state } from "./app.js";

const CLOSEST = 40; // screen pixels per pixel of the footage
const WHEEL = 0.0015; // of the logarithm of the scale, per pixel that a wheel turns

export const view = { scale: 1, x: 0, y: 0, size: [16, 9], fitted: true, there: false, changed: () => {} };

/** The whole picture, as large as it fits. */
function fit() {
  const { width, height } = $("screen").getBoundingClientRect();
  const scale = Math.min(width / view.size[0], height / view.size[1]);
  place(scale, (width - scale * view.size[0]) / 2, (height - scale * view.size[1]) / 2);
  view.fitted = true;
}

function place(scale, x, y) {
  const { width, height } = $("screen").getBoundingClientRect();
  const keep = (at, length, whole) => Math.min(Math.max(at, 0.2 * whole - length), 0.8 * whole); // some of it stays in sight
  Object.assign(view, { scale, x: keep(x, scale * view.size[0], width), y: keep(y, scale * view.size[1], height), fitted: false });
  draw();
}

function draw() {
  const canvas = $("picture"), zoom = view.scale * view.size[0] / canvas.width;
  canvas.style.transform = `translate(${view.x}px, ${view.y}px) scale(${zoom})`;
  canvas.classList.toggle("close", zoom > 3);
  $("layer").setAttribute("transform", `translate(${view.x} ${view.y}) scale(${view.scale})`);
  $("zoom").textContent = view.there ? `${Math.round(100 * view.scale)} %` : "–"; // without a picture it is of nothing
  view.changed();
}

/** Of a place on the screen. */
export function pointAt({ clientX, clientY }) {
  const { left, top } = $("screen").getBoundingClientRect();
  return [(clientX - left - view.x) / view.scale, (clientY - top - view.y) / view.scale];
}

export function zoom(factor, at) {
  const { left, top, width, height } = $("screen").getBoundingClientRect();
  const [x, y] = at ? [at.clientX - left, at.clientY - top] : [width / 2, height / 2];
  const least = 0.5 * Math.min(width / view.size[0], height / view.size[1]);
  const scale = Math.min(Math.max(factor * view.scale, least), CLOSEST);
  place(scale, x - (x - view.x) * scale / view.scale, y - (y - view.y) * scale / view.scale);
}

export const pan = (dx, dy) => place(view.scale, view.x + dx, view.y + dy);

/** Another picture is on the canvas, of footage of a size that is known while labelling only. */
on("shown", () => {
  const size = state.labels?.size ?? [$("picture").width, $("picture").height];
  const same = size[0] === view.size[0] && size[1] === view.size[1];
  Object.assign(view, { size, there: true });
  if (view.fitted || !same) fit();
  else draw();
});

new ResizeObserver(() => (view.fitted ? fit() : draw())).observe($("screen"));
$("screen").addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(Math.exp(-WHEEL * event.deltaY * (event.deltaMode ? 33 : 1)), event);
}, { passive: false });

export const KEYS = { "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5), "0": fit };
for (const [id, act] of [["closer", KEYS["+"]], ["farther", KEYS["-"]], ["zoom", fit]]) $(id).onclick = () => act();
