// The key frames of one grasp, with joints and polygons, and the drafts that the server makes from them.

import { ask, on, player, post, problem, saving, state, emit } from "./app.js";
import { Away, fresh, tab } from "./saving.js";

const SETTLE = 600; // ms after the last of several small moves until they are sent as one
const KEY = "getagrip-labelled"; // the grasp that this tab labels, for reloads

const who = () => state.labels.about;
const outlined = (one) => one.hidden || Object.values(one.outlines).some((outline) => outline.closed && ["object", "on"].includes(outline.of));
const blank = (frame) => ({ frame, joints: {}, outlines: {}, hidden: false, outlined: false });

let moved = null; // {frame, set}: moved here, not sent yet
let settling;

/** The labels of a frame. */
export const at = (frame) => state.labels.keyframes.get(frame) ?? blank(frame);
export const here = () => at(player.wanted);
export const draft = (kind, frame) => state.labels.drafts[kind].get(frame);

/** What a draft of a frame would be made of now, in a word; undefined where there is nothing to make it of. */
const basis = (kind, frame) => state.labels.basis[kind].find(([first, last]) => first <= frame && frame <= last)?.[2];
/** Whether what was filled in on a frame was made of something else. */
export const stale = (kind, frame) => draft(kind, frame)?.basis !== basis(kind, frame);
/** Whether anything could be filled in on a frame that is not there, or was made of something else. */
export const missing = (frame) => ["masks", "hand"].some((kind) => basis(kind, frame) && stale(kind, frame));

/** Begin to label a grasp; resolves once its key frames are there. */
export async function open(mark) {
  const about = { task: state.task.key, annotator: state.annotator, grasp: mark };
  const labels = await ask("/api/labels", about);
  state.labels = { about, grasp: mark, keyframes: new Map(), drafts: { masks: new Map(), hand: new Map() }, seen: 0 };
  sessionStorage.setItem(KEY, mark);
  state.labels.settings = labels.settings;
  take(labels);
}

export function close() {
  settle();
  state.labels = null;
  sessionStorage.removeItem(KEY);
}

/** The grasp that was being labelled before a reload. */
export const before = () => sessionStorage.getItem(KEY);

/** What the server says of the grasp. */
function take(answer) {
  const labels = state.labels;
  if (!labels || answer.grasp !== labels.grasp) return;
  [labels.job, labels.wanted, labels.result, labels.state] = [answer.job, answer.wanted, answer.result, answer.state];
  const old = answer.newest < labels.newest; // it was asked before a change that is answered already
  if (!old && !saving.waiting.length && !moved) { // else its answer comes after what is still on its way
    const { newest, extent, side, size, fewest, basis, found } = answer;
    Object.assign(labels, { newest, extent, side, size, fewest, basis, found });
    labels.keyframes = new Map(answer.keyframes.map((one) => [one.frame, { ...one, outlined: outlined(one) }]));
  }
  if (answer.drafts > labels.seen) fetchDrafts(labels);
  emit("labels");
}

async function fetchDrafts(labels) {
  if (labels.fetching) return;
  labels.fetching = true;
  try {
    for (let got = null; got === null || got.length;) {
      const answer = await ask("/api/drafts", { ...who(), since: labels.seen });
      got = answer.drafts;
      for (const one of got) {
        labels.drafts[one.kind].set(one.frame, one);
        labels.seen = one.seq;
      }
      if (state.labels !== labels) return;
    }
    emit("labels");
  } catch { /* asked again */ } finally {
    labels.fetching = false;
  }
}

/** Ask whether anything is new: in another tab, or in the work that the server does. */
export async function refresh() {
  const labels = state.labels;
  if (!labels || moved) return;
  try {
    const answer = await ask("/api/labels", who());
    const same = answer.newest === labels.newest && answer.drafts === labels.seen && JSON.stringify(answer.extent) === JSON.stringify(labels.extent);
    if (!same || JSON.stringify([answer.job, answer.result]) !== JSON.stringify([labels.job, labels.result])) take(answer);
    if (labels.asked && !saving.waiting.length) work(...labels.asked);
  } catch { /* the server is away: saving reports it */ }
}

// ---- changes -------------------------------------------------------------------------------------------------------

const without = (values) => Object.fromEntries(Object.entries(values).filter(([, value]) => value !== null));

/** Apply a change to the labels of a frame, as the server does. */
function lay(frame, set) {
  const old = set.deleted ? blank(frame) : at(frame);
  const one = {
    frame, number: old.number ?? (player.shown?.index === frame ? player.shown.number : undefined), hidden: set.hidden ?? old.hidden,
    joints: without({ ...old.joints, ...set.joints }), outlines: without({ ...old.outlines, ...set.outlines }),
  };
  one.outlined = outlined(one);
  if (one.hidden || Object.keys(one.joints).length || Object.keys(one.outlines).length) state.labels.keyframes.set(frame, one);
  else state.labels.keyframes.delete(frame);
}

function send(frame, set) {
  saving.add("/api/label", { ...who(), frame, change: fresh(), tab, set });
}

/** Change a frame here at once, and there as soon as it can be sent. */
export function change(frame, set) {
  settle();
  problem(null);
  lay(frame, set);
  emit("labels");
  send(frame, set);
}

/** One of many small moves, of which the last counts. */
export function adjust(frame, set) {
  if (moved && moved.frame !== frame) settle();
  moved = { frame, set: { joints: { ...moved?.set.joints, ...set.joints }, outlines: { ...moved?.set.outlines, ...set.outlines } } };
  lay(frame, set);
  emit("labels");
  clearTimeout(settling);
  settling = setTimeout(settle, SETTLE);
}

/** Send what was moved. */
export function settle() {
  clearTimeout(settling);
  if (!moved) return;
  const { frame, set } = moved;
  moved = null;
  send(frame, without({ joints: Object.keys(set.joints).length ? set.joints : null, outlines: Object.keys(set.outlines).length ? set.outlines : null }));
}

export function undo() {
  settle();
  problem(null);
  saving.add("/api/unlabel", { ...who(), change: fresh(), tab });
}

/** Have the server "propagate", write "files", "reconstruct", or "cancel". */
export async function work(what, about = {}) {
  settle();
  await saving.flush();
  const labels = state.labels;
  labels.asked = null;
  try {
    const answer = await post("/api/work", { ...who(), ...about, work: what, project: saving.project });
    problem(null);
    take(answer);
  } catch (error) {
    if (error instanceof Away) Object.assign(labels, { job: null, asked: what === "cancel" ? null : [what, about] }); // asked again when it is back
    problem(error);
    emit("labels");
  }
}

on("answer", (path, sent, answer) => {
  if (!["/api/label", "/api/unlabel"].includes(path) || sent.grasp !== state.labels?.grasp) return;
  take(answer);
  if (path === "/api/unlabel") emit("undone", answer.undone, answer.frame);
});
on("refused", () => state.labels && ask("/api/labels", who()).then(take, () => {}));
addEventListener("pagehide", () => state.labels && settle());
