"use strict";
// The page of one result, or of several side by side, with one clock and one eye for all.

const COLOURS = ["#2a7f9e", "#c8553d", "#7b5ea7", "#d19a2a", "#4f8a4f", "#a0466f"];  // of columns that are several

/** The frame that is shown, everywhere at once. */
class Player {
  constructor({ frames, times }, columns) {
    Object.assign(this, { frames, times, columns, plots: [], place: 0, wanted: 0, drawing: null, playing: null });
    Object.assign(byId("slider"), { max: frames.length - 1, value: 0, oninput: () => this.show(Number(byId("slider").value)) });
    byId("play").onclick = () => (this.playing ? this.stop() : this.play());
    byId("back").onclick = () => this.step(-1);
    byId("forth").onclick = () => this.step(1);
    document.onkeydown = (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
      const pressed = document.querySelector(`[aria-keyshortcuts="${CSS.escape(event.key)}"]:not([hidden])`);  // of letters, wherever the focus is
      const moves = { " ": () => byId("play").click(), ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1) };
      const act = pressed ? () => pressed.click() : !["INPUT", "BUTTON", "SUMMARY"].includes(event.target.tagName) && moves[event.key];
      if (!act) return;
      event.preventDefault();
      act();
    };
  }

  /** Go to a frame; the promise is kept when it is drawn. */
  show(place) {
    this.place = place;
    byId("slider").value = place;
    const { n, name, kind } = this.frames[place];
    byId("frame").textContent = `frame ${name}${kind === "sampled" ? "" : `, ${kind}`}  ·  ${this.times[n].toFixed(2)} s  ·  ${place + 1} of ${this.frames.length}`;
    for (const plot of this.plots) plot.show(n);
    return this.draw();
  }

  /** Draw the frame, and the one that is wanted by then, and so on. */
  draw() {
    this.wanted += 1;
    this.drawing ||= this.drawAll().finally(() => (this.drawing = null));
    return this.drawing;
  }

  async drawAll() {
    for (let drawn = null; drawn !== this.wanted; ) {
      drawn = this.wanted;
      const { place } = this;
      const frames = await Promise.all(this.columns.map((column) => column.frame(place).catch((error) => error)));
      this.columns.forEach((column, k) => (frames[k] instanceof Error ? column.unread(frames[k].message) : column.show(place, frames[k])));
    }
  }

  /** The frame that is played nearest to one of all frames. */
  jump(n) {
    this.stop();
    this.show(this.frames.reduce((best, frame, k) => (Math.abs(frame.n - n) < Math.abs(this.frames[best].n - n) ? k : best), 0));
  }

  step(by) {
    this.stop();
    this.show(Math.max(0, Math.min(this.frames.length - 1, this.place + by)));
  }

  /** Seconds of a frame; the last one stays a little. */
  lasts(place) {
    return place + 1 < this.frames.length ? this.times[this.frames[place + 1].n] - this.times[this.frames[place].n] : 0.5;
  }

  /** Play as the footage goes; frames that come too late are passed over. */
  async play() {
    const playing = (this.playing = {}), speed = () => Number(byId("speed").value);
    byId("play").textContent = "❚❚ Pause";
    for (let due = performance.now(); ; ) {
      const before = this.place, count = this.frames.length;
      due += (1000 * this.lasts(before)) / speed();
      let next = (before + 1) % count;
      while (next && next + 1 < count && due + (1000 * this.lasts(next)) / speed() < performance.now()) {
        due += (1000 * this.lasts(next)) / speed();
        next += 1;
      }
      due = Math.max(due, performance.now());
      await new Promise((done) => setTimeout(done, due - performance.now()));
      if (this.playing !== playing) return;
      const drawn = this.show(next), after = next + Math.max(next - before, 1);
      if (after < count) for (const column of this.columns) column.frame(after).catch(() => {});
      await drawn;
      if (this.playing !== playing) return;
    }
  }

  stop() {
    this.playing = null;
    byId("play").textContent = "▶ Play";
  }
}

/** The segments of a timeline under the slider, whose frames are those that are played; a click goes to its first one. */
function segmentBar({ frames, segments }, player) {
  const last = Math.max(frames.length - 1, 1);
  const at = (n) => frames.filter((frame) => frame.n < n).length;  // how many of them are before a frame
  const share = (place) => Math.max(0, Math.min(1, (place - 0.5) / last));
  const boxes = segments.map(({ words, colour, first, last: end }) => {
    const box = element("button", { type: "button", title: words, onclick: () => player.jump(first) }, words);
    const [left, right] = [share(at(first)), share(at(end + 1))];
    Object.assign(box.style, { left: `${100 * left}%`, width: `${100 * (right - left)}%`, borderTopColor: colour });
    return box;
  });
  byId("segments").replaceChildren(...boxes);
  byId("segments").hidden = segments.length === 0;
}

/** Whether the reader left something on, on any page before, where the browser may remember. */
function keeps(name) {
  try {
    return localStorage.getItem(`getagrip-${name}`) === "on";
  } catch {
    return false;
  }
}

function keep(name, on) {
  try {
    localStorage.setItem(`getagrip-${name}`, on ? "on" : "off");
  } catch { /* it is forgotten with the page */ }
}

/** What is shown, and what stands still, in all columns alike. */
function options(columns, eye, { colours, near }) {
  const has = (name) => columns.some(({ arrays }) => arrays[name]), all = (name) => columns.every(({ arrays }) => arrays[name]);
  const needs = { camera: "hand_faces", hand: "hand_faces", object: "object_faces", world: "T_world_cam" };
  const stands = Object.keys(needs).filter((name) => all(needs[name])).map((name) => [name, `the ${name}`]);
  stands.push(...columns[0].said.views.map((name, k) => [`view ${k}`, name]));  // all columns show one clip
  const box = (name, words, on, colour, key) => {
    const turn = (checked) => {
      for (const column of columns) column.turn(name, checked);
      if (name === "cameras") eye.showCameras(checked);
      if (key) keep(name, checked);
      eye.ask();
    };
    turn(on);
    return toggle(words, on, turn, { colour, key });
  };
  const seenFrom = choice("seen from", stands, (value) => eye.standIn(value)), parts = [seenFrom];
  eye.choose = (stand) => {
    seenFrom.querySelector("select").value = stand;
    eye.standIn(stand);
  };
  parts.push(box("hand", has("other_hand_faces") ? "hands" : "hand", true, colours.hand));
  if (has("object_faces")) parts.push(box("object", "object", true, colours.object));
  if (has("axis")) parts.push(box("axis", "axis", true, colours.axis));
  if (has("T_cam_views")) parts.push(box("cameras", "cameras", false));
  if (columns.some(({ said }) => said.masked)) parts.push(box("observed", "observed mask", false, colours.observed));
  if (has("true_T_cam_obj")) parts.push(box("true", "ground truth", false, colours.true));
  if (has("object_faces")) {
    const millimetres = (metres) => `${Number((1000 * metres).toPrecision(3))} mm`, value = element("output", {}, millimetres(near.at));
    const within = element("input", {
      type: "range", min: 0, max: near.most, step: 0.001, value: near.at, "aria-label": "distance of contact",
      oninput: () => {
        eye.contact = Number(within.value);
        value.textContent = millimetres(eye.contact);
        eye.ask();
      },
    });
    parts.push(element("span", {}, box("contact", "contact within", false), within, value));
  }
  parts.push(box("grid", "grid", keeps("grid"), "", "g"), box("axes", "axes x, y, z", keeps("axes"), "", "a"));
  byId("options").replaceChildren(...parts);
  byId("reset").onclick = () => eye.reset();
  byId("whole").onclick = () => (document.fullscreenElement ? document.exitFullscreen() : document.querySelector("main").requestFullscreen());
  byId("whole").hidden = !document.fullscreenEnabled;
}

/** Curves of all columns, those of one title in one plot. */
function plots(columns, { times, segments }, player) {
  const several = columns.length > 1, merged = new Map();
  const each = [...columns.flatMap(({ said, colour }) => said.plots.map((plot) => [plot, colour])), ...columns.map(({ gap, colour }) => [gap, colour])];
  for (const [{ title, unit, lines, upTo }, colour] of each.filter(([plot]) => plot)) {
    const one = merged.get(title) || { title, unit, lines: [], upTo, named: !several };
    const drawn = several ? lines.map((line, k) => (k ? line : { ...line, colour })) : lines;
    one.lines.push(...drawn.map((line, k) => ({ ...line, dashed: k > 0 })).filter(({ dashed }) => !dashed || !one.lines.some((line) => line.dashed)));
    merged.set(title, one);
  }
  player.plots = [...merged.values()].map((one) => new Plot(one, times, segments, (n) => player.jump(n)));
  byId("plots").replaceChildren(...player.plots.map(({ figure }) => figure));
  for (const plot of player.plots) plot.show(player.frames[player.place].n);
  const names = columns.map(({ said, colour }) => element("span", { class: "key" }, said.label));
  names.forEach((name, k) => name.style.setProperty("--key", columns[k].colour));
  if ([...merged.values()].some(({ lines }) => lines.some(({ dashed }) => dashed))) names.push("dashed: ground truth");
  byId("legend").replaceChildren(...names);
  byId("legend").hidden = !several;
}

let opened = 0;

/** Show the results of an entry, whose columns' frames come from `source`. */
async function show(shown, source) {
  const mine = (opened += 1), several = shown.columns.length > 1;
  const arrays = await Promise.all(shown.columns.map((said) => unpack(said.arrays, said.packed)));
  if (mine !== opened) return;
  byId("name").textContent = shown.clip;
  byId("method").textContent = several ? "" : shown.columns[0].label;
  byId("columns").replaceChildren();
  document.body.classList.toggle("several", several);
  document.body.style.setProperty("--columns", Math.min(shown.columns.length, 4));
  const eye = new Eye(shown.near, Math.max(...arrays.map(({ extent }) => extent[0])));
  let player;
  const columns = shown.columns.map((said, k) => {
    const colour = several ? COLOURS[k % COLOURS.length] : "";
    return new Column(said, arrays[k], source(said, k, arrays[k]), eye, { ...shown, colour, changed: () => player.draw() });
  });
  player = new Player(shown, columns);
  options(columns, eye, shown);
  segmentBar(shown, player);
  plots(columns, shown, player);
  byId("more").replaceChildren(...columns.map((column) => column.more(several)));
  byId("footer").textContent = `${["getagrip", shown.columns[0].version].join(" ").trim()}. Metres and radians inside; angles here in degrees, distances in millimetres.`;
  await player.show(0);
  document.body.classList.remove("waiting");
  document.body.dataset.ready = columns.every(({ viewer }) => viewer) ? "3d" : "flat";
  for (const column of columns.filter(({ source: { gap }, arrays: { object_faces } }) => gap && object_faces)) {
    column.gap = await column.source.gap().catch(() => null);
    if (mine !== opened) return;
    plots(columns, shown, player);
  }
  document.body.dataset.complete = "";
}

/** The list of a served page, of which one entry is open. */
async function choose(n) {
  byId("entries").value = n;
  byId("trouble").hidden = true;
  document.body.classList.add("waiting");
  try {
    const shown = await ask(`entry/${n}`);
    document.title = `${shown.clip}, getagrip view`;
    await show(shown, (said, k) => new Fetched(n, k));
  } catch (error) {
    byId("trouble").textContent = error.message;
    byId("trouble").hidden = false;
  }
  document.body.classList.remove("waiting");
}

function start() {
  if (data.shown) {
    show(data.shown, (said, k, arrays) => new Embedded(said, arrays));
    return;
  }
  const { entries, first } = data;
  byId("list").hidden = entries.length < 2;
  byId("count").textContent = `${entries.length} clips, worst first`;
  byId("entries").append(...entries.map((label, n) => element("option", { value: n }, label)));
  byId("entries").onchange = () => choose(Number(byId("entries").value));
  const step = (by) => choose((Number(byId("entries").value) + by + entries.length) % entries.length);
  byId("previous").onclick = () => step(-1);
  byId("next").onclick = () => step(1);
  choose(first);
}

start();
