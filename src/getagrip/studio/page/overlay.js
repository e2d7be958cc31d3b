// What is drawn over the picture: what was filled in, and the joints and polygons of this frame's labels.

import { $, player, state } from "./app.js";
import { BONES, NAMES, colour, selected as joint } from "./joints.js";
import { draft, here, stale } from "./labels.js";
import { selected as corner } from "./outlines.js";
import { outlines as ofResult } from "./results.js";
import { view } from "./view.js";

let shown = true; // what was filled in

export function toggle() {
  shown = !shown;
}

const svg = (name, attributes, title) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (title) made.append(Object.assign(document.createElementNS("http://www.w3.org/2000/svg", "title"), { textContent: title }));
  return made;
};
const path = (points, closed = true) => `M${points.map((point) => point.join(" ")).join("L")}${closed ? "Z" : ""}`;

/** Whether a frame has strokes: what they make of it is filled in. */
const strokes = (own) => Object.values(own.outlines).some(({ of }) => of === "on" || of === "off");

/** Masks and hand as the server has drafted them; a key frame's own polygons stand instead of its masks. */
function drafts(frame, own) {
  const made = [], masks = draft("masks", frame), hand = draft("hand", frame);
  const old = (kind) => (stale(kind, frame) ? " stale" : "");
  if (masks) {
    const drawn = own.outlined && !strokes(own) ? ["hand"] : ["object", "front", "hand"];
    for (const kind of drawn) {
      const d = (masks.content[kind] ?? []).map((points) => path(points)).join("");
      if (d) made.push(svg("path", { d, class: `draft ${kind === "hand" ? "own" : kind}${old("masks")}`, "fill-rule": "evenodd" }));
    }
  }
  if (hand) {
    const { joints, outlines } = hand.content;
    made.push(svg("path", { d: outlines.map((points) => path(points)).join(""), class: `draft hand${old("hand")}` }));
    if (joints.length && (state.tool === "joints" || state.labels.found)) {
      made.push(svg("path", { d: BONES.map((bone) => path(bone.map((n) => joints[n]), false)).join(""), class: `draft bones${old("hand")}` }));
    }
  }
  return made;
}

function outlines(own) {
  const radius = 4.5 / view.scale, chosen = corner();
  return Object.entries(own.outlines).flatMap(([id, one]) => {
    if (one.of === "on" || one.of === "off") return [svg("path", { d: `${path(one.points, false)}${one.points.length > 1 ? "" : "h0.01"}`, class: `stroke ${one.of}` })];
    const made = [svg("path", { d: path(one.points, one.closed), class: `outline ${one.of}${one.closed ? "" : " open"}`, "fill-rule": "evenodd" })];
    if (state.tool !== one.of) return made;
    const corners = one.points.map(([x, y], n) => {
      const first = !one.closed && n === 0, now = chosen?.id === id && chosen.n === n;
      return svg("circle", { cx: x, cy: y, r: first && one.points.length > 2 ? 1.7 * radius : radius, class: `corner ${one.of}${now ? " chosen" : ""}` });
    });
    return [...made, ...corners];
  });
}

function joints(frame, own) {
  const there = (n) => Array.isArray(own.joints[n]), radius = 5 / view.scale, chosen = joint();
  const uncertain = draft("hand", frame)?.content.uncertain ?? [];
  const bones = BONES.filter((bone) => bone.every(there)).map(([a, b]) => svg("path", { d: path([own.joints[a], own.joints[b]], false), class: "bone", stroke: colour(b) }));
  const dots = NAMES.map((name, n) => [name, n]).filter(([, n]) => there(n)).map(([name, n]) => {
    const [x, y] = own.joints[n], classes = `joint${n === chosen ? " chosen" : ""}${uncertain.includes(n) ? " uncertain" : ""}`;
    return svg("circle", { cx: x, cy: y, r: state.tool === "joints" ? radius : radius / 2, fill: colour(n), class: classes }, name);
  });
  return [...bones, ...dots];
}

/** Hand and object of the result, each as a line with a dark one below it, for contrast. */
function result(frame) {
  const lines = ofResult(frame), old = state.labels.result?.current ? "" : " old";
  if (!lines) return [];
  return ["hand", "object"].flatMap((kind) => {
    const d = lines[kind].map((points) => path(points)).join("");
    return d ? ["below", "above"].map((place) => svg("path", { d, class: `result ${kind} ${place}${old}` })) : [];
  });
}

/** Where the keyboard draws, light on dark. */
function cross() {
  if (!state.cross) return [];
  const [x, y] = state.cross, arm = 14 / view.scale;
  const d = `M${x - arm} ${y}H${x + arm}M${x} ${y - arm}V${y + arm}`;
  return ["below", "above"].map((place) => svg("path", { d, class: `cross ${place}` }));
}

export function drawOverlay() {
  if (!state.labels || !player.shown) return $("layer").replaceChildren();
  const frame = player.shown.index, own = state.labels.keyframes.get(frame) ?? here();
  if (frame !== player.wanted) return undefined; // the next frame is on its way
  return $("layer").replaceChildren(...(shown ? drafts(frame, own) : []), ...result(frame), ...outlines(own), ...joints(frame, own), ...cross());
}
