// Shows frames by index. What was fetched last is kept; while playing, what comes next is fetched ahead.

import { Away } from "./saving.js";

const KEPT = 300; // frames, as compressed images
const KEPT_WHOLE = 60; // of those that are not made smaller
const AHEAD = 24; // frames fetched ahead of the one that is shown, while playing
const AT_ONCE = 4; // requests

export class Player {
  /** `onShown(frame)` is called with {index, time, number} of each frame drawn; `onProblem(error)` with what went wrong. */
  constructor(canvas, onShown, onWaiting, onProblem) {
    Object.assign(this, { canvas, onShown, onWaiting, onProblem });
    this.frames = new Map();
    this.loading = new Map();
    this.shown = null; // {index, time, number}
    this.wanted = 0;
    this.playing = false;
    this.whole = false; // all pixels of wide frames
    this.epoch = 0;
  }

  /** Show nothing. */
  close() {
    this.pause();
    this.epoch += 1;
    this.frames.clear();
    this.loading = new Map();
    this.shown = null;
    this.canvas.getContext("2d").clearRect(0, 0, this.canvas.width, this.canvas.height);
  }

  /** Another task: `info` as the server describes its frames. */
  open(task, info) {
    this.close();
    Object.assign(this, { task, info, wanted: info.first });
  }

  /** Frames as they are, from now on, or made smaller where they are wide. */
  look(whole) {
    this.pause();
    this.whole = whole;
    this.epoch += 1;
    this.frames.clear();
    this.loading = new Map();
  }

  /** Draw a frame; resolves to it once it is on the screen, to null where another was wanted meanwhile. */
  async show(index) {
    this.wanted = Math.min(Math.max(index, 0), this.info.frames - 1);
    const wanted = this.wanted, epoch = this.epoch;
    const late = setTimeout(() => this.onWaiting(true), 120);
    try {
      const frame = await this.fetch(wanted);
      if (this.wanted !== wanted || this.epoch !== epoch) return null;
      const bitmap = await createImageBitmap(frame.blob);
      if (this.wanted !== wanted || this.epoch !== epoch) return null;
      this.canvas.width = bitmap.width;
      this.canvas.height = bitmap.height;
      this.canvas.getContext("2d").drawImage(bitmap, 0, 0);
      bitmap.close();
      this.shown = { index: wanted, time: frame.time, number: frame.number };
      this.onShown(this.shown);
      return this.shown;
    } catch (error) {
      if (this.epoch === epoch && this.wanted === wanted) {
        this.pause();
        this.onProblem(error);
      }
      return null;
    } finally {
      clearTimeout(late);
      if (this.wanted === wanted && this.epoch === epoch) this.onWaiting(false);
    }
  }

  /** The frame to mark: while playing the one on the screen, else the one that was asked for last. */
  get at() {
    return this.playing ? this.shown.index : this.wanted;
  }

  fetch(index) {
    if (this.frames.has(index)) {
      const frame = this.frames.get(index);
      this.frames.delete(index);
      this.frames.set(index, frame);
      return Promise.resolve(frame);
    }
    if (!this.loading.has(index)) {
      const loading = this.loading, epoch = this.epoch;
      const done = this.load(index).then((frame) => {
        if (epoch === this.epoch) this.keep(index, frame);
        return frame;
      }).finally(() => loading.get(index) === done && loading.delete(index));
      loading.set(index, done);
    }
    return this.loading.get(index);
  }

  async load(index) {
    const answer = await fetch(`/frame?task=${encodeURIComponent(this.task)}&n=${index}${this.whole ? "&whole=1" : ""}`).catch(() => { throw new Away(); });
    if (!answer.ok) throw new Error((await answer.json()).error);
    return {
      blob: await answer.blob(),
      time: Number(answer.headers.get("X-Time")),
      number: Number(answer.headers.get("X-Number")),
    };
  }

  keep(index, frame) {
    this.frames.set(index, frame);
    for (const old of this.frames.keys()) {
      if (this.frames.size <= (this.whole ? KEPT_WHOLE : KEPT)) break;
      this.frames.delete(old);
    }
  }

  /** Play from the frame on screen to `last`, in real time times `speed()`; slower where frames come too slowly. */
  async play(last, speed) {
    if (!this.shown || this.playing) return;
    this.playing = true;
    const epoch = this.epoch;
    let from = this.shown.index, began = performance.now(), pace = speed();
    while (this.playing && this.epoch === epoch && this.shown.index < last) {
      if (pace !== speed()) [from, began, pace] = [this.shown.index, performance.now(), speed()];
      const due = from + Math.floor((performance.now() - began) / 1000 * this.info.fps * pace);
      let next = Math.min(Math.max(due, this.shown.index), last);
      while (next > this.shown.index && !this.frames.has(next)) next -= 1; // what is there by now
      if (next < Math.min(due, last)) [from, began] = [next, performance.now()]; // too slow: do not run after it
      if (next > this.shown.index) await this.show(next);
      for (let k = 1; k <= AHEAD && this.loading.size < AT_ONCE; k += 1) {
        const ahead = this.shown.index + k;
        if (ahead <= last && !this.frames.has(ahead)) this.fetch(ahead).catch((error) => this.playing && (this.pause(), this.onProblem(error)));
      }
      await new Promise(requestAnimationFrame);
    }
    if (this.epoch === epoch) this.pause();
  }

  pause() {
    this.playing = false;
  }
}
