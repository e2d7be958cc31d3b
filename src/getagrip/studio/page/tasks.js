// The list of clips, and opening one of them.

import { $, ask, element, on, pick, player, problem, saving, state, emit } from "./app.js";

const VERDICTS = ["right", "uncertain", "wrong"], DONE = ["marked", "discarded", ...VERDICTS];
const FILTERS = {
  all: () => true,
  open: (task) => !DONE.includes(task.state),
  amiss: (task) => ["uncertain", "wrong"].includes(task.state),
  done: (task) => DONE.includes(task.state),
};
const listed = () => state.tasks.filter(FILTERS[$("filter").value]);
const WORDS = { "not begun": "not begun", drawn: "drawn, no result", right: "looks right", uncertain: "uncertain", wrong: "looks wrong", discarded: "skipped" };

/** How far the open clip is, as the server says. */
function lay(now) {
  if (now === undefined || now === state.task.state) return;
  state.task.state = now;
  drawTasks();
}
on("labels", () => state.labels && lay(state.labels.state));

export async function overview() {
  const { project, tasks, categories, reasons, kinds, last } = await ask("/api/tasks", { annotator: state.annotator });
  Object.assign(state, { tasks, categories, reasons, kinds, last });
  saving.project = project;
  drawTasks();
}

export async function openTask(task) {
  Object.assign(state, { task, info: null, marks: [], newest: -1, interaction: null, chosen: null });
  state.defaults = { side: task.side ?? null, category: task.category ?? "", entity: task.entity ?? "" };
  location.hash = encodeURIComponent(task.key);
  problem(null);
  player.close();
  emit("task");
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
    emit("task");
    if (player.shown === null) await player.show(player.wanted);
  } catch (error) {
    if (state.task !== task) return;
    $("where").textContent = task.key;
    problem(error);
  }
}

/** Open the next or the previous clip of those that are listed. */
export function step(by) {
  const place = (task) => state.tasks.indexOf(task), at = place(state.task), some = by > 0 ? listed() : listed().reverse();
  const next = some.find((task) => by * (place(task) - at) > 0);
  if (next) openTask(next);
}

/** The marks of the open task as the server has them. */
function take(answer) {
  if (saving.waiting.length) return; // its answer comes after what is still on its way
  state.marks = answer.marks;
  state.interaction = answer.interaction;
  state.newest = answer.newest;
  if (!state.marks.some((mark) => mark.mark === state.chosen)) state.chosen = null;
  lay(answer.state);
  emit("marks");
}

export async function refresh(always) {
  if (!state.task || !state.annotator) return;
  const task = state.task.key;
  try {
    const answer = await ask("/api/marks", { task, annotator: state.annotator });
    if (task === state.task.key && (always || answer.newest > state.newest)) take(answer); // not what was asked before a change that is answered already
  } catch { /* the server is away: saving reports it */ }
}

on("answer", (path, sent, answer) => {
  if (["/api/change", "/api/undo"].includes(path) && sent.task === state.task?.key && sent.annotator === state.annotator) take(answer);
});
on("refused", () => refresh(true));

function drawTasks() {
  $("tasks").hidden = state.tasks.length < 2;
  const done = state.tasks.filter(FILTERS.done).length, some = listed();
  $("progress").textContent = `${done} of ${state.tasks.length} done`;
  const signs = { marked: "✓", discarded: "✕", started: "…", drawn: "✎", right: "✓", uncertain: "?", wrong: "!" };
  $("none-listed").hidden = some.length > 0;
  $("task-list").replaceChildren(...some.map((task) => {
    const about = [task.start !== null && `${task.start}–${task.end}`, task.found ? task.side : "no footage", WORDS[task.state]].filter(Boolean).join(" · ");
    const text = element("span", {}, [task.video, task.entity ?? task.category].filter(Boolean).join(" · "), element("small", { textContent: about }));
    const button = element("button", { onclick: () => openTask(task), title: task.key, className: task.found ? "" : "missing" }, element("i", { textContent: signs[task.state] ?? "" }), text);
    if (task.key === state.task?.key) button.ariaCurrent = "true";
    return element("li", {}, button);
  }));
  $("task-list").querySelector("[aria-current]")?.scrollIntoView({ block: "nearest" });
}

$("filter").onchange = () => { drawTasks(); $("filter").blur(); };
