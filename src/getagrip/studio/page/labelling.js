// Labelling the frames of a grasp: tools, keys and the mouse.

import { $, move, on, player, problem, state, emit } from "./app.js";
import { drawHand, next, tool as joints, unseen } from "./joints.js";
import * as labels from "./labels.js";
import { tool as outlines } from "./outlines.js";
import { tool as strokes } from "./strokes.js";
import { drawOverlay, toggle } from "./overlay.js";
import { drawPanel, reconstruct, say } from "./panel.js";
import { toggle as toggleResult } from "./results.js";
import { fill } from "./settings.js";
import { pan, pointAt, view } from "./view.js";

const REACH = 8; // screen pixels within which a point is meant
const STILL = 4; // screen pixels that a click may move
const CROSS_STEP = 4; // screen pixels that the cross moves at once

const TOOLS = { joints, on: strokes("on"), off: strokes("off"), object: outlines("object"), front: outlines("front"), hand: outlines("hand") };
const STROKES = ["on", "off"];
const tool = () => TOOLS[state.tool];

function choose(name) {
  tool().finish?.();
  state.tool = name;
  emit("tool");
  draw();
}

/** A point that lies in the picture, to a hundredth of a pixel. */
const inside = (point) => point.map((value, axis) => Math.round(100 * Math.min(Math.max(value, 0), view.size[axis])) / 100);
const ready = () => state.mode === "labels" && !player.playing && player.shown?.index === player.wanted;
const inExtent = () => player.wanted >= state.labels.extent[0] && player.wanted <= state.labels.extent[1];

/** Begin to label a grasp: at its start, or where one is in it where that was done before. */
export async function begin(mark) {
  try {
    await labels.open(mark.mark);
  } catch (error) {
    problem(error);
    return;
  }
  const { settings } = state.labels;
  fill(settings, mark.category);
  Object.assign(state, { mode: "labels", tool: settings.tool ?? (state.labels.found ? "on" : "joints") });
  view.fitted = true;
  player.look(true);
  $("label-title").textContent = `Frames ${mark.start_number} – ${mark.end_number}`;
  emit("mode");
  draw();
  await player.show(Math.min(Math.max(settings.frame ?? mark.start, mark.start), mark.end));
  if (state.labels?.found && labels.missing(mark.start)) labels.work("propagate"); // the hands that were found
}

export function end() {
  labels.close();
  state.mode = "grasps";
  view.fitted = true;
  $("layer").replaceChildren();
  player.look(false);
  emit("mode");
  player.show(player.wanted);
}

// ---- keys ----------------------------------------------------------------------------------------------------------

const nudge = (dx, dy) => (event) => {
  const step = Math.max(0.05, (event.shiftKey ? 10 : 1) / view.scale);
  if (state.cross) {
    state.cross = inside([state.cross[0] + CROSS_STEP * step * dx, state.cross[1] + CROSS_STEP * step * dy]);
    drawOverlay();
  } else if (!tool().nudge(step * dx, step * dy, inside)) say("Click on a point to choose it; then w, a, x, d move it.");
};

/** What a click does, at the cross that the keyboard moves; at first the cross is shown, in the middle. */
function cross() {
  if (!state.cross) {
    state.cross = view.size.map((length) => length / 2);
    say("w, a, x, d move the cross, faster with shift; . draws there, as a click does; Esc hides it.");
    drawOverlay();
  } else if (ready() && inExtent()) {
    place(tool().grab(state.cross, REACH / view.scale), state.cross);
    if (STROKES.includes(state.tool)) renew();
  }
}

function place(grabbed, at) {
  const reach = REACH / view.scale;
  if (grabbed !== null) tool().tap(grabbed, inside(at), reach);
  else if (within(at)) tool().click(inside(at), reach);
  draw();
}

/** The next or previous frame that has labels. */
function keyframe(by) {
  const frames = [...state.labels.keyframes.keys()].sort((a, b) => by * (a - b));
  const to = frames.find((frame) => by * (frame - player.wanted) > 0);
  if (to !== undefined) move(to);
}

function take() {
  const why = tool().take();
  if (why) say(why);
}

const remove = () => tool().remove();

export const KEYS = {
  "Home": () => move(state.labels.extent[0]),
  "End": () => move(state.labels.extent[1]),
  "[": () => keyframe(-1),
  "]": () => keyframe(1),
  "j": () => choose("joints"),
  "o": () => choose("object"),
  "i": () => choose("front"),
  "q": () => choose("on"),
  "z": () => choose("off"),
  "y": () => choose("hand"),
  "m": () => state.tool === "joints" && unseen(),
  "w": nudge(0, -1),
  "a": nudge(-1, 0),
  "x": nudge(0, 1),
  "d": nudge(1, 0),
  "Enter": () => tool().finish(),
  ".": cross,
  "Escape": () => { state.cross = null; joints.finish(); draw(); },
  "Delete": remove,
  "Backspace": remove,
  "k": take,
  "u": labels.undo,
  "r": toggleResult,
  "v": () => { toggle(); draw(); },
  "b": () => labels.work("propagate"),
  "l": end,
};

// ---- the mouse: click to place, drag points, drag the picture --------------------------------------------------------

const screen = $("screen");
screen.onpointerdown = (event) => {
  if (event.target.closest("#closer, #farther, #zoom") || event.button === 2) return;
  state.cross = null;
  const draws = ready() && event.button === 0 && inExtent(), at = pointAt(event);
  const grabbed = draws ? tool().grab(at, REACH / view.scale) : null;
  let [x, y] = [event.clientX, event.clientY], far = false;
  screen.setPointerCapture(event.pointerId);
  screen.onpointermove = (now) => {
    far ||= Math.hypot(now.clientX - event.clientX, now.clientY - event.clientY) > STILL;
    if (!far) return;
    if (grabbed !== null) tool().drag(grabbed, inside(pointAt(now)));
    else pan(now.clientX - x, now.clientY - y);
    [x, y] = [now.clientX, now.clientY];
  };
  const over = (now) => {
    screen.onpointermove = screen.onpointerup = screen.onpointercancel = null;
    if (far) labels.settle();
    else if (draws && now.type === "pointerup") place(grabbed, at);
    else if (state.mode === "labels" && !inExtent()) say("This frame is not part of the grasp.");
  };
  screen.onpointerup = screen.onpointercancel = (now) => {
    over(now);
    if (grabbed !== null && STROKES.includes(state.tool)) renew();
  };
};
const within = (point) => point.every((value, axis) => value >= 0 && value <= view.size[axis]);

// ---- drawing and buttons ---------------------------------------------------------------------------------------------

export function draw() {
  if (state.mode !== "labels") return;
  for (const button of $("tools").children) button.ariaChecked = String(button.dataset.tool === state.tool);
  $("joints").hidden = state.tool !== "joints";
  $("outlines").hidden = state.tool === "joints";
  for (const part of document.querySelectorAll(".polygons")) part.hidden = STROKES.includes(state.tool);
  screen.dataset.tool = state.tool;
  drawHand();
  drawOverlay();
  drawPanel(next());
}

/** Whether to reconstruct again by oneself: where that is wished and the mesh has served once. */
const again = () => state.labels.result && $("live").checked && $("mesh").value.trim();

/** Fill in again after a stroke, and reconstruct, which fills in, too, once a first result is there. */
function renew() {
  if (again()) reconstruct();
  else labels.work("propagate");
}

/** Reconstruct again as soon as all is filled in. */
let worked = null;
function follow() {
  const job = state.labels?.job, now = job && `${job.what} ${job.state}`;
  const filled = now === "propagate done" && worked?.startsWith("propagate") && worked !== now;
  worked = now;
  if (filled && again() && !$("reconstruct").disabled) reconstruct();
}

joints.changed = draw;
view.changed = () => state.mode === "labels" && drawOverlay();
on("labels", draw);
on("outlines", () => state.mode === "labels" && drawOverlay());
on("draw", () => choose(state.labels.found ? "on" : "object"));
on("labels", follow);
on("shown", draw);
on("undone", (undone, frame) => {
  if (!undone) say("Nothing left to undo in this tab.");
  else if (frame !== player.wanted) move(frame);
});
on("task", () => { // another clip is opened: its grasps come first
  if (state.mode === "labels" && !state.info) end();
});
for (const button of $("tools").children) button.onclick = () => choose(button.dataset.tool);
