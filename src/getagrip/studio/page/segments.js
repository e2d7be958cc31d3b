// The whole interaction: what the object does from a frame on, and what is amiss with its segments.

import { $, element, on, pick, player, state, emit } from "./app.js";
import { change, defaults, discarded, grasps as segments, handless, say, whole, WHICH_HAND } from "./grasps.js";
import { fresh } from "./saving.js";
import { STATES } from "./states.js";

/** From this frame on, the object is in a state: until the next segment, or until that is said of another state. */
function paint(name) {
  const at = player.at, chosen = segments().find((one) => one.mark === state.chosen);
  if (discarded()) return say("This clip is discarded: undo that first.");
  const open = segments().find((one) => one.end === null), side = chosen?.side ?? open?.side ?? state.defaults.side;
  if (handless({ state: name, side }) || (open && handless(open))) return say(WHICH_HAND);
  if (chosen) return change(chosen.mark, { ...(side && { side }), state: name });
  if (open) return at < open.start ? say("Go on to a later frame: the segment that has begun starts after this one.") : goOn(open, name, at);
  const here = segments().find((one) => one.start <= at && at <= one.end);
  if (here) return divide(here, name, at);
  const next = segments().find((one) => one.start > at);
  change(fresh(), { ...defaults(), start: at, ...(next && { end: next.start - 1 }), state: name });
}

function goOn(open, name, at) {
  if (open.state === name || open.start === at) return change(open.mark, { state: name });
  change(open.mark, { end: at - 1 });
  change(fresh(), { ...defaults(), start: at, state: name });
}

/** The rest of a segment is in another state: a new segment, or part of the next one. */
function divide(here, name, at) {
  if (here.state === name || here.start === at) return change(here.mark, { state: name });
  const next = segments().find((one) => one.start === here.end + 1 && one.state === name);
  const about = Object.fromEntries(Object.entries(pick(here, "side", "category", "entity")).filter(([, value]) => value));
  change(here.mark, { end: at - 1 });
  if (next) change(next.mark, { start: at });
  else change(fresh(), { ...defaults(), ...about, start: at, end: here.end, state: name });
}

function still() {
  const said = state.marks.find((mark) => mark.camera);
  if (said) change(said.mark, { deleted: true });
  else change(fresh(), { camera: "still" });
}

export const KEYS = Object.fromEntries(Object.entries(STATES).map(([name, { key }]) => [key, () => paint(name)]));

function draw() {
  const now = segments().find((one) => one.mark === state.chosen) ?? segments().find((one) => one.end === null);
  for (const button of $("states").children) {
    button.ariaPressed = String(button.dataset.state === now?.state);
    button.disabled = !state.info;
  }
  $("whole").hidden = $("amiss").hidden = !whole();
  if (!whole()) return;
  const { overlaps = [], hints = [], mark } = state.interaction ?? {};
  const line = (className) => (textContent) => element("li", { className, textContent });
  $("amiss").replaceChildren(...overlaps.map(line("overlap")), ...hints.map(line("")));
  $("still").checked = state.marks.some((one) => one.camera);
  $("label-whole").disabled = !mark || overlaps.length > 0;
  $("segments").hidden = !mark || overlaps.length > 0;
  $("segments").href = `/segments.json?${new URLSearchParams({ annotator: state.annotator })}`;
}

$("states").replaceChildren(...Object.entries(STATES).map(([name, { key, word, about }]) => {
  const button = element("button", { title: about, className: name, onclick: () => paint(name) }, element("kbd", { textContent: key }), ` ${word}`);
  button.dataset.state = name;
  return button;
}));
$("other-states").replaceChildren(...["static", "contact", "free"].map((name) => element("li", { className: name }, element("b", { textContent: STATES[name].word }), `: ${STATES[name].about}`)));
$("still").onchange = () => still();
$("label-whole").onclick = () => state.interaction?.mark && emit("label", state.interaction);
for (const name of ["task", "marks", "drawn"]) on(name, draw);
