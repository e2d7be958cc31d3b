// The result over the footage: outlines of hand and object, of the result itself or of another candidate.

import { ask, emit, move, saving, state } from "./app.js";
import { Away, fresh, tab } from "./saving.js";

const AHEAD = 10; // frames of which outlines are asked for before they are shown

let known = new Map(); // outlines by frame; null where there are none
let of = ""; // grasp, time and candidate that they belong to
let rank = 0, shown = true, asking = false;

export const candidate = () => rank;
export const isShown = () => shown;

/** Show the outlines, or hide them. */
export function toggle() {
  shown = !shown;
  emit("labels");
}

/** Show the outlines of a candidate, 0 for the result. */
export function choose(wanted) {
  [rank, shown] = [wanted, true];
  emit("labels");
}

const owner = (result) => `${state.labels.grasp} ${result.made} ${rank}`;

/** The outlines in a frame, if they are known and wished; others are asked for. */
export function outlines(frame) {
  const result = state.labels?.result;
  if (!result?.candidates || !shown) return null;
  if (!of.startsWith(`${state.labels.grasp} ${result.made} `)) rank = 0; // another result
  if (owner(result) !== of) [of, known] = [owner(result), new Map()];
  const last = state.labels.extent[1], next = [frame, Math.min(frame + AHEAD, last)].find((n) => !known.has(n));
  if (next !== undefined && next <= last) load(next);
  return known.get(frame) ?? null;
}

async function load(first) {
  if (asking) return;
  asking = true;
  const mine = of;
  try {
    const { frames } = await ask("/api/outlines", { ...state.labels.about, candidate: rank, first });
    if (mine !== of) return;
    known.set(first, null); // where there are none, they are not asked for again
    for (const [frame, lines] of Object.entries(frames)) known.set(Number(frame), lines);
  } catch (error) {
    if (!(error instanceof Away) && mine === of) known.set(first, null);
  } finally {
    asking = false;
    emit("outlines");
  }
}

const STEPS = {
  draw: { word: ({ numbers }) => `Draw frame ${numbers[0]}`, act: ({ frames }) => { move(frames[0]); emit("draw"); } },
  candidate: { word: () => "Try candidate 2", act: () => choose(1) },
  cut: { word: ({ numbers }) => `Cut to ${numbers[0]}–${numbers[1]}`, act: ({ frames }) => cut(...frames) },
  size: { word: (_, { size_mm: size }) => (size ? "Check the size" : "State the size"), act: () => emit("field", "size-mm") },
  mesh: { word: () => "Choose another mesh", act: () => emit("field", "mesh") },
};

/** What a step is called, and a function that takes it. */
export const step = (one, stated) => ({ word: STEPS[one.do].word(one, stated), act: () => STEPS[one.do].act(one) });

/** Make the grasp shorter, and go on with it. */
async function cut(start, end) {
  const { grasp, about } = state.labels;
  saving.add("/api/change", { change: fresh(), mark: grasp, task: about.task, annotator: about.annotator, tab, set: { start, end } });
  await saving.flush();
  const mark = state.marks.find((one) => one.mark === grasp);
  if (mark?.start === start && mark.end === end) emit("label", mark);
}

