// Where in the footage one is: the frames of a clip, or of the grasp that is being labelled, and what is known of them.

import { $, clock, element, move, player, state } from "./app.js";
import { stale } from "./labels.js";
import { STATES } from "./states.js";

const UNCERTAIN = 0.7; // masks less sure than this are to be looked at

/** First and last frame on the timeline: the rough extent with some of what is around it. */
function view(extent) {
  const { frames, fps } = state.info;
  const [first, last] = extent;
  const margin = state.mode === "labels" ? 1 : Math.round(Math.max(2 * fps, (last - first) / 5));
  const at = player.wanted;
  return [Math.max(0, Math.min(first - margin, at)), Math.min(frames - 1, Math.max(last + margin, at))];
}

const extent = () => (state.mode === "labels" ? state.labels.extent : [state.info.first, state.info.last]);

/** Stretches of frames of which the same is true: [word, from, to]. */
function stretches(word, first, last) {
  const found = [];
  for (let n = first; n <= last; n += 1) {
    const now = word(n);
    if (found.length && found.at(-1)[0] === now) found.at(-1)[2] = n;
    else found.push([now, n, n]);
  }
  return found.filter(([now]) => now);
}

/** Draw it, with `bars` of grasps or, while labelling, what is known of the frames' masks and hands. */
export function drawTimeline(bars) {
  if (!state.info || (state.mode === "labels" && !state.labels)) return;
  const [first, last] = view(extent());
  const part = (index) => `${100 * (index - first) / (last - first + 1)}%`;
  const place = (made, from, to) => Object.assign(made.style, { left: part(from), width: `calc(${part(to + 1)} - ${part(from)})` });
  place($("rough"), ...extent());
  const now = player.shown?.number ?? first + 1;
  Object.assign($("timeline"), { ariaValueMin: first, ariaValueMax: last, ariaValueNow: player.shown?.index ?? first, ariaValueText: `frame ${now}` });
  $("cursor").style.left = part((player.shown?.index ?? first) + 0.5);
  $("contact").hidden = state.mode === "labels" || state.info.contact === null;
  $("contact").style.left = part((state.info.contact ?? 0) + 0.5);
  const made = state.mode === "labels" ? labelled(place, part) : bars.map((bar) => {
    const drawn = element("div", { textContent: bar.text, title: bar.title, className: bar.classes.filter(Boolean).join(" ") });
    place(drawn, bar.from, bar.to);
    return drawn;
  });
  $("bars").replaceChildren(...made);
  $("scale-first").textContent = clock(first / state.info.fps);
  $("scale-last").textContent = clock(last / state.info.fps);
}

/** Filled in or not, sure or not; and the key frames. */
function labelled(place, part) {
  const { keyframes, drafts } = state.labels;
  const masks = (n) => {
    const draft = drafts.masks.get(n);
    if (!draft) return "";
    return stale("masks", n) ? "stale" : draft.content.confidence < UNCERTAIN ? "uncertain" : "fresh";
  };
  const hand = (n) => (drafts.hand.has(n) ? (stale("hand", n) ? "stale" : "fresh") : "");
  const titles = { fresh: "filled in", stale: "filled in before the labels were changed", uncertain: "filled in, but not sure: look here" };
  const bands = [["masks", "Masks", masks], ["hand", "Hand", hand]].flatMap(([kind, what, word]) =>
    stretches(word, ...state.labels.extent).map(([now, from, to]) => {
      const band = element("div", { className: `band ${kind} ${now}`, title: `${what}: ${titles[now]}` });
      place(band, from, to);
      return band;
    }));
  const segments = state.marks.filter((mark) => mark.end !== null && state.labels.grasp === state.interaction?.mark).map((mark) => {
    const band = element("div", { className: `band segment ${mark.state}`, title: STATES[mark.state].word });
    place(band, mark.start, mark.end);
    return band;
  });
  const keys = [...keyframes.values()].flatMap((one) => [
    one.outlined && ["outlined", "Polygons drawn here"], one.joints && Object.keys(one.joints).length && ["clicked", "Joints clicked here"],
  ].filter(Boolean).map(([className, title]) => {
    const key = element("i", { className, title });
    key.style.left = part(one.frame + 0.5);
    return key;
  }));
  return [...segments, ...bands, ...keys];
}

$("timeline").onpointerdown = (event) => {
  if (!state.info) return;
  $("timeline").setPointerCapture(event.pointerId);
  const [first, last] = view(extent()); // as it was when the drag began
  const seek = ({ clientX }) => {
    const { left, width } = $("timeline").getBoundingClientRect();
    const to = first + Math.floor((clientX - left) / width * (last - first + 1));
    move(Math.min(Math.max(to, first), last));
  };
  seek(event);
  $("timeline").onpointermove = seek;
  $("timeline").onpointerup = $("timeline").onpointercancel = () => { $("timeline").onpointermove = null; };
};
