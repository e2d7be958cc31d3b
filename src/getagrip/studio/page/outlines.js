// Polygons around the visible parts of the object, what is in front of it and the hand, drawn point by point.

import { player } from "./app.js";
import { adjust, change, draft, here } from "./labels.js";
import { fresh } from "./saving.js";

const DOT = 0.6; // a point's dot, as part of the reach: beside it a click is no click on the point
const TWICE = 0.25; // the second click of two on the same place, likewise

let chosen = null; // {id, n}: the point that the keyboard moves

const mine = (of) => Object.entries(here().outlines).filter(([, one]) => one.of === of);
const open = (of) => mine(of).find(([, one]) => !one.closed);
const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

export function selected() {
  const points = chosen && here().outlines[chosen.id]?.points;
  return points && chosen.n < points.length ? chosen : null;
}

/** How far a point is from the stretch a-b. */
function apart(point, a, b) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]], length = dx * dx + dy * dy;
  const t = length ? Math.min(Math.max(((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / length, 0), 1) : 0;
  return distance(point, [a[0] + t * dx, a[1] + t * dy]);
}

const put = (id, one) => change(player.wanted, { outlines: { [id]: one } });
const moved = (one, n, point) => ({ ...one, points: one.points.map((old, k) => (k === n ? point : old)) });

/** Whether a polygon is being drawn. */
export const drawing = (of) => Boolean(open(of));

/** The tool that draws polygons "of" the object, or of what is in front. */
export const tool = (of) => ({
  grab(point, reach) {
    const near = mine(of).flatMap(([id, one]) => one.points.map((where, n) => ({ id, n, far: distance(where, point) })))
      .filter(({ far }) => far < reach).sort((a, b) => a.far - b.far)[0];
    return near ?? null;
  },
  drag({ id, n }, point) {
    chosen = { id, n };
    adjust(player.wanted, { outlines: { [id]: moved(here().outlines[id], n, point) } });
  },
  /** A click on a point, or near it: while drawing it adds a point, but on the first one; else beside the dot it inserts one. */
  tap({ id, n }, point, reach) {
    const one = here().outlines[id], far = distance(one.points[n], point), drawn = open(of);
    if (drawn) {
      if (id === drawn[0] && n === 0 && one.points.length > 2) this.finish();
      else if (far > TWICE * reach || n !== one.points.length - 1) this.click(point, reach);
    } else if (far > DOT * reach) this.click(point, reach);
    else chosen = { id, n };
  },
  click(point, reach) {
    const drawn = open(of);
    if (drawn) {
      const [id, one] = drawn;
      chosen = null;
      put(id, { ...one, points: [...one.points, point] });
      return;
    }
    const edges = mine(of).flatMap(([id, one]) => one.points.map((a, n) => ({ id, n, far: apart(point, a, one.points[(n + 1) % one.points.length]) })));
    const edge = edges.filter(({ far }) => far < reach).sort((a, b) => a.far - b.far)[0];
    if (edge) {
      const one = here().outlines[edge.id];
      put(edge.id, { ...one, points: one.points.toSpliced(edge.n + 1, 0, point) });
      chosen = { id: edge.id, n: edge.n + 1 };
    } else if (selected()) chosen = null;
    else change(player.wanted, { outlines: { [fresh()]: { of, closed: false, points: [point] } }, ...(of === "hand" ? {} : { hidden: false }) });
  },
  nudge(dx, dy, inside) {
    const point = selected();
    if (!point) return false;
    const one = here().outlines[point.id], [x, y] = one.points[point.n];
    adjust(player.wanted, { outlines: { [point.id]: moved(one, point.n, inside([x + dx, y + dy])) } });
    return true;
  },
  /** Take away the chosen point, or the last one of what is being drawn. */
  remove() {
    const drawn = open(of), point = selected() ?? (drawn && { id: drawn[0], n: drawn[1].points.length - 1 });
    if (!point) return;
    const one = here().outlines[point.id], points = one.points.toSpliced(point.n, 1);
    chosen = null;
    put(point.id, points.length < (one.closed ? 3 : 1) ? null : { ...one, points });
  },
  /** Close what is being drawn. */
  finish() {
    const drawn = open(of);
    chosen = null;
    if (drawn && drawn[1].points.length > 2) put(drawn[0], { ...drawn[1], closed: true });
  },
  /** The polygons that were filled in on this frame, to be corrected. */
  take() {
    const masks = draft("masks", player.wanted);
    if (!masks) return "Nothing is filled in on this frame yet.";
    const kinds = of === "hand" ? ["hand"] : ["object", "front"]; // a hand that was found stays what it is
    const taken = kinds.flatMap((kind) => (masks.content[kind] ?? []).map((points) => [kind, points]));
    const replaced = Object.keys(here().outlines).filter((id) => (here().outlines[id].of === "hand") === (of === "hand"));
    const outlines = Object.fromEntries([
      ...replaced.map((id) => [id, null]),
      ...taken.map(([kind, points]) => [fresh(), { of: kind, closed: true, points }]),
    ]);
    chosen = null;
    change(player.wanted, { outlines, ...(of === "hand" ? {} : { hidden: !masks.content.object.length }) });
    return null;
  },
});

export const remove = (id) => put(id, null);
