"""Evidence for and against each candidate of a result: its energy, and metrics that the energy does not contain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from getagrip.checks import RESULT_CHECKS, Evidence, run_checks
from getagrip.checks.inputs import median_hand_object_gap, penetration_depth
from getagrip.clip.masks import occluded_by_hand
from getagrip.metrics.contact import pairwise_iou, stable_contact_area
from getagrip.metrics.mask import iou_of_poses
from getagrip.metrics.pose import ObjectTrack, pose_errors
from getagrip.report.pictures.result_view import View
from getagrip.result.findings import Finding

CANDIDATE_TABLE_HEADINGS = ("", "energy", "IOU %", "gap mm", "depth mm", "SCA %", "ADD mm")
SCA_CONTACT_DISTANCE_M = 0.010
"""Distance to the object within which a point of the hand is in contact, for the stable contact area [m]."""


@dataclass(frozen=True)
class CandidateMetrics:
    """The metrics of one candidate; NaN where not known.

    Attributes:
        energy: energy [px^2 of the 256-pixel crop].
        excess: energy above the lowest of all candidates, as a fraction of the lowest.
        iou: mean overlap with the observed masks.
        gap: smallest distance of hand and object, median over frames [mm].
        depth: depth of the hand's deepest point inside the object, median over frames [mm].
        sca: stable contact area of the hand's points.
        add: mean distance of the object's vertices from the ground truth [mm].
        findings: findings of the result checks (docs/checks.md).
    """

    energy: float
    excess: float
    iou: float
    gap: float
    depth: float
    sca: float
    add: float
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class CandidateCriterion:
    """A metric by which candidates are compared."""

    value: Callable[[CandidateMetrics], float]
    more_is_better: bool
    margin: float
    """Difference below which candidates count as equal."""
    words: str
    """Text with the placeholders ``{value}`` and ``{best}``."""
    factor: float = 1.0


CANDIDATE_CRITERIA = (
    CandidateCriterion(lambda it: it.excess, False, 0.05, "energy {value:.0f} % above the lowest", 100.0),
    CandidateCriterion(lambda it: it.iou, True, 0.01, "mask IOU {value:.1f} % (best: {best:.1f} %)", 100.0),
    CandidateCriterion(lambda it: it.gap, False, 2.0, "gap of hand and object {value:.1f} mm (least: {best:.1f} mm)"),
    CandidateCriterion(lambda it: it.depth, False, 3.0, "hand {value:.1f} mm deep inside (least: {best:.1f} mm)"),
    CandidateCriterion(lambda it: it.sca, True, 0.05, "stable contact area {value:.0f} % (most: {best:.0f} %)", 100.0),
)
"""Criteria that need no ground truth, which users' own footage lacks."""


def compute_candidate_metrics(view: View) -> list[CandidateMetrics]:
    """Compute the metrics of each candidate of a result over the frames of ``view``, best energy first."""
    true, candidates = view.true(), view.result.candidates
    lowest = float(candidates.energy.min())
    out = []
    for T_hand_obj, scale, energy in zip(candidates.T_hand_obj, candidates.scale, candidates.energy, strict=True):
        iou, add = np.full(len(view.clip), np.nan), float("nan")
        track = ObjectTrack(T_hand_obj, float(scale))
        if true is not None:
            known = ObjectTrack(true.result.T_hand_obj, true.result.scale)
            add = 1e3 * float(np.mean(pose_errors(view.clip.mesh, track, known).add))
        if view.masks is not None:
            poses = view.clip.hand.T_cam_hand @ T_hand_obj
            masks = view.masks if view.masks.say_what_hides else occluded_by_hand(view.clip, view.masks)
            iou = iou_of_poses(view.clip.mesh, track.scale, poses, view.clip.K, masks).full
        findings: tuple[Finding, ...] = ()
        mean, deep, far, stable = (float("nan"),) * 4
        if view.masks is not None and np.isfinite(iou).any():
            grasp = Evidence(view.clip, view.masks, T_hand_obj, track.scale, iou)
            findings = run_checks(RESULT_CHECKS.working().values(), grasp)[1]
            mean, deep, far = float(np.nanmean(iou)), penetration_depth(grasp), median_hand_object_gap(grasp)
            stable = stable_contact_area(pairwise_iou(grasp.to_object <= SCA_CONTACT_DISTANCE_M))
        excess = float(energy) / lowest - 1.0 if lowest > 0.0 else float("nan")
        out.append(CandidateMetrics(float(energy), excess, mean, far, deep, stable, add, findings))
    return out


def compare_candidates(view: View) -> dict[str, object]:
    """Make a table of all candidates, and the arguments for and against each, as the page shows them."""
    known = compute_candidate_metrics(view)
    rows = [[str(rank + 1), *_format_candidate_row(it)] for rank, it in enumerate(known)]
    columns = [k for k in range(len(CANDIDATE_TABLE_HEADINGS)) if any(row[k] for row in rows)]
    pros, cons = zip(*(weigh_candidate(known, rank) for rank in range(len(known))), strict=True)
    head, cells = [CANDIDATE_TABLE_HEADINGS[k] for k in columns], [[row[k] for k in columns] for row in rows]
    return {"head": head, "rows": cells, "pros": pros, "cons": cons}


def _format_candidate_row(it: CandidateMetrics) -> list[str]:
    """Return the cells below all but the first of ``CANDIDATE_TABLE_HEADINGS``; empty for NaN."""
    values = (it.energy, 100 * it.iou, it.gap, it.depth, 100 * it.sca, it.add)
    return ["" if np.isnan(v) else f"{v:.{d}f}" for v, d in zip(values, (0, 1, 1, 1, 0, 1), strict=True)]


def weigh_candidate(candidates: Sequence[CandidateMetrics], rank: int) -> tuple[list[str], list[str]]:
    """Return the arguments for a candidate and against it, from ``CANDIDATE_CRITERIA`` and its findings."""
    it = candidates[rank]
    pro, con = [], [str(finding) for finding in it.findings]
    for question in CANDIDATE_CRITERIA:
        values = np.array([question.value(other) for other in candidates])
        if len(values) < 2 or not np.isfinite(values[rank]):
            continue
        sign = 1.0 if question.more_is_better else -1.0
        best = sign * float(np.nanmax(sign * values))
        text = question.words.format(value=question.factor * values[rank], best=question.factor * best)
        if abs(values[rank] - best) > question.margin:
            con.append(text)
        elif np.any(np.abs(values - best) > question.margin):
            pro.append("lowest energy" if question is CANDIDATE_CRITERIA[0] else text)
    return pro, con
