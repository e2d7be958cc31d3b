// Beside the picture while labelling: what to do next, the key frames, filling in, and the files that come out.

import { $, element, many, move, on, player, state } from "./app.js";
import { NAMES } from "./joints.js";
import { change, here, missing, settle, stale, work } from "./labels.js";
import { drawing, remove } from "./outlines.js";
import * as results from "./results.js";
import { shape } from "./settings.js";

const UNSURE = 0.85; // masks less sure than this are named
const NAMED = 6; // frames named in a list, at most

const STROKES = ["on", "off"];

const clicked = (one) => Object.values(one.joints).filter(Array.isArray).length;
const within = (frame) => frame >= state.labels.extent[0] && frame <= state.labels.extent[1];

export function say(text) {
  $("label-next").textContent = text;
}

/** Frames of which nothing, or nothing that is up to date, is filled in. */
function unfilled() {
  const [first, last] = state.labels.extent;
  let count = 0;
  for (let n = first; n <= last; n += 1) count += missing(n);
  return count;
}

const busy = () => ["waiting", "running"].includes(state.labels.job?.state);

/** The number of a frame of the grasp, as the footage's files have it where that is known. */
function numberOf(frame) {
  const { drafts } = state.labels;
  return (drafts.masks.get(frame) ?? drafts.hand.get(frame))?.content.number ?? `${frame + 1}`;
}

/** The next step where hands were found: the object is painted on the frames that are asked for. */
function nextStroke(outlined) {
  const at = state.labels.wanted ?? undefined, there = at === player.wanted;
  if (!outlined) return there ? "The hands were found; they are drawn in every frame. Paint strokes over the object: along it, and over each of its colours. The hand does not belong to it." : "Go to the first frame (Home), and paint a stroke over the object there.";
  if (busy() || at === undefined) return null;
  if (there) return "Paint over the object here, too; z, then a stroke, for what does not belong to it.";
  const result = state.labels.result?.current ? "The result is there. " : "";
  return `${result}Most is gained by strokes on frame ${numberOf(at)}.`;
}

function nextStep(joint) {
  const { keyframes, job, fewest, found } = state.labels, own = here(), keys = [...keyframes.values()].filter((one) => within(one.frame));
  const withJoints = keys.filter(clicked), outlined = keys.filter((one) => one.outlined);
  if (!within(player.wanted)) return "This frame is not part of the grasp. Home goes to its start.";
  if (state.tool !== "joints" && drawing(state.tool)) return "Click point after point along the border. To close it, click its first point again, or press Enter.";
  if (state.tool === "joints" && Object.keys(own.joints).length && joint !== null) return `Click the ${NAMES[joint].toLowerCase()}; x where it cannot be located.`;
  const painted = found ? nextStroke(outlined.length) : null;
  if (painted) return painted;
  if (busy()) return { files: "Writing the files …", reconstruct: "Reconstructing. Step through the frames meanwhile (→): a stroke where something is off is taken at once.", candidate: "Taking the candidate …" }[job.what] ?? "Filling in …";
  if (!withJoints.length && !found) return "Go to the first frame, or one near it that shows the hand well, and click the joints in the order of the picture below. The mouse wheel brings it closer.";
  const few = withJoints.find((one) => clicked(one) < fewest);
  if (few) return `A frame needs ${fewest} joints at least: click some more on frame ${few.number}, or delete them.`;
  if (!outlined.length) return "Draw a polygon around the visible part of the object (o): the hand does not belong to it. Then draw polygons around whatever else hides it (i), if anything does.";
  if (!found && (withJoints.length < 2 || outlined.length < 2)) {
    const what = withJoints.length < 2 ? (outlined.length < 2 ? "both" : "joints") : "a polygon";
    return `Now ${what} on the last frame or near it, and in the middle where the grasp is long or turns. The frames between are filled in (b).`;
  }
  if (unfilled()) return "Fill in the other frames (b).";
  if (state.labels.result?.current && job?.what !== "files") return "The result is there; its report says more. Where it is off, correct labels or mesh, and reconstruct again.";
  if (job?.what === "files" && job.state === "done") return "The files are there. Run the command below, with your object's mesh, to make the clip.";
  return "Step through the frames (→). Where something is off, k takes what was filled in, for you to correct; then fill in again. When all is right, name the object's mesh below and reconstruct.";
}

function drawKeyframes() {
  const rows = [...state.labels.keyframes.values()].sort((a, b) => a.frame - b.frame).map((one) => {
    const joints = clicked(one), strokes = Object.values(one.outlines).filter(({ of }) => STROKES.includes(of)).length, drawn = Object.keys(one.outlines).length - strokes;
    const about = [joints && many(joints, "joint"), drawn && many(drawn, "polygon"), strokes && many(strokes, "stroke"), one.hidden && "object not visible", !within(one.frame) && "outside of the grasp"];
    const away = element("button", { textContent: "✕", title: "Delete what is labelled on this frame", onclick: (event) => { event.stopPropagation(); change(one.frame, { deleted: true }); } });
    const text = element("button", { className: "text", title: "Go there" }, `${one.number ?? "…"} `, element("small", { textContent: about.filter(Boolean).join(" · ") }));
    return element("li", { className: one.frame === player.wanted ? "chosen" : "", onclick: () => move(one.frame) }, text, away);
  });
  $("keyframes").replaceChildren(...rows);
  $("no-keyframes").hidden = rows.length > 0;
}

function drawOutlines() {
  const own = here(), names = { object: "Object", front: "In front", hand: "Hand", on: "On the object", off: "Not the object" };
  const rows = Object.entries(own.outlines).map(([id, one]) => {
    const away = element("button", { textContent: "✕", title: "Delete this polygon", onclick: () => remove(id) });
    return element("li", { className: one.of }, element("span", { className: "text" }, names[one.of], element("small", { textContent: one.closed ? many(one.points.length, "point") : "not closed yet" })), away);
  });
  $("outline-list").replaceChildren(...rows);
  $("hidden").checked = own.hidden;
  $("hidden").disabled = Object.values(own.outlines).some((one) => one.of === "object");
}

/** Buttons that go to frames, if there are any. */
function drawFrames(id, frames) {
  $(id).hidden = !frames.length;
  $(`${id}-list`).replaceChildren(...frames.map(([frame, textContent, title]) => element("button", { textContent, title, onclick: () => move(frame) })));
}

function drawWork() {
  const { job, basis, drafts, keyframes, extent: [first, last] } = state.labels, running = busy();
  const own = [...keyframes.values()].filter((one) => within(one.frame)), hand = state.labels.found || own.some(clicked), masks = own.some((one) => one.outlined);
  $("fill").disabled = running || !(masks || hand);
  $("write").disabled = running || !(masks && hand);
  $("reconstruct").disabled = (running && job.what !== "propagate") || !(masks && hand);
  $("cancel").hidden = $("progress-bar").hidden = !running;
  $("progress-bar").max = job?.total || 1;
  $("progress-bar").value = job?.done ?? 0;
  const away = unfilled(), frames = last - first + 1;
  const texts = { waiting: "waiting …", running: job?.message ? `${job.message} …` : job?.total ? `${job.done} of ${job.total} frames` : state.labels.found ? "drawing the hand …" : "fitting the hand …", failed: `It did not work: ${job?.message}`, cancelled: "Stopped." };
  const now = !basis.masks.length && !basis.hand.length ? "" : away ? `${away} of ${many(frames, "frame")} to be filled in${drafts.masks.size || drafts.hand.size ? " again" : ""}.` : `All ${many(frames, "frame")} filled in.`;
  $("fill-state").textContent = texts[job?.state] ?? now;
  $("fill-state").className = job?.state === "failed" ? "failed" : "";
  const unsure = [...drafts.masks.values()].filter((one) => within(one.frame) && !stale("masks", one.frame) && one.content.confidence < UNSURE)
    .sort((a, b) => a.content.confidence - b.content.confidence).slice(0, NAMED).sort((a, b) => a.frame - b.frame);
  drawFrames("unsure", unsure.map((one) => [one.frame, one.content.number, `${Math.round(100 * one.content.confidence)} % sure`]));
  const at = state.labels.wanted ?? undefined;
  drawFrames("wanted", at === undefined ? [] : [[at, numberOf(at), "Go there"]]);
  const uncertain = own.map((one) => [one, (drafts.hand.get(one.frame)?.content.uncertain ?? []).filter((n) => Array.isArray(one.joints[n]))]);
  drawFrames("uncertain", uncertain.filter(([, joints]) => joints.length).map(([one, joints]) => [one.frame, one.number, joints.map((n) => NAMES[n]).join(", ")]));
  const command = job?.what === "files" && job.state === "done" ? job.message : "";
  $("command-box").hidden = !command;
  $("command").textContent = command;
  drawVerdict(state.labels.result, new URLSearchParams(state.labels.about));
  $("labels-json").href = `/labels.json?${new URLSearchParams(state.labels.about)}`;
}

const VERDICTS = { right: "Looks right", uncertain: "Uncertain", wrong: "Looks wrong" };

/** Buttons that take steps. */
const buttons = (steps) => steps.map((one) => {
  const { word, act } = results.step(one, shape());
  return element("button", { textContent: word, onclick: act });
});

let drawn = ""; // what the verdict was drawn of: buttons that did not change keep the focus

/** The verdict on the result, what to do next, and why: what was found, the serious first. */
function drawVerdict(result, asked) {
  $("verdict").hidden = !result;
  if (!result) return;
  const { job } = state.labels, now = JSON.stringify([result, results.candidate(), results.isShown(), job?.what, job?.state, shape()]);
  if (now === drawn) return;
  drawn = now;
  const { findings, guessed } = result, serious = findings.filter((one) => one.serious).length;
  $("verdict").className = result.current ? result.verdict : "old";
  $("verdict-word").textContent = VERDICTS[result.verdict];
  $("verdict-probability").textContent = result.probability;
  $("verdict-report").href = `/report.html?${asked}`;
  $("verdict-picture").href = `/report.png?${asked}&at=${result.made}`;
  $("outcome").textContent = result.said;
  $("steps").hidden = !result.steps.length;
  $("steps").replaceChildren("Next: ", ...buttons(result.steps));
  const topics = Object.entries(guessed);
  $("guessed").hidden = !topics.length;
  $("guessed").textContent = `Guessed: ${topics.map(([topic]) => topic).join(", ")}.`;
  $("guessed").title = topics.map(([topic, text]) => `${topic}: ${text}`).join("\n");
  $("show-result").checked = results.isShown();
  drawCandidates(result, job);
  $("outdated").hidden = result.current && !result.first;
  $("outdated").textContent = !result.current ? (busy() ? "Of earlier labels: a new result is being made." : "Of earlier labels: reconstruct again.") : busy() ? "A first result, of the masks of a few frames: it is made again when all are filled in." : "A first result, of the masks of a few frames: reconstruct again for that of all.";
  $("findings").hidden = !findings.length;
  $("findings").firstElementChild.textContent = `${many(findings.length, "finding")}${serious ? `, ${serious} serious` : ""}`;
  const rows = findings.map(({ message, serious: worse, steps }) => element("li", { className: worse ? "serious" : "" }, message, element("span", { className: "buttons" }, ...buttons(steps))));
  $("findings").lastElementChild.replaceChildren(...rows);
}

/** The candidates, of which one is shown in the picture; another one than the first can be taken. */
function drawCandidates({ candidates, current }, job) {
  const at = results.candidate(), took = job?.what === "candidate" && job.state === "done" && at === 0;
  $("candidates").hidden = candidates < 2;
  $("candidate-list").replaceChildren(...Array.from({ length: candidates }, (_, n) => {
    const button = element("button", { textContent: n + 1, title: n ? `Candidate ${n + 1} over the picture` : "The result over the picture", role: "radio", onclick: () => results.choose(n) });
    button.ariaChecked = String(n === at);
    return button;
  }));
  $("take").hidden = at === 0;
  $("take").disabled = busy() || !current;
  $("candidate-said").textContent = at ? `Candidate ${at + 1} is in the picture; the verdict is that of the result, candidate 1.` : took ? job.message : "";
}

export function drawPanel(joint) {
  drawKeyframes();
  drawOutlines();
  drawWork();
  say(nextStep(joint));
}

$("fill").onclick = () => work("propagate");
$("write").onclick = () => work("files");
export function reconstruct() {
  work("reconstruct", shape());
}
$("reconstruct").onclick = reconstruct;
$("cancel").onclick = () => work("cancel");
$("take").onclick = () => work("candidate", { candidate: results.candidate() });
$("show-result").onchange = results.toggle;
on("field", (id) => { $(id).scrollIntoView({ block: "center" }); $(id).focus(); });
$("copy").onclick = () => navigator.clipboard.writeText($("command").textContent);
$("hidden").onchange = () => change(player.wanted, { hidden: $("hidden").checked });
$("labels-json").onclick = settle;
