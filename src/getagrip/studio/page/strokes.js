// Strokes on the object, or beside it: drawn by dragging, or by a single click.

import { player } from "./app.js";
import { adjust, change, draft, here, stale } from "./labels.js";
import { fresh } from "./saving.js";

const APART = 3; // pixels of the footage from one point of a stroke to the next
const MOST = 2000; // points of a stroke

const mine = (of) => Object.keys(here().outlines).filter((id) => here().outlines[id].of === of);

/** What was filled in on this frame, where nothing is drawn: a stroke corrects it. */
function filledIn() {
  const masks = draft("masks", player.wanted);
  if (here().outlined || !masks || stale("masks", player.wanted)) return {};
  const { object, front } = masks.content;
  const shapes = [...object.map((points) => ["object", points]), ...front.map((points) => ["front", points])];
  return Object.fromEntries(shapes.map(([of, points]) => [fresh(), { of, closed: true, points }]));
}

/** The tool that draws strokes "on" the object, or "off" it. */
export const tool = (of) => ({
  grab: (point) => ({ id: fresh(), points: [point], under: filledIn() }),
  drag(stroke, point) {
    const [x, y] = stroke.points.at(-1);
    if (Math.hypot(point[0] - x, point[1] - y) < APART || stroke.points.length >= MOST) return;
    stroke.points.push(point);
    adjust(player.wanted, { outlines: { ...stroke.under, [stroke.id]: { of, closed: true, points: [...stroke.points] } } });
  },
  tap({ id, under }, point) {
    change(player.wanted, { outlines: { ...under, [id]: { of, closed: true, points: [point] } }, hidden: false });
  },
  click() {},
  nudge: () => false,
  remove() {
    const last = mine(of).at(-1);
    if (last) change(player.wanted, { outlines: { [last]: null } });
  },
  finish() {},
  take: () => "Draw a stroke where what was filled in is wrong: it is taken, and corrected.",
});
