"""All segments of a timeline together: each one's hypotheses, the chain of them with the least energy, all frames.

Static segments come first: the hand's errors do not touch them, and they show what it will hide. Followed into the
neighbouring grasps, their poses are starts and links of the search there. Then the chain is chosen by the energies of
all segments and of their links, and the frames between are filled in.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Segment
from getagrip.errors import InputError
from getagrip.fitting.motion import PosesInHand
from getagrip.fitting.search import suppress_duplicates
from getagrip.timelines.between import between
from getagrip.timelines.chain import best_chain, second_best
from getagrip.timelines.footage import Footage
from getagrip.timelines.grasp_segment import GraspSolutions, Neighbour, in_all_frames, most, prepared, solved
from getagrip.timelines.hypotheses import Hypotheses
from getagrip.timelines.links import followed_to, link_cost
from getagrip.timelines.motion import Motion
from getagrip.timelines.settled import settle
from getagrip.timelines.static_pose import static_hypotheses

REACH = 6
"""Frames of a grasp's problem that a link to it holds in."""


Anchor = tuple[Segment, Hypotheses, GraspSolutions | None]
"""A segment whose pose is found by itself; what is known of it at its frames, or at those of a grasp's problem."""


def joint(footage: Footage, support: bool = True, on_stage: Callable[[str], None] = lambda _: None) -> Motion:
    """The timeline of least energy. Raises ``InputError`` where no segment shows the object, as static or held."""
    static = _static(footage, support)
    on_stage("static")
    anchors, neighbours = _with_grasps(footage, static)
    on_stage("grasps")
    if not anchors:
        got = "no static segment and no grasp by a known hand that shows the object in two frames"
        raise InputError(footage.clip.origin, "segments", got, "one at least")
    pairs = zip(itertools.pairwise(anchors), itertools.pairwise(neighbours), strict=True)
    links = [_link(footage, *ends, near) for ends, near in pairs]
    energies = [hypotheses.energy for _, hypotheses, _ in anchors]
    chosen, energy = best_chain(energies, links)
    on_stage("links")
    copies = [_copies(footage, found, k) for (_, found, _), k in zip(anchors, chosen, strict=True)]
    motion = Motion.of(footage)
    motion.energy = energy, second_best(energies, links, copies)
    known = list[Segment]()
    for (segment, hypotheses, grasp), k, near in zip(anchors, chosen, neighbours, strict=True):
        if grasp is None:
            motion.put(footage, segment.rows, hypotheses.take(np.array([k])), "sampled")
            known.append(segment)
        else:
            rows = put_grasp(motion, footage, grasp, k, near)
            settle(motion, footage, rows, grasp.problem.clip.side)
            known += runs(segment, rows)
    on_stage("all frames")
    fill(motion, footage, known)
    on_stage("between")
    return motion


def put_grasp(
    motion: Motion, footage: Footage, grasp: GraspSolutions, k: int, neighbours: list[Neighbour]
) -> Int[ndarray, "n"]:
    """A solution of a grasp, in all of its frames in which its hand is known, and which these are."""
    track = in_all_frames(footage, grasp, k, neighbours)
    rows = track.rows
    motion.T_cam_obj[rows] = track.T_cam_hand @ track.T_hand_obj
    motion.T_cam_hands[grasp.problem.clip.side][rows] = track.T_cam_hand
    for row, kind in zip(rows, track.kind, strict=True):
        motion.kind[row] = kind
    own = [note for note in track.notes if note not in footage.some.notes]
    motion.notes += [f"grasp from {footage.clip.frames[rows[0]]}: {note}" for note in own]
    motion.grasps[grasp.segment.first] = track
    if track.axis is not None:
        motion.axes[grasp.segment.first] = track.axis
    return rows


def runs(segment: Segment, rows: Int[ndarray, "n"]) -> list[Segment]:
    """The parts of a segment that have no gaps: some of its frames, which rise."""
    parts = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)
    return [replace(segment, first=int(part[0]), last=int(part[-1])) for part in parts]


def fill(motion: Motion, footage: Footage, known: list[Segment]) -> None:
    """The frames between segments that are known, and before and after them."""
    edges = [(None, known[0]), *itertools.pairwise(known), (known[-1], None)]
    for one, other in edges:
        begin, end = 0 if one is None else one.last + 1, len(footage) if other is None else other.first
        if end > begin:
            before = None if one is None else motion.at(footage, one.last)
            after = None if other is None else motion.at(footage, other.first)
            rows = np.arange(begin, end)
            motion.put(footage, rows, between(footage, rows, before, after), "fitted")


def _static(footage: Footage, support: bool) -> dict[Segment, Hypotheses]:
    """The hypotheses of the static segments."""
    found = {s: static_hypotheses(footage, s, support) for s in footage.clip.segments if s.state == "static"}
    return {segment: hypotheses for segment, hypotheses in found.items() if hypotheses is not None}


def _with_grasps(footage: Footage, static: dict[Segment, Hypotheses]) -> tuple[list[Anchor], list[list[Neighbour]]]:
    """Static segments and grasps in their order, and the links that each grasp was searched with."""
    problems = {s: prepared(footage, s) for s in footage.clip.segments if s.state == "grasp"}
    order = [s for s in footage.clip.segments if s in static or problems.get(s) is not None]
    anchors: list[Anchor] = []
    neighbours: list[list[Neighbour]] = []
    for n, segment in enumerate(order):
        problem, near = problems.get(segment), list[Neighbour]()
        if problem is None:
            anchors.append((segment, static[segment], None))
            neighbours.append(near)
            continue
        rows = footage.clip.index_of(problem.clip.frames)
        m = min(REACH, len(rows))
        if n and order[n - 1] in static:
            one = order[n - 1]
            paths = followed_to(footage, one.last, rows[:m], static[one].at(np.zeros(1, int)))
            near.append(Neighbour(paths, np.arange(m), earlier=True))
        if n + 1 < len(order) and order[n + 1] in static:
            one = order[n + 1]
            paths = followed_to(footage, one.first, rows[::-1][:m], static[one].at(np.zeros(1, int)))
            frames = np.arange(len(rows) - m, len(rows))
            near.append(Neighbour(paths.at(np.arange(m)[::-1]), frames, earlier=False))
        grasp = solved(footage, segment, problem, near)
        anchors.append((segment, grasp.hypotheses, grasp))
        neighbours.append(near)
    return anchors, neighbours


def _copies(footage: Footage, hypotheses: Hypotheses, k: int) -> Bool[ndarray, "K"]:
    """Which hypotheses put the object's surface where hypothesis k has it, k included."""
    poses = PosesInHand(hypotheses.R, hypotheses.centre, hypotheses.scale)
    surface = footage.some.surface
    pairs = (poses.take(np.array([k, other])) for other in range(len(hypotheses.scale)))
    return np.array([len(suppress_duplicates(pair, np.zeros(2), surface, 2)) == 1 for pair in pairs])


def _link(
    footage: Footage, one: Anchor, other: Anchor, near: tuple[list[Neighbour], list[Neighbour]]
) -> Float[ndarray, "K L"]:
    """What each pair of hypotheses of two neighbouring segments costs; ``near``: those followed into grasps already."""
    mesh, (before, end), (after, begin) = footage.clip.mesh, _end(one, -1), _end(other, 0)
    problems = [grasp.problem for _, _, grasp in (one, other) if grasp is not None]
    weight = most(problems[0]) if problems else float(min(one[1].energy.min(), other[1].energy.min()))
    ahead = next((x.paths.at(np.array([0])) for x in near[1] if x.earlier), None)
    behind = next((x.paths.at(np.array([-1])) for x in near[0] if not x.earlier), None)
    ahead = ahead or followed_to(footage, end, np.array([begin]), before)
    behind = behind or followed_to(footage, begin, np.array([end]), after)
    return np.minimum(link_cost(mesh, ahead, before, after, weight), link_cost(mesh, behind, after, before, weight).T)


def _end(anchor: Anchor, side: int) -> tuple[Hypotheses, int]:
    """The hypotheses of a segment at its first known frame (side 0) or its last (-1), and which that is."""
    segment, hypotheses, grasp = anchor
    row = int(grasp.rows[side]) if grasp else segment.last if side else segment.first
    return hypotheses.at(np.array([side])), row
