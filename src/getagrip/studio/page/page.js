// The page: who is at it, which clip is open, and what keys and buttons do in its two modes.

import { $, clock, invited, many, move, on, player, problem, saving, state } from "./app.js";
import * as grasps from "./grasps.js";
import { unseen } from "./joints.js";
import * as labelling from "./labelling.js";
import * as labels from "./labels.js";
import { Away } from "./saving.js";
import * as segments from "./segments.js";
import { openTask, overview, refresh, step } from "./tasks.js";
import { drawTimeline } from "./timeline.js";
import { KEYS as VIEW } from "./view.js";

const AWAY = "the server is not reached";
const POLL = 1500; // ms between questions whether another tab has changed something
const POLL_WORK = 400; // the same while the server works

// ---- what is shown -------------------------------------------------------------------------------------------------

const timeline = () => drawTimeline(grasps.bars());

on("shown", ({ number, time }) => {
  $("frame").textContent = number;
  $("time").textContent = clock(time);
  timeline();
});
for (const name of ["task", "marks", "labels", "mode"]) on(name, timeline);
on("waiting", (waits) => $("waiting").classList.toggle("on", waits));
on("problem", (text) => {
  $("problem").textContent = text ?? "";
  $("problem").hidden = !text;
});
on("refused", problem);
let away = false, pending = [0];
function drawSaved() {
  const [count, reason] = pending;
  $("saved").className = count || away ? "pending" : "";
  if (reason || (away && count)) $("saved").textContent = `Not saved, ${reason ?? AWAY}: ${many(count, "change")} kept here, tried again`;
  else $("saved").textContent = away ? `Nothing is lost: ${AWAY}, tried again` : count ? "Saving …" : "All saved";
}
on("pending", (...now) => { pending = now; drawSaved(); });
on("away", (now) => {
  if (now === away) return;
  away = now;
  drawSaved();
  if (!away && state.info && player.shown?.index !== player.wanted) player.show(player.wanted);
});
on("mode", () => {
  for (const part of document.querySelectorAll("[data-in]")) part.hidden = part.dataset.in !== state.mode;
  drawTitle();
});

/** What the page is for now. */
function drawTitle() {
  $("title").textContent = state.mode === "grasps" ? "Grasps and segments" : invited ? "Draft" : "Labels";
  document.title = [$("title").textContent, state.task?.key].filter(Boolean).join(", ");
}

// ---- keys and buttons ----------------------------------------------------------------------------------------------

function play() {
  if (player.playing) player.pause();
  else {
    const at = player.wanted, [, end] = state.labels?.extent ?? [state.info.first, state.info.last];
    const last = at < end ? end : state.info.frames - 1;
    player.play(last, () => Number($("speed").value)).then(drawPlay);
  }
  drawPlay();
}

function drawPlay() {
  $("play").textContent = player.playing ? "❚❚ Pause" : "▶ Play";
}

/** Label the chosen grasp, else the whole interaction, else the first grasp. */
function label() {
  const finished = grasps.grasps().filter((mark) => mark.end !== null), all = state.interaction;
  const mark = finished.find((one) => one.mark === state.chosen) ?? (all?.mark ? all : finished[0]);
  if (mark) labelling.begin(mark);
  else problem("Mark the start and the end of a grasp first: its frames can be labelled then.");
}

const keyList = () => document.querySelector(`.keys[data-in=${state.mode}]`);

const COMMON = {
  "ArrowLeft": (event) => move(player.wanted - (event.shiftKey ? 10 : 1)),
  "ArrowRight": (event) => move(player.wanted + (event.shiftKey ? 10 : 1)),
  " ": play,
  "n": () => step(1),
  "p": () => step(-1),
  "l": label,
  "?": () => { keyList().open = !keyList().open; },
  ...VIEW,
};
const MODES = { grasps: { ...COMMON, ...grasps.KEYS, ...segments.KEYS }, labels: { ...COMMON, ...labelling.KEYS } };
const WITHOUT_FRAMES = new Set(["n", "p"]);
const WHILE_PLAYING = new Set([" ", "s", "e", ...Object.keys(segments.KEYS), ...Object.keys(VIEW)]);
const REPEATED = new Set(["w", "a", "x", "d"]); // beside the arrows

function press(key, event) {
  const keys = MODES[state.mode];
  if (!keys[key] || !state.task || (!state.info && !WITHOUT_FRAMES.has(key))) return false;
  if (player.playing && !WHILE_PLAYING.has(key)) player.pause();
  keys[key](event);
  return true;
}

/** A button that has the focus is pressed by space and Enter; one that was clicked with the mouse loses it. */
const PRESSED = "button, summary, a, input[type=checkbox]";
document.addEventListener("click", (event) => { if (event.detail) event.target.closest?.(PRESSED)?.blur(); });

document.addEventListener("keydown", (event) => {
  if ($("name").open || ([" ", "Enter"].includes(event.key) && event.target.matches(PRESSED))) return;
  if (event.target.matches("input:not([type=checkbox]), select")) {
    if (event.key === "Enter" || event.key === "Escape") event.target.blur();
    return;
  }
  const undoes = (event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z";
  if (!undoes && (event.ctrlKey || event.metaKey || event.altKey)) return;
  const key = undoes ? "u" : event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.repeat && !key.startsWith("Arrow") && !(state.mode === "labels" && REPEATED.has(key))) return;
  if (event.repeat && player.shown?.index !== player.wanted) return event.preventDefault(); // no faster than frames come
  if (key === "Escape" && keyList().open) keyList().open = false;
  else if (press(key, event)) event.preventDefault();
});

for (const button of document.querySelectorAll("[data-key]")) {
  button.onclick = (event) => press(button.dataset.key, event);
}
$("speed").onchange = () => $("speed").blur();
$("back").onclick = labelling.end;
$("unseen").onclick = unseen;
on("label", labelling.begin);

// ---- beginning -----------------------------------------------------------------------------------------------------

function askName() {
  $("name-field").value = state.annotator ?? "";
  $("name").showModal();
}
$("annotator").onclick = askName;
$("name").onclose = () => {
  const name = $("name-field").value.trim();
  if (name) begin(name);
  else if (!state.annotator) askName();
};

async function begin(name) {
  try {
    const before = state.task?.key ?? decodeURIComponent(location.hash.slice(1));
    if (state.mode === "labels") labelling.end(); // they are somebody else's
    state.annotator = name;
    await overview();
    grasps.drawAgreement();
    localStorage.setItem("getagrip-annotator", name);
    $("annotator").textContent = name;
    await saving.flush(); // what an earlier page could not send
    const [last, grasp] = state.last ?? [];
    const next = state.tasks.find((task) => task.key === before) ?? state.tasks.find((task) => task.key === last) ?? (name === invited ? state.tasks.find((task) => task.state && task.found) : null) ?? state.tasks.find((task) => !task.state && task.found) ?? state.tasks.find((task) => task.found);
    await openTask(next);
    const known = [...state.marks, ...(state.interaction ? [state.interaction] : [])];
    const whole = known.filter((mark) => mark.mark && mark.end !== null);
    const labelled = whole.find((mark) => mark.mark === labels.before()) ?? (next?.key !== before ? whole.find((mark) => mark.mark === grasp) : undefined) ?? (name === invited ? whole[0] : undefined);
    if (labelled) await labelling.begin(labelled);
  } catch (error) {
    problem(error);
    if (error instanceof Away) return setTimeout(() => begin(name), POLL);
    state.annotator = null;
    askName();
  }
}

let asked = 0;
setInterval(() => {
  const working = ["waiting", "running"].includes(state.labels?.job?.state);
  if (document.visibilityState !== "visible" || saving.sending || Date.now() - asked < (working ? POLL_WORK : POLL)) return;
  asked = Date.now();
  refresh(false);
  labels.refresh();
}, POLL_WORK / 2);
if (!invited) drawTitle();
if (state.annotator) begin(state.annotator);
else askName();
