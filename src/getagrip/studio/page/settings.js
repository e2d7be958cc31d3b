// What belongs to the grasp that is labelled, beside its labels: mesh, size, frame and tool. The server keeps them.

import { $, element, invited, on, player, post, saving, state } from "./app.js";
import { fresh } from "./saving.js";

const asked = invited ? Object.fromEntries(new URLSearchParams(location.hash.slice(1))) : {}; // before a clip's name is in the address
const SETTLE = 500; // ms after the last change of frame or tool until it is sent

let sent = {}; // frame and tool as the server has them
let settling;

/** Fill in the fields from what the server knows of a grasp, else from the address and the kind that was marked. */
export function fill(settings, category) {
  const known = settings.mesh === undefined ? { mesh: asked.mesh || category, size_mm: asked["size-mm"] } : settings;
  $("mesh").value = known.mesh ?? "";
  $("size-mm").value = known.size_mm ?? "";
  checkShape();
  sent = { frame: settings.frame, tool: settings.tool };
}

/** The mesh and its size as they stand in the fields. */
export function shape() {
  const size = $("size-mm").value.trim();
  return { mesh: $("mesh").value.trim(), size_mm: size ? Number(size) : null };
}

let checked = ""; // the mesh and size that were asked about last

/** Say at the fields what is wrong with the mesh, and odd about its size, before anything is made of them. */
async function checkShape() {
  const now = shape(), asked = checked = JSON.stringify(now);
  const said = now.mesh ? await post("/api/shape", now).catch((error) => ({ mesh: error.message })) : {};
  if (asked !== checked) return;
  for (const [id, text] of [["mesh-said", said.mesh], ["size-said", said.size_mm]]) Object.assign($(id), { textContent: text, hidden: !text });
  $("mesh").ariaInvalid = String(Boolean(said.mesh));
}

/** The kinds, for the field's own list and, with pictures, to be clicked. */
function drawKinds() {
  $("kinds").replaceChildren(...state.kinds.map((value) => element("option", { value })));
  $("kind-list").replaceChildren(...state.kinds.map((kind) => {
    const act = () => { $("mesh").value = kind; keepShape(); };
    return element("button", { onclick: act }, element("img", { src: `/kind.png?kind=${kind}`, alt: "", loading: "lazy" }), kind.replaceAll("_", " "));
  }));
}

function keepShape() {
  checkShape();
  if (state.labels) saving.add("/api/set", { ...state.labels.about, change: fresh(), set: shape() });
}

/** Where one is: not waited for, as nothing is lost where it does not arrive. */
function keepPlace() {
  clearTimeout(settling);
  if (!state.labels) return;
  const now = { frame: player.wanted, tool: state.tool };
  if (now.frame === sent.frame && now.tool === sent.tool) return;
  const body = JSON.stringify({ ...state.labels.about, project: saving.project, set: now });
  fetch("/api/set", { method: "POST", headers: { "Content-Type": "application/json" }, body, keepalive: true }).then((answer) => { if (answer.ok) sent = now; }, () => {});
}

function later() {
  clearTimeout(settling);
  if (state.mode === "labels" && !player.playing) settling = setTimeout(keepPlace, SETTLE);
}

for (const id of ["mesh", "size-mm"]) $(id).onchange = keepShape;
$("kind-pictures").ontoggle = drawKinds;
$("mesh").onfocus = drawKinds;
on("shown", later);
on("tool", later);
addEventListener("pagehide", keepPlace);
