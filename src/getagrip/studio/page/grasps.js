// Marking where stable grasps and other segments start and end, in what hand, of what object; or why there are none.

import { $, ask, element, many, move, on, pick, player, problem, saving, state, emit } from "./app.js";
import { fresh, tab } from "./saving.js";
import { STATES } from "./states.js";

const REASONS = {
  "no stable grasp": "the hold changes all the time, or nothing is held",
  "out of view": "neither hand nor object is visible",
  "other CAD": "the object differs from its category's mesh",
};
const COMPARE = 1500; // ms after the last change until people are compared again

export const grasps = () => state.marks.filter((mark) => mark.start !== null);
/** Whether a whole interaction is marked, and not stable grasps alone. */
export const whole = () => state.marks.some((mark) => mark.camera || (mark.start !== null && mark.state !== "grasp"));
export const discarded = () => state.marks.find((mark) => mark.reason);
const target = () => state.marks.find((mark) => mark.mark === state.chosen) ?? grasps().find((mark) => mark.end === null);

/** Change a mark here at once, and there as soon as it can be sent. */
export function change(mark, set) {
  const old = state.marks.find((one) => one.mark === mark);
  const empty = { mark, start: null, end: null, state: "grasp", reason: null, camera: null, category: null, entity: null, side: null };
  state.marks = state.marks.filter((one) => one !== old);
  if (!set.deleted) state.marks.push({ ...(old ?? empty), ...set, start_number: null, end_number: null, seconds: null });
  state.marks.sort((a, b) => (a.start ?? 0) - (b.start ?? 0));
  problem(null);
  draw();
  saving.add("/api/change", { change: fresh(), mark, task: state.task.key, annotator: state.annotator, tab, set });
}

export function defaults() {
  const { side, category, entity } = state.defaults;
  return { ...(side && { side }), ...(category && { category }), ...(entity && { entity }) };
}

function start() {
  if (discarded()) return say("This clip is discarded: undo that first.");
  const mark = target();
  if (mark && mark.end !== null && player.at > mark.end) return say("It cannot start after its end: move the end first.");
  const before = mark && adjoining(mark, (one) => one.end === mark.start - 1 && player.at > one.start);
  if (mark) change(mark.mark, { start: player.at });
  if (before) change(before.mark, { end: player.at - 1 });
  if (!mark) change(fresh(), { start: player.at, ...defaults() });
}

/** The segment of the same interaction that a segment has a border with, which moves for both. */
const adjoining = (mark, borders) => whole() && mark.end !== null && grasps().find((one) => one !== mark && one.end !== null && borders(one));

export const WHICH_HAND = "Say first which hand holds the object: choose Left or Right, or press h.";
/** Whether a stable grasp is not said to be of either hand, without which it cannot be finished. */
export const handless = ({ state: name, side }) => name === "grasp" && !side;

function end() {
  const mark = target();
  if (!mark) return say("Mark the start first: go there and press s.");
  if (player.at < mark.start) return say("It cannot end before it starts.");
  if (handless(mark)) return say(WHICH_HAND);
  const after = adjoining(mark, (one) => one.start === mark.end + 1 && player.at < one.end);
  change(mark.mark, { end: player.at });
  if (after) change(after.mark, { start: player.at + 1 });
}

function discard(reason) {
  const old = discarded();
  if (grasps().length) return say("There are grasps in this clip: delete them before discarding it.");
  if (old) change(old.mark, old.reason === reason ? { deleted: true } : { reason });
  else change(fresh(), { reason, ...defaults() });
}

function undo() {
  problem(null);
  saving.add("/api/undo", { change: fresh(), task: state.task.key, annotator: state.annotator, tab });
}

/** Hand or object of the chosen grasp, or else of the one without an end, and of those to come; one interaction has one. */
function describe(set) {
  const mark = target() ?? (grasps().length === 1 ? grasps()[0] : null), all = whole() && !state.chosen;
  for (const [key, value] of Object.entries(set)) state.defaults[key] = value;
  const about = all ? grasps() : mark ? [mark] : [];
  if (Object.values(set).every((value) => value)) about.forEach((one) => change(one.mark, set));
  if (!about.length && grasps().length > 1) say("This holds for the next grasp. To change one of those below, click on it first.");
  draw();
}

function choose(mark) {
  state.chosen = state.chosen === mark?.mark ? null : mark?.mark ?? null;
  if (state.chosen) {
    state.defaults = pick(mark, "side", "category", "entity");
    move(mark.start);
  }
  draw();
}

const remove = () => state.chosen && change(state.chosen, { deleted: true });

export const KEYS = {
  "Home": () => move(state.info.first),
  "End": () => move(state.info.last),
  "s": start,
  "e": end,
  "u": undo,
  "h": () => describe({ side: (target() ?? state.defaults).side === "right" ? "left" : "right" }),
  "1": () => discard(state.reasons[0]),
  "2": () => discard(state.reasons[1]),
  "3": () => discard(state.reasons[2]),
  "Delete": remove,
  "Backspace": remove,
  "Escape": () => choose(null),
};

// ---- drawing -------------------------------------------------------------------------------------------------------

function nextStep() {
  const mark = target(), n = grasps().indexOf(mark) + 1;
  if (!state.info) return "";
  if (discarded()) return "This clip is discarded. Choose the reason again to take it back, or go to the next.";
  if (state.chosen && mark && whole()) return `Segment ${n}, ${STATES[mark.state].word}: s and e move its start and end, and what adjoins it; t, c, g, f say what it is. Esc when done.`;
  if (state.chosen) return `Moving grasp ${n}: s sets its start, e its end, Esc when done.`;
  if (mark && whole()) return `Segment ${n}, ${STATES[mark.state].word}, has started. Where the object begins to do something else, press t, c, g or f; on the last frame of all, e.`;
  if (grasps().some(handless)) return WHICH_HAND;
  if (mark) return `Grasp ${n} has started. Go to its last stable frame and press e.`;
  if (grasps().some((one) => !one.category && one.state === "grasp")) return "Say which kind of object it is, so that the grasp can be exported.";
  if (!grasps().length) return "Go to the first frame of the grasp and press s. Or mark the whole interaction: where the object lies still before it is grasped, press t.";
  if (whole()) return "Go on, or click on a segment to change it. Within a segment, t, c, g, f say what its rest is. When all is right, label the frames (l).";
  return "Go on: s starts another grasp. Click on a grasp to change it, or label its frames (l) to make a clip of it.";
}

export function say(text) {
  $("next-step").textContent = text;
}

function row(mark, n) {
  const number = (value, index) => value ?? (index === null ? "…" : `#${index}`);
  const button = (text, title, act) => element("button", { textContent: text, title, onclick: (event) => { event.stopPropagation(); act(); } });
  const remove = button("✕", "Delete it", () => change(mark.mark, { deleted: true }));
  const open = button("Label", "Click joints and polygons on its frames, to make a clip of it (l)", () => emit("label", mark));
  open.hidden = mark.end === null || whole();
  const about = [whole() && STATES[mark.state].word, !["static", "free"].includes(mark.state) && (mark.side ?? "hand?"), mark.entity ?? mark.category ?? "object?", mark.seconds && `${mark.seconds.toFixed(2)} s`];
  const text = element("button", { className: "text" }, `${number(mark.start_number, mark.start)} – ${number(mark.end_number, mark.end)}`, element("small", { textContent: about.filter(Boolean).join(" · ") }));
  return element("li", { className: `${mark.state} ${mark.mark === state.chosen ? "chosen" : ""}`, title: "Click to change", onclick: () => choose(mark) }, element("b", { textContent: n + 1 }), text, open, remove);
}

function drawMarks() {
  $("marks").replaceChildren(...grasps().map(row));
}

export function draw() {
  const mark = target() ?? (grasps().length === 1 ? grasps()[0] : null);
  const about = mark ? { ...state.defaults, ...pick(mark, "side", "category", "entity") } : state.defaults;
  for (const button of $("side").children) button.ariaChecked = String(button.dataset.side === about.side);
  for (const key of ["category", "entity"]) if (document.activeElement !== $(key)) $(key).value = about[key] ?? "";
  $("side").classList.toggle("wanted", !about.side);
  $("category").classList.toggle("wanted", Boolean(mark && !mark.category));
  $("categories").replaceChildren(...state.categories.map((value) => element("option", { value })));
  $("reasons").replaceChildren(...state.reasons.map((reason, n) => {
    const button = element("button", { onclick: () => discard(reason), disabled: !state.info || grasps().length > 0 }, element("kbd", { textContent: n + 1 }), ` ${reason} `, element("small", { textContent: REASONS[reason] }));
    button.ariaPressed = String(discarded()?.reason === reason);
    return button;
  }));
  drawMarks();
  say(nextStep());
  emit("drawn");
}

export async function drawAgreement() {
  for (const kind of ["csv", "json"]) $(kind).href = `/grasps.${kind}?${new URLSearchParams({ annotator: state.annotator })}`;
  const { pairs } = await ask("/api/agreement", {});
  const line = (pair) => `${pair.first} and ${pair.second}: ${pair.iou === null ? "no grasps to compare" : `temporal IOU ${(100 * pair.iou).toFixed(1)} % over ${many(pair.grasps, "grasp")}`} in ${many(pair.tasks, "clip")}`;
  $("agreement").textContent = pairs.length ? pairs.map(line).join("\n") : "Agreement is shown once two people have marked a clip.";
}

/** Bars of the timeline. */
export const bars = () => grasps().map((mark, n) => ({
  text: whole() ? `${n + 1} ${STATES[mark.state].word}` : n + 1, title: `${n + 1}: ${STATES[mark.state].word}`, from: mark.start, to: mark.end ?? Math.max(mark.start, player.shown?.index ?? 0),
  classes: [mark.state, mark.end === null && "open", mark.mark === state.chosen && "chosen"],
}));

let comparing;
on("answer", (path, sent, answer) => {
  if (!["/api/change", "/api/undo"].includes(path)) return;
  if (path === "/api/undo" && answer.undone === false) say("Nothing left to undo in this tab.");
  clearTimeout(comparing);
  comparing = setTimeout(drawAgreement, COMPARE);
});
on("task", draw);
on("marks", draw);

for (const button of $("side").children) button.onclick = () => describe({ side: button.dataset.side });
for (const key of ["category", "entity"]) $(key).onchange = () => describe({ [key]: $(key).value.trim() });
$("undo").onclick = () => undo();
