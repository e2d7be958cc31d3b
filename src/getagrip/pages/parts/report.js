"use strict";
// The page of one result.

const HANDS = data.arrays.other_hand_faces ? "hands" : "hand";

/** The words at the top, and what speaks against the result. */
function head() {
  byId("name").textContent = data.name;
  byId("facts").textContent = data.facts.join("  ·  ");
  byId("status").textContent = data.status;
  for (const { name, value, meaning } of data.main) {
    byId("main").append(element("div", { title: meaning }, element("dd", {}, value), element("dt", {}, name)));
  }
  const doubts = data.findings.map(({ serious, check, message }) => [serious ? "serious" : "note", check, message]);
  const shown = data.candidates.length > 1 ? "; the candidates below show it" : "";  // of a timeline there is one only
  if (data.ambiguous) doubts.unshift(["note", "ambiguous", `another pose explains the masks almost as well${shown}`]);
  for (const [kind, check, message] of doubts) {
    byId("doubts").append(element("li", { class: kind }, element("b", {}, kind), ` ${check}: ${message}`));
  }
  if (data.notes.length) {
    byId("notes").append(element("h2", {}, "Guesses and notes"), element("ul", {}, ...data.notes.map((note) => element("li", {}, note))));
  }
  for (const { title, head, rows } of data.tables) {
    const lines = rows.map(([name, ...values]) => element("tr", {}, element("th", {}, name), ...values.map((value) => element("td", {}, value))));
    if (head.length) lines.unshift(element("tr", {}, ...head.map((name) => element("th", {}, name))));
    byId("tables").append(element("details", {}, element("summary", {}, title), element("table", {}, ...lines)));
  }
  byId("footer").textContent = `getagrip ${data.version}. Metres and radians inside; angles here in degrees, distances in millimetres.`;
}

/** A labelled box that is on or off. */
function toggle(words, on, change, colour) {
  const box = element("input", { type: "checkbox", onchange: () => change(box.checked) });
  box.checked = on;
  const label = element("label", {}, box, words);
  if (colour) label.style.setProperty("--key", colour);
  if (colour) label.className = "keyed";
  return label;
}

function choice(words, values, change) {
  const select = element("select", { onchange: () => change(select.value) }, ...values.map(([value, name]) => element("option", { value }, name)));
  return element("label", {}, `${words} `, select);
}

/** The image of the frame, with contours that can be switched on and off. */
class Overlay {
  constructor() {
    this.svg = byId("outlines");
    this.svg.setAttribute("viewBox", `0 0 ${data.size} ${data.size}`);
    this.candidate = 0;
    this.paths = {};
    const words = { object: "object", hand: HANDS, true: "ground truth", observed: "observed mask" };
    for (const name of ["observed", "hand", "true", "object"].filter((known) => data.outlines[known])) {
      const [halo, line] = ["halo", "line"].map((kind) => element("path", { class: kind, stroke: kind === "line" ? data.colours[name] : "#fff" }));
      this.paths[name] = element("g", { class: name }, halo, line);
      this.svg.append(this.paths[name]);
    }
    for (const name of Object.keys(words).filter((known) => this.paths[known])) {
      const on = name === "object" || name === "hand";
      const change = (checked) => this.paths[name].setAttribute("visibility", checked ? "visible" : "hidden");
      change(on);
      byId("picture-options").append(toggle(words[name], on, change, data.colours[name]));
    }
  }

  show(k) {
    byId("picture").src = `data:image/jpeg;base64,${data.pictures[k]}`;
    for (const [name, group] of Object.entries(this.paths)) {
      const outline = name === "object" ? data.outlines.object[this.candidate][k] : data.outlines[name][k];
      for (const path of group.children) path.setAttribute("d", outline);
    }
  }
}

/** The frame that is shown, everywhere at once. */
class Player {
  constructor(parts, plots) {
    Object.assign(this, { parts, plots, place: 0, timer: null });
    const last = data.shown.length - 1;
    Object.assign(byId("slider"), { max: last, value: 0, oninput: () => this.show(Number(byId("slider").value)) });
    byId("play").onclick = () => (this.timer === null ? this.play() : this.stop());
    byId("back").onclick = () => this.step(-1);
    byId("forth").onclick = () => this.step(1);
    document.addEventListener("keydown", (event) => {
      if (["INPUT", "SELECT", "BUTTON", "SUMMARY"].includes(event.target.tagName) || event.ctrlKey || event.metaKey) return;
      const act = { " ": () => byId("play").click(), ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1) }[event.key];
      if (!act) return;
      event.preventDefault();
      act();
    });
  }

  show(place) {
    this.place = place;
    byId("slider").value = place;
    const { name, kind } = data.frames[place];
    byId("frame").textContent = `frame ${name}${kind === "sampled" ? "" : `, ${kind}`}  ·  ${data.times[data.shown[place]].toFixed(2)} s  ·  ${place + 1} of ${data.shown.length}`;
    for (const part of this.parts) part.show(place);
    for (const plot of this.plots) plot.show(data.shown[place]);
  }

  /** The frame that is played nearest to one of all frames. */
  jump(n) {
    this.stop();
    this.show(data.shown.reduce((best, shown, k) => (Math.abs(shown - n) < Math.abs(data.shown[best] - n) ? k : best), 0));
  }

  step(by) {
    this.stop();
    this.show(Math.max(0, Math.min(data.shown.length - 1, this.place + by)));
  }

  play() {
    byId("play").textContent = "❚❚ Pause";
    const next = () => {
      const place = (this.place + 1) % data.shown.length;
      this.show(place);
      const after = data.shown[place + 1] === undefined ? 0.5 : data.times[data.shown[place + 1]] - data.times[data.shown[place]];
      this.timer = setTimeout(next, (1000 * after) / Number(byId("speed").value));
    };
    this.timer = setTimeout(next, 0);
  }

  stop() {
    clearTimeout(this.timer);
    this.timer = null;
    byId("play").textContent = "▶ Play";
  }
}

/** The segments of a timeline under the slider, whose frames are those that are played; a click goes to its first one. */
function segmentBar(player) {
  const last = Math.max(data.shown.length - 1, 1);
  const at = (n) => data.shown.filter((shown) => shown < n).length;  // how many of them are before a frame
  const share = (place) => Math.max(0, Math.min(1, (place - 0.5) / last));
  for (const { words, colour, first, last: end } of data.segments) {
    const box = element("button", { type: "button", title: words, onclick: () => player.jump(first) }, words);
    const [left, right] = [share(at(first)), share(at(end + 1))];
    Object.assign(box.style, { left: `${100 * left}%`, width: `${100 * (right - left)}%`, background: colour });
    byId("segments").append(box);
  }
  byId("segments").hidden = data.segments.length === 0;
}

/** The 3D view and what can be switched in it; null where the browser has none. */
function scene(arrays, overlay) {
  let viewer;
  try {
    viewer = new Viewer(byId("scene"), arrays);
  } catch (error) {
    byId("scene").hidden = true;
    byId("no-scene").hidden = false;
    return null;
  }
  const options = byId("scene-options"), part = (name) => (on) => {
    viewer.shown[name] = on;
    viewer.ask();
  };
  const stands = ["camera", "hand", "object", "world"].filter((name) => name !== "world" || arrays.T_world_cam);
  options.append(choice("seen from", stands.map((name) => [name, `the ${name}`]), (value) => viewer.standIn(value)));
  if (data.candidates.length > 1) {
    const names = data.candidates.map(({ energy }, k) => [k, `${k ? `candidate ${k + 1}` : "the result"}, energy ${Number(energy.toPrecision(4))}`]);
    options.append(choice("pose", names, (value) => {
      viewer.candidate = overlay.candidate = Number(value);
      byId("other").hidden = viewer.candidate === 0;
      viewer.ask();
      overlay.show(viewer.frame);
    }));
  }
  options.append(toggle(HANDS, true, part("hand")), toggle("object", true, part("object")));
  if (arrays.axis) options.append(toggle("axis", true, part("axis"), data.colours.axis));
  options.append(toggle(`contact ${data.contact}`, false, part("contact"), data.colours.object));
  if (arrays.true_T_cam_obj) options.append(toggle("ground truth", false, part("truth"), data.colours.true));
  return viewer;
}

async function start() {
  head();
  const overlay = new Overlay();
  const plots = [];
  const player = new Player([overlay], plots);
  segmentBar(player);
  for (const given of data.plots) {
    plots.push(new Plot(given, data.times, data.segments, (n) => player.jump(n)));
    byId("plots").append(plots[plots.length - 1].figure);
  }
  player.show(0);
  const viewer = scene(await readArrays(), overlay);
  if (viewer) player.parts.push(viewer);
  document.body.dataset.ready = viewer ? "3d" : "flat";
}

start();
