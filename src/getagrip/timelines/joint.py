"""The joint solution of a timeline: hypotheses per segment, the chain of least energy, then all frames.

Static segments are solved first: errors of the hand cannot affect them, and they show surfaces that the hand hides
later. Their poses, tracked into the neighbouring grasps, are start poses and links of the grasps' search. The chain is
then chosen by the energies of all segments and links, and the frames in between are filled in.

A link's cost compares hypotheses of two neighbouring segments. Each is tracked by the masks to the frame where the
other segment begins or ends, along several paths; a path costs its own energy and its final distance. Tracking can lose
the object behind the hand in either direction, so the cheaper direction counts.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Segment
from getagrip.errors import InputError
from getagrip.fitting.problem import ObjectSurface, prepare_problem
from getagrip.fitting.solver.search import suppress_duplicates
from getagrip.geometry.mesh import Mesh
from getagrip.timelines.observations import GraspClip, Hypotheses, TimelineInputs
from getagrip.timelines.segments import (
    LINK_SLIP_DIAMETERS,
    GraspSolutions,
    Neighbour,
    fit_in_all_frames,
    max_link_cost,
    select_static_frames,
    solve_grasp,
    static_hypotheses,
)
from getagrip.timelines.tracking import Paths, track_hypotheses
from getagrip.timelines.transitions import (
    MIN_DEPTH_JITTER_M,
    TimelineMotion,
    correct_depth,
    depth_jitter,
    fill_gaps,
    split_at_gaps,
)

LINK_FRAMES = 6
"""Number of the problem's frames, at a grasp's border, in which a link applies."""


@dataclass(frozen=True)
class Anchor:
    """A segment that is solved by itself: a static one, or a grasp.

    Attributes:
        found: hypotheses at the segment's frames, or at those of the grasp's problem.
        solutions: the grasp's solutions, from which ``found`` are made; None for a static segment.
        near: the links of the grasp's search.
    """

    segment: Segment
    found: Hypotheses
    solutions: GraspSolutions | None = None
    near: tuple[Neighbour, ...] = ()

    def end(self, side: int) -> tuple[Hypotheses, int]:
        """Return the hypotheses at the first known frame (``side`` 0) or the last (-1), and the frame's index."""
        segment = self.segment
        row = int(self.solutions.sampled[side]) if self.solutions else segment.last if side else segment.first
        return self.found.at(np.array([side])), row

    def near_at(self, earlier: bool) -> Paths | None:
        """Return the paths of the neighbour before or after, at the shared frame; None without such a neighbour."""
        at = np.array([0 if earlier else -1])
        return next((one.paths.at(at) for one in self.near if one.earlier == earlier), None)


@dataclass(frozen=True)
class Chain:
    """The chosen hypothesis of each anchor, the chain's energy, and the energy of the next best chain."""

    anchors: tuple[Anchor, ...]
    chosen: tuple[int, ...]
    energy: float
    next_best: float


def choose_hypotheses(
    footage: TimelineInputs, support: bool, on_stage: Callable[[str], None] = lambda _: None
) -> Chain:
    """Find the chain of least energy; ``support`` adds the energy of the support plane to static segments.

    Raises ``InputError`` where no static segment and no grasp shows the object.
    """
    static = {}
    for segment in footage.clip.segments:
        if segment.state == "static" and len(rows := select_static_frames(segment, footage.shown)):
            static[segment] = static_hypotheses(footage.problem(rows), len(segment), support)
    on_stage("static")
    anchors = _add_grasps(footage, static)
    on_stage("grasps")
    if not anchors:
        got = "no static segment and no grasp by a known hand that shows the object in two frames"
        raise InputError(footage.clip.origin, "segments", got, "one at least")
    links = [_pairwise_link_cost(footage, *ends) for ends in itertools.pairwise(anchors)]
    energies = [anchor.found.energy for anchor in anchors]
    chosen, energy = best_chain(energies, links)
    on_stage("links")
    copies = [_equal_hypotheses(footage.some.surface, one.found, k) for one, k in zip(anchors, chosen, strict=True)]
    return Chain(tuple(anchors), tuple(chosen), energy, second_best(energies, links, copies))


def fill_all_frames(
    footage: TimelineInputs, chain: Chain, on_stage: Callable[[str], None] = lambda _: None
) -> TimelineMotion:
    """Extend the chosen hypotheses to their segments' frames, and fill the frames between segments."""
    motion, known = TimelineMotion.of(footage.clip, footage.shown), list[Segment]()
    for anchor, k in zip(chain.anchors, chain.chosen, strict=True):
        if anchor.solutions is None:
            motion.put(anchor.segment.rows, anchor.found.take(np.array([k])), "sampled")
            known.append(anchor.segment)
        else:
            grasp = anchor.solutions.grasp
            motion.put_grasp(fit_in_all_frames(anchor.solutions, k, anchor.near))
            seen = grasp.rows[footage.shown[grasp.rows]]
            if (jitter := depth_jitter(motion.places(seen))) >= MIN_DEPTH_JITTER_M:
                correct_depth(motion, footage.problem(seen), seen, grasp.clip.side, jitter)
            known += split_at_gaps(anchor.segment, grasp.rows)
    on_stage("all frames")
    fill_gaps(motion, footage, known)
    on_stage("between")
    return motion


def _add_grasps(footage: TimelineInputs, static: dict[Segment, Hypotheses]) -> list[Anchor]:
    """Solve the grasps with links to their static neighbours; return all anchors in order of time."""
    grasps = {s: GraspClip.of(footage.clip, s) for s in footage.clip.segments if s.state == "grasp"}
    order = [s for s in footage.clip.segments if s in static or grasps.get(s) is not None]
    anchors = []
    for before, segment, after in zip([None, *order], order, [*order[1:], None], strict=False):
        grasp = grasps.get(segment)
        if grasp is None:
            anchors.append(Anchor(segment, static[segment]))
            continue
        problem = prepare_problem(grasp.clip, footage.source.options)
        rows = grasp.rows[grasp.clip.index_of(problem.clip.frames)]
        m = min(LINK_FRAMES, len(rows))
        near, frames = list[Neighbour](), np.arange(m)
        if before in static:
            paths = track_hypotheses(footage, before.last, rows[:m], static[before].at(np.zeros(1, int)))
            near.append(Neighbour(paths, frames, earlier=True))
        if after in static:
            paths = track_hypotheses(footage, after.first, rows[::-1][:m], static[after].at(np.zeros(1, int)))
            near.append(Neighbour(paths.at(frames[::-1]), len(rows) - m + frames, earlier=False))
        solutions = solve_grasp(grasp, problem, near)
        anchors.append(Anchor(segment, solutions.hypotheses, solutions, tuple(near)))
    return anchors


def _equal_hypotheses(surface: ObjectSurface, hypotheses: Hypotheses, k: int) -> Bool[ndarray, "K"]:
    """Hypotheses whose posed surface duplicates that of hypothesis k, k included."""
    pairs = (hypotheses.take(np.array([k, other])) for other in range(len(hypotheses.scale)))
    return np.array([len(suppress_duplicates(pair, np.zeros(2), surface, 2)) == 1 for pair in pairs])


def _pairwise_link_cost(footage: TimelineInputs, one: Anchor, other: Anchor) -> Float[ndarray, "K L"]:
    mesh, (before, end), (after, begin) = footage.clip.mesh, one.end(-1), other.end(0)
    problems = [anchor.solutions.problem for anchor in (one, other) if anchor.solutions is not None]
    weight = max_link_cost(problems[0]) if problems else float(min(one.found.energy.min(), other.found.energy.min()))
    ahead = other.near_at(earlier=True) or track_hypotheses(footage, end, np.array([begin]), before)
    behind = one.near_at(earlier=False) or track_hypotheses(footage, begin, np.array([end]), after)
    return np.minimum(link_cost(mesh, ahead, before, after, weight), link_cost(mesh, behind, after, before, weight).T)


def link_cost(mesh: Mesh, paths: Paths, start: Hypotheses, ends: Hypotheses, most: float) -> Float[ndarray, "K L"]:
    """Compute the link cost of each pair of hypotheses of two segments, each at one frame [px^2], at most ``most``.

    ``paths`` lead from ``start`` to the frame of ``ends``.
    """
    d2 = squared_vertex_distance(mesh, paths.found, ends)
    own = paths.found.energy - start.energy[paths.start]
    slip2 = (LINK_SLIP_DIAMETERS * mesh.diameter) ** 2
    cost = np.full((len(start.R), len(ends.R)), most)
    np.minimum.at(cost, paths.start, own[:, None] - own.min() + most * d2 / (d2 + slip2))
    return cost


def squared_vertex_distance(mesh: Mesh, one: Hypotheses, other: Hypotheses) -> Float[ndarray, "K L"]:
    """Compute the mean squared distance of the vertices between hypotheses, each at one frame [m^2]."""
    about = mesh.vertices - mesh.centre
    posed = [h.scale[:, None, None] * about @ np.swapaxes(h.R[:, 0], -1, -2) + h.centre[:, :1] for h in (one, other)]
    return np.asarray(np.sum((posed[0][:, None] - posed[1][None]) ** 2, axis=-1).mean(axis=-1))


def best_chain(
    energy: Sequence[Float[ndarray, "_"]], links: Sequence[Float[ndarray, "_ _"]]
) -> tuple[list[int], float]:
    """Choose one hypothesis per segment by dynamic programming; also return the chain's energy.

    ``energy[i][k]`` is the energy of hypothesis k of segment i, ``links[i][k, l]`` the cost of the link from it to
    hypothesis l of segment i + 1.
    """
    total, back = energy[0], []
    for own, link in zip(energy[1:], links, strict=True):
        through = total[:, None] + link
        back.append(np.argmin(through, axis=0))
        total = own + through.min(axis=0)
    chosen = [int(np.argmin(total))]
    for step in reversed(back):
        chosen.append(int(step[chosen[-1]]))
    return chosen[::-1], float(total.min())


def second_best(
    energy: Sequence[Float[ndarray, "_"]], links: Sequence[Float[ndarray, "_ _"]], copies: Sequence[Bool[ndarray, "_"]]
) -> float:
    """Return the least energy of any chain that differs from the chosen one; infinite without another chain.

    ``copies[i]`` marks the hypotheses of segment i that duplicate the chosen one, itself included.
    """
    others = []
    for i, same in enumerate(copies):
        without = [e.astype(float) for e in energy]
        without[i][same] = np.inf
        if np.isfinite(without[i]).any():
            others.append(best_chain(without, links)[1])
    return min(others, default=float("inf"))
