// What all parts of the page share: its state, the frames, what is on its way to the server, and what happens.

import { Player } from "./player.js";
import { Away, Saving } from "./saving.js";

export const $ = (id) => document.getElementById(id);

/** Whose grasp the address asks to label, as in "#annotator=draft". */
export const invited = new URLSearchParams(location.hash.slice(1)).get("annotator");

export const state = {
  annotator: invited ?? localStorage.getItem("getagrip-annotator"),
  tasks: [], categories: [], reasons: [], kinds: [],
  task: null, // the one that is open
  info: null, // its frames
  marks: [], newest: -1,
  interaction: null, // what the server says of the marks as segments of one interaction
  chosen: null, // mark whose start and end are being moved
  defaults: {}, // hand and object of the next mark
  mode: "grasps", // or "labels"
  cross: null, // where the keyboard draws, in pixels of the footage
};

// "shown" (frame), "waiting" (bool), "problem" (text), "answer" (path, sent, answer), "refused" (text), "pending"
// (count, reason), "away" (whether the server is not reached), "tool" (another one is chosen), "task" (another one is opened), "marks" (they have changed), "drawn" (the list of them is), "label" (a mark is to be labelled).
const listeners = new Map();
export const on = (name, act) => listeners.set(name, [...(listeners.get(name) ?? []), act]);
export const emit = (name, ...about) => (listeners.get(name) ?? []).forEach((act) => act(...about));
const emitter = (name) => (...about) => emit(name, ...about);

export const player = new Player($("picture"), emitter("shown"), emitter("waiting"), (error) => problem(error));
export const saving = new Saving(emitter("answer"), emitter("refused"), emitter("pending"));

/** Fetch; where the server is away, that is said once beside "saved", and no other message is made of it. */
async function reach(path, options) {
  let answer;
  try {
    answer = await fetch(path, options);
  } catch {
    emit("away", true);
    throw new Away();
  }
  emit("away", false);
  const body = await answer.json();
  if (!answer.ok) throw new Error(body.error);
  return body;
}

export const ask = (path, parameters) => reach(`${path}?${new URLSearchParams(parameters)}`);
export const post = (path, content) => reach(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content) });

export function element(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

/** Say what went wrong; null: nothing does any more. */
export const problem = (what) => { if (!(what instanceof Away)) emit("problem", what?.message ?? what); };
export const pick = (from, ...keys) => Object.fromEntries(keys.map((key) => [key, from[key] ?? ""]));
export const clock = (seconds) => `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(2).padStart(5, "0")}`;
export const many = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;

export function move(to) {
  player.pause();
  player.show(to);
}
