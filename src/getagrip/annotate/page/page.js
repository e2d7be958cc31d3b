// The page: keys and buttons in, marks and frames out. What is kept is kept by the server (saving.js).

import { Player } from "./player.js";
import { Saving, fresh, tab } from "./saving.js";

const $ = (id) => document.getElementById(id);
const REASONS = {
  "no stable grasp": "the hold changes all the time, or nothing is held",
  "out of view": "neither hand nor object is seen",
  "other CAD": "the thing has not the shape of its kind",
};
const POLL = 1500; // ms between questions whether another tab has changed something
const COMPARE = 1500; // ms after the last change until people are compared again

const state = {
  annotator: localStorage.getItem("getagrip-annotator"),
  tasks: [], categories: [], reasons: [],
  task: null, // the one that is open
  info: null, // its frames
  marks: [], newest: -1,
  chosen: null, // mark whose start and end are being moved
  defaults: {}, // hand and object of the next mark
};

const player = new Player($("picture"), onShown, (on) => $("waiting").classList.toggle("on", on), problem);
const saving = new Saving(onAnswer, onRefused, onPending);

// ---- what the server says ------------------------------------------------------------------------------------------

async function ask(path, parameters) {
  const answer = await fetch(`${path}?${new URLSearchParams(parameters)}`);
  const body = await answer.json();
  if (!answer.ok) throw new Error(body.error);
  return body;
}

function problem(text) {
  $("problem").textContent = text ?? "";
  $("problem").hidden = !text;
}

function onAnswer(path, sent, answer) {
  if (sent.task === state.task?.key && sent.annotator === state.annotator) take(answer);
  if (path === "/api/undo" && answer.undone === false) say("Nothing left to undo in this tab.");
  clearTimeout(state.compare);
  state.compare = setTimeout(drawAgreement, COMPARE);
}

function onRefused(text) {
  problem(text);
  refresh(true);
}

function onPending(count, reason) {
  $("saved").className = count ? "pending" : "";
  if (reason) $("saved").textContent = `Not saved, ${reason}: ${count} change${count > 1 ? "s" : ""} kept here, tried again`;
  else $("saved").textContent = count ? "Saving …" : "All saved";
}

/** The marks of the open task as the server has them. */
function take(answer) {
  if (saving.waiting.length) return; // its answer comes after what is still on its way
  state.marks = answer.marks;
  state.newest = answer.newest;
  if (!state.marks.some((mark) => mark.mark === state.chosen)) state.chosen = null;
  const now = state.marks.some((mark) => mark.end !== null) ? "marked" : discarded() ? "discarded" : state.marks.length ? "started" : "";
  if (now !== state.task.state) {
    state.task.state = now;
    drawTasks();
  }
  draw();
}

async function refresh(always) {
  if (!state.task || !state.annotator) return;
  const task = state.task.key;
  try {
    const answer = await ask("/api/marks", { task, annotator: state.annotator });
    if (task === state.task.key && (always || answer.newest !== state.newest)) take(answer);
  } catch { /* the server is away: saving tells */ }
}

async function overview() {
  const { project, tasks, categories, reasons } = await ask("/api/tasks", { annotator: state.annotator });
  Object.assign(state, { tasks, categories, reasons });
  saving.project = project;
  drawTasks();
  drawAgreement();
}

// ---- tasks ---------------------------------------------------------------------------------------------------------

async function openTask(task) {
  Object.assign(state, { task, info: null, marks: [], newest: -1, chosen: null });
  state.defaults = { side: task.side ?? state.defaults.side ?? "right", category: task.category ?? "", entity: task.entity ?? "" };
  location.hash = encodeURIComponent(task.key);
  problem(null);
  player.close();
  draw();
  drawTasks();
  $("where").textContent = `${task.key} · opening …`;
  try {
    const info = await ask("/api/task", { task: task.key });
    if (state.task !== task) return;
    state.info = info;
    player.open(task.key, info);
    $("where").textContent = task.key;
    await refresh(true);
    const own = state.marks.filter((mark) => mark.category);
    if (!task.category && own.length) state.defaults = pick(own.at(-1), "side", "category", "entity");
    draw();
    await player.show(info.first);
  } catch (error) {
    if (state.task !== task) return;
    $("where").textContent = task.key;
    problem(error.message);
  }
}

const pick = (from, ...keys) => Object.fromEntries(keys.map((key) => [key, from[key] ?? ""]));

function step(by) {
  const at = state.tasks.findIndex((task) => task.key === state.task?.key);
  const next = state.tasks[at + by];
  if (next) openTask(next);
}

// ---- marks ---------------------------------------------------------------------------------------------------------

const grasps = () => state.marks.filter((mark) => mark.start !== null);
const discarded = () => state.marks.find((mark) => mark.reason);
const target = () => state.marks.find((mark) => mark.mark === state.chosen) ?? grasps().find((mark) => mark.end === null);

/** Change a mark here at once, and there as soon as it can be sent. */
function change(mark, set) {
  const old = state.marks.find((one) => one.mark === mark);
  const empty = { mark, start: null, end: null, reason: null, category: null, entity: null, side: null };
  state.marks = state.marks.filter((one) => one !== old);
  if (!set.deleted) state.marks.push({ ...(old ?? empty), ...set, start_number: null, end_number: null, seconds: null });
  state.marks.sort((a, b) => (a.start ?? 0) - (b.start ?? 0));
  problem(null);
  draw();
  saving.add("/api/change", { change: fresh(), mark, task: state.task.key, annotator: state.annotator, tab, set });
}

function defaults() {
  const { side, category, entity } = state.defaults;
  return { side, ...(category && { category }), ...(entity && { entity }) };
}

function start() {
  if (discarded()) return say("This clip is discarded: undo that first.");
  const mark = target();
  if (mark && mark.end !== null && player.at > mark.end) return say("A grasp cannot start after its end: move the end first.");
  if (mark) change(mark.mark, { start: player.at });
  else change(fresh(), { start: player.at, ...defaults() });
}

function end() {
  const mark = target();
  if (!mark) return say("Mark the start first: go there and press s.");
  if (player.at < mark.start) return say("A grasp cannot end before it starts.");
  change(mark.mark, { end: player.at });
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

/** Hand or object of the chosen grasp, or else of the one without an end, and of those to come. */
function describe(set) {
  const mark = target() ?? (grasps().length === 1 ? grasps()[0] : null);
  for (const [key, value] of Object.entries(set)) state.defaults[key] = value;
  if (mark && Object.values(set).every((value) => value)) change(mark.mark, set);
  else if (!mark && grasps().length > 1) say("This holds for the next grasp. To change one of those below, click on it first.");
  draw();
}

function choose(mark) {
  state.chosen = state.chosen === mark?.mark ? null : mark?.mark ?? null;
  if (state.chosen) {
    state.defaults = pick(mark, "side", "category", "entity");
    player.pause();
    player.show(mark.start);
  }
  draw();
}

// ---- drawing -------------------------------------------------------------------------------------------------------

/** First and last frame on the timeline: the rough extent with some of what is around it. */
function view() {
  const { first, last, frames, fps } = state.info;
  const margin = Math.round(Math.max(2 * fps, (last - first) / 5));
  const at = player.wanted;
  return [Math.max(0, Math.min(first - margin, at)), Math.min(frames - 1, Math.max(last + margin, at))];
}

const clock = (seconds) => `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(2).padStart(5, "0")}`;

function element(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

function onShown({ number, time }) {
  $("frame").textContent = number;
  $("time").textContent = `${clock(time)}`;
  drawTimeline();
}

function drawTimeline() {
  if (!state.info) return;
  const [first, last] = view();
  const part = (index) => `${100 * (index - first) / (last - first + 1)}%`;
  const place = (made, from, to) => Object.assign(made.style, { left: part(from), width: `calc(${part(to + 1)} - ${part(from)})` });
  place($("rough"), state.info.first, state.info.last);
  $("cursor").style.left = part((player.shown?.index ?? first) + 0.5);
  $("contact").hidden = state.info.contact === null;
  $("contact").style.left = part((state.info.contact ?? 0) + 0.5);
  $("bars").replaceChildren(...grasps().map((mark, n) => {
    const bar = element("div", { textContent: n + 1, title: `Grasp ${n + 1}` });
    bar.classList.toggle("open", mark.end === null);
    bar.classList.toggle("chosen", mark.mark === state.chosen);
    place(bar, mark.start, mark.end ?? Math.max(mark.start, player.shown?.index ?? 0));
    return bar;
  }));
  $("scale-first").textContent = clock(first / state.info.fps);
  $("scale-last").textContent = clock(last / state.info.fps);
}

function nextStep() {
  const mark = target(), n = grasps().indexOf(mark) + 1;
  if (!state.info) return "";
  if (discarded()) return "This clip is discarded. Choose the reason again to take it back, or go to the next.";
  if (state.chosen) return `Moving grasp ${n}: s sets its start, e its end, Esc when done.`;
  if (mark) return `Grasp ${n} has started. Go to its last stable frame and press e.`;
  if (grasps().some((one) => !one.category)) return "Say which kind of object it is, so that the grasp can be exported.";
  return grasps().length ? "Go on: s starts another grasp. Click on a grasp to change it." : "Go to the first frame of the grasp and press s.";
}

function say(text) {
  $("next-step").textContent = text;
}

function drawMarks() {
  const rows = grasps().map((mark, n) => {
    const number = (value, index) => value ?? (index === null ? "…" : `#${index}`);
    const remove = element("button", { textContent: "✕", title: "Delete this grasp", onclick: (event) => { event.stopPropagation(); change(mark.mark, { deleted: true }); } });
    const about = [mark.side, mark.entity ?? mark.category ?? "object?", mark.seconds && `${mark.seconds.toFixed(2)} s`];
    const text = element("span", { className: "text" }, `${number(mark.start_number, mark.start)} – ${number(mark.end_number, mark.end)}`, element("small", { textContent: about.filter(Boolean).join(" · ") }));
    return element("li", { className: mark.mark === state.chosen ? "chosen" : "", title: "Click to change", onclick: () => choose(mark) }, element("b", { textContent: n + 1 }), text, remove);
  });
  $("marks").replaceChildren(...rows);
}

function draw() {
  const mark = target() ?? (grasps().length === 1 ? grasps()[0] : null);
  const about = mark ? { ...state.defaults, ...pick(mark, "side", "category", "entity") } : state.defaults;
  for (const button of $("side").children) button.ariaChecked = String(button.dataset.side === about.side);
  for (const key of ["category", "entity"]) if (document.activeElement !== $(key)) $(key).value = about[key] ?? "";
  $("category").classList.toggle("wanted", Boolean(mark && !mark.category));
  $("categories").replaceChildren(...state.categories.map((value) => element("option", { value })));
  $("reasons").replaceChildren(...state.reasons.map((reason, n) => {
    const button = element("button", { onclick: () => discard(reason), disabled: !state.info || grasps().length > 0 }, element("kbd", { textContent: n + 1 }), ` ${reason} `, element("small", { textContent: REASONS[reason] }));
    button.ariaPressed = String(discarded()?.reason === reason);
    return button;
  }));
  drawMarks();
  drawTimeline();
  say(nextStep());
}

function drawTasks() {
  $("tasks").hidden = state.tasks.length < 2;
  const done = state.tasks.filter((task) => ["marked", "discarded"].includes(task.state)).length;
  $("progress").textContent = `${done} of ${state.tasks.length} done`;
  const signs = { marked: "✓", discarded: "✕", started: "…" };
  $("task-list").replaceChildren(...state.tasks.map((task) => {
    const about = [task.start !== null && `${task.start}–${task.end}`, task.found ? task.side : "no footage"].filter(Boolean).join(" · ");
    const text = element("span", {}, [task.video, task.entity ?? task.category].filter(Boolean).join(" · "), element("small", { textContent: about }));
    const button = element("button", { onclick: () => openTask(task), title: task.key, className: task.found ? "" : "missing" }, element("i", { textContent: signs[task.state] ?? "" }), text);
    if (task.key === state.task?.key) button.ariaCurrent = "true";
    return element("li", {}, button);
  }));
  $("task-list").querySelector("[aria-current]")?.scrollIntoView({ block: "nearest" });
}

async function drawAgreement() {
  for (const kind of ["csv", "json"]) $(kind).href = `/grasps.${kind}?${new URLSearchParams({ annotator: state.annotator })}`;
  const { pairs } = await ask("/api/agreement", {});
  const line = (pair) => `${pair.first} and ${pair.second}: ${pair.iou === null ? "no grasps to compare" : `temporal IOU ${(100 * pair.iou).toFixed(1)} % over ${pair.grasps} grasp${pair.grasps === 1 ? "" : "s"}`} in ${pair.tasks} clip${pair.tasks === 1 ? "" : "s"}`;
  $("agreement").textContent = pairs.length ? pairs.map(line).join("\n") : "Agreement is shown once two people have marked a clip.";
}

// ---- keys and buttons ----------------------------------------------------------------------------------------------

function play() {
  if (player.playing) player.pause();
  else {
    const at = player.wanted;
    const last = at < state.info.last ? state.info.last : state.info.frames - 1;
    player.play(last, () => Number($("speed").value)).then(drawPlay);
  }
  drawPlay();
}

function drawPlay() {
  $("play").textContent = player.playing ? "❚❚ Pause" : "▶ Play";
}

function move(to) {
  player.pause();
  player.show(to);
}

const KEYS = {
  "ArrowLeft": (event) => move(player.wanted - (event.shiftKey ? 10 : 1)),
  "ArrowRight": (event) => move(player.wanted + (event.shiftKey ? 10 : 1)),
  "Home": () => move(state.info.first),
  "End": () => move(state.info.last),
  " ": play,
  "s": start,
  "e": end,
  "u": undo,
  "h": () => describe({ side: (target() ?? state.defaults).side === "left" ? "right" : "left" }),
  "1": () => discard(state.reasons[0]),
  "2": () => discard(state.reasons[1]),
  "3": () => discard(state.reasons[2]),
  "n": () => step(1),
  "p": () => step(-1),
  "Delete": () => state.chosen && change(state.chosen, { deleted: true }),
  "Backspace": () => state.chosen && change(state.chosen, { deleted: true }),
  "Escape": () => choose(null),
};
const WITHOUT_FRAMES = new Set(["n", "p"]);

function press(key, event) {
  if (!KEYS[key] || !state.task || (!state.info && !WITHOUT_FRAMES.has(key))) return false;
  if (player.playing && key !== " " && key !== "s" && key !== "e") player.pause();
  KEYS[key](event);
  return true;
}

document.addEventListener("keydown", (event) => {
  if ($("name").open) return;
  if (event.target.matches("input, select")) {
    if (event.key === "Enter" || event.key === "Escape") event.target.blur();
    return;
  }
  const undoes = (event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z";
  if (!undoes && (event.ctrlKey || event.metaKey || event.altKey)) return;
  const key = undoes ? "u" : event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.repeat && !key.startsWith("Arrow")) return;
  if (event.repeat && player.shown?.index !== player.wanted) return event.preventDefault(); // no faster than frames come
  if (press(key, event)) event.preventDefault();
});

for (const button of document.querySelectorAll("[data-key]")) {
  button.onclick = (event) => { press(button.dataset.key, event); button.blur(); };
}
for (const button of $("side").children) button.onclick = () => { describe({ side: button.dataset.side }); button.blur(); };
for (const key of ["category", "entity"]) $(key).onchange = () => describe({ [key]: $(key).value.trim() });
$("speed").onchange = () => $("speed").blur();
$("undo").onclick = () => { undo(); $("undo").blur(); };

$("timeline").onpointerdown = (event) => {
  $("timeline").setPointerCapture(event.pointerId);
  const [first, last] = view(); // as it was when the drag began
  const seek = ({ clientX }) => {
    const { left, width } = $("timeline").getBoundingClientRect();
    const to = first + Math.floor((clientX - left) / width * (last - first + 1));
    move(Math.min(Math.max(to, first), last));
  };
  seek(event);
  $("timeline").onpointermove = seek;
  $("timeline").onpointerup = $("timeline").onpointercancel = () => { $("timeline").onpointermove = null; };
};

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
    state.annotator = name;
    await overview();
    localStorage.setItem("getagrip-annotator", name);
    $("annotator").textContent = name;
    await saving.flush(); // what an earlier page could not send
    const next = state.tasks.find((task) => task.key === before) ?? state.tasks.find((task) => !task.state && task.found) ?? state.tasks.find((task) => task.found);
    await openTask(next);
  } catch (error) {
    problem(error.message);
    state.annotator = null;
    askName();
  }
}

setInterval(() => { if (document.visibilityState === "visible" && !saving.sending) refresh(false); }, POLL);
if (state.annotator) begin(state.annotator);
else askName();
