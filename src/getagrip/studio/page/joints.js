// The 21 joints of the hand, clicked in order; and a picture of a hand that shows which comes next.

import { $, element, player, state } from "./app.js";
import { adjust, at, change, draft, here } from "./labels.js";

const FINGERS = ["Thumb", "Index", "Middle", "Ring", "Little"];
export const NAMES = ["Wrist", ...FINGERS.flatMap((finger) => ["knuckle", "middle joint", "last joint", "tip"].map((joint, n) =>
  `${finger} ${finger === "Thumb" ? ["root, at the wrist", "knuckle", "last joint", "tip"][n] : joint}`))];
export const BONES = FINGERS.flatMap((_, finger) => [0, 1, 2, 3].map((n) => [n ? 4 * finger + n : 0, 4 * finger + n + 1]));
const COLOURS = ["#9aa0a6", "#e4572e", "#f2a541", "#3fa34d", "#2e86de", "#9b5de5"];
export const colour = (joint) => COLOURS[Math.ceil(joint / 4)];
/** The back of a right hand, fingers up. */
const PICTURE = [[100, 200], [70, 176], [46, 150], [29, 126], [17, 104], [66, 104], [58, 70], [54, 48], [51, 28], [94, 98], [92, 56], [91, 33], [90, 11], [120, 103], [124, 66], [126, 44], [127, 24], [143, 117], [154, 90], [160, 74], [165, 57]];

const DOT = 0.65; // a joint's dot, as part of the reach

let chosen = null; // joint that the keyboard moves
let wanted = null; // joint to be clicked next, where it is not simply the next one
let last = -1; // joint that was clicked last, and on which frame
let lastFrame = null;

const done = (joint) => here().joints[joint] !== undefined;

/** The joint that the next click sets; null when all are there. */
export function next() {
  if (wanted !== null) return wanted;
  const from = lastFrame === player.wanted ? last + 1 : 0;
  const order = NAMES.map((_, n) => (from + n) % NAMES.length);
  return order.find((joint) => !done(joint)) ?? null;
}

export const selected = () => (chosen !== null && Array.isArray(here().joints[chosen]) ? chosen : null);

function set(joint, value) {
  [last, lastFrame, wanted] = [joint, player.wanted, null];
  change(player.wanted, { joints: { [joint]: value } });
}

export const tool = {
  /** The joint at a point, within a distance. */
  grab(point, reach) {
    const found = Object.entries(here().joints).filter(([, where]) => Array.isArray(where))
      .map(([joint, where]) => [Math.hypot(where[0] - point[0], where[1] - point[1]), Number(joint)])
      .filter(([distance]) => distance < reach).sort((a, b) => a[0] - b[0])[0];
    return found ? found[1] : null;
  },
  drag(joint, point) {
    chosen = joint;
    adjust(player.wanted, { joints: { [joint]: point } });
  },
  tap(joint, point, reach) {
    const [x, y] = here().joints[joint], beside = Math.hypot(x - point[0], y - point[1]) > DOT * reach;
    if (beside && next() !== null) this.click(point); // beside the dot: the next joint is close by
    else chosen = joint;
  },
  click(point) {
    const joint = next();
    if (joint === null) chosen = null;
    else {
      chosen = joint;
      set(joint, point);
    }
  },
  nudge(dx, dy, inside) {
    const joint = selected();
    if (joint === null) return false;
    const [x, y] = here().joints[joint];
    adjust(player.wanted, { joints: { [joint]: inside([x + dx, y + dy]) } });
    return true;
  },
  remove() {
    const joint = selected();
    if (joint === null) return;
    change(player.wanted, { joints: { [joint]: null } });
    [chosen, wanted] = [null, joint];
  },
  finish() {
    chosen = wanted = null;
  },
  /** The joints of the fitted hand, to be corrected. */
  take() {
    const hand = draft("hand", player.wanted);
    if (!hand?.content.joints.length) return "Nothing is filled in on this frame yet.";
    const [width, height] = state.labels.size;
    const seen = ([x, y]) => x >= 0 && y >= 0 && x <= width && y <= height;
    change(player.wanted, { joints: Object.fromEntries(hand.content.joints.map((point, n) => [n, seen(point) ? point : "unseen"])) });
    return null;
  },
};

export function unseen() {
  const joint = next();
  if (joint !== null) set(joint, "unseen");
}

/** Click this one next; or, if it is there, choose it. */
function ask(joint) {
  if (Array.isArray(at(player.wanted).joints[joint])) [chosen, wanted] = [joint, null];
  else [chosen, wanted] = [null, joint];
  tool.changed();
}

// ---- the picture of a hand -----------------------------------------------------------------------------------------

const svg = (name, attributes, ...children) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
};

/** Nothing is left to click on this frame: how many joints are there, and how many cannot be seen. */
const allSaid = (count) => (count === NAMES.length ? "All joints are there." : `Nothing is left to click here: ${NAMES.length - count} joints are not visible.`);

export function drawHand() {
  const mirrored = state.labels.side === "left";
  const place = ([x, y]) => (mirrored ? [200 - x, y] : [x, y]);
  const spots = PICTURE.map(place);
  const path = (joints) => joints.map((n) => spots[n].join(",")).join(" ");
  const fingers = [0, 1, 2, 3, 4].map((finger) => svg("polyline", { class: "flesh", "stroke-width": finger ? 21 : 24, points: path([1, 2, 3, 4].map((n) => 4 * finger + n)) }));
  const palm = svg("polygon", { class: "flesh palm", points: path([0, 1, 5, 9, 13, 17]) });
  const bones = BONES.map(([a, b]) => svg("line", { x1: spots[a][0], y1: spots[a][1], x2: spots[b][0], y2: spots[b][1], class: "bone" }));
  const now = next();
  const dots = spots.map(([x, y], joint) => {
    const state = here().joints[joint];
    const kind = joint === now ? "next" : state === undefined ? "" : state === "unseen" ? "unseen" : "there";
    const dot = svg("circle", { cx: x, cy: y, r: joint === now ? 7.5 : 5, class: kind, fill: kind === "there" ? colour(joint) : "#fff" }, svg("title", {}, `${NAMES[joint]}${kind === "unseen" ? " (not seen)" : ""}`));
    dot.onclick = () => ask(joint);
    return dot;
  });
  $("hand").replaceChildren(palm, ...fingers, ...bones, ...dots);
  $("hand-side").textContent = `Back of the ${state.labels.side} hand`;
  const count = Object.values(here().joints).filter(Array.isArray).length;
  const chosenNow = selected();
  $("joint").replaceChildren(now === null ? allSaid(count) : element("span", {}, "Next: ", element("b", { textContent: NAMES[now] })));
  $("joint-chosen").textContent = chosenNow === null ? `${count} of 21 on this frame` : `Chosen: ${NAMES[chosenNow]}`;
  $("unseen").disabled = now === null;
  $("delete-joint").disabled = chosenNow === null;
}
