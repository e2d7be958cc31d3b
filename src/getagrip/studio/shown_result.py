"""The result of a grasp as the page shows it: its verdict, what to do next, its candidates, and its outlines.

The outlines of hand and object lie over the footage in every frame; a candidate has its own, and can become the result.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.checks import RESULT_CHECKS, Evidence, result_checks, run_checks
from getagrip.clip import find_masks
from getagrip.clip.masks import occluded_by_hand
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.rasterize import Surface, render_coverage
from getagrip.metrics.evaluate.results import read_result_and_clip
from getagrip.metrics.mask import iou_of_poses
from getagrip.report.pictures.result_view import View, candidate_view
from getagrip.result import Reconstruction, read_result, read_result_record, write_result
from getagrip.result.findings import format_probability

OBJECT_HALF_SIZE_M = 0.04
"""Assumed half size of an object, by which its motion in the hand is measured [m]."""
OUTLINE_LENGTH_PX = 960
"""Longer side of the image in which silhouettes are rendered, at most [px]."""
OUTLINE_TOLERANCE_PX = 0.6
"""Distance by which a corner of an outline may differ from its silhouette, in that image [px]."""
MIN_OUTLINE_AREA_PX = 12.0
"""Area of the smallest part of a silhouette with an outline [px^2]."""
MASK_STEPS, SHAPE_STEPS, SIZE_STEPS, POSE_STEPS = ("draw",), ("mesh",), ("size",), ("candidate", "size")
STEPS_OF_CHECKS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("mesh-holes", "mesh-open", "mesh-flat", "mesh-needle", "mesh-deformed"), SHAPE_STEPS),
    **dict.fromkeys(
        ("object-size", "mask-size", "visible-size", "wrong-size", "other-size", "result-size"), SIZE_STEPS
    ),
    **dict.fromkeys(("hand-size", "second-gap", "penetration"), SIZE_STEPS),
    **dict.fromkeys(("object-over-hand", "contact-gap"), POSE_STEPS),
    **dict.fromkeys(("worst-frame", "uneven-mask-fit", "many-outlier-masks", "outlier-masks"), MASK_STEPS),
    **dict.fromkeys(("mask-at-edges", "hand-over-object", "masks-follow-hand"), MASK_STEPS),
    **dict.fromkeys(("mask-fit", "large-mask-misfit", "mask-misfit", "mesh-much-deformed"), ("draw", "mesh")),
    "poor-mask-fit": ("candidate", "mesh"),
    "opening-away": ("candidate",),
    "regrasp": ("cut",),
}
"""Steps to take on the page after the finding of a check."""
USUAL_STEPS = ("candidate", "draw", "size")
"""Steps to take where a result looks wrong, or is uncertain, without such a finding."""
GUESSED_TOPICS = {
    "scale": "the object's size", "shape": "the object's shape", "hands_side": "which hand it is",
    "hands_focal": "the hand's distance", "hands_scale": "the hand's size", "camera": "the focal length",
}  # fmt: skip
"""Topics of assumptions, in words."""
Outline = list[list[float]]
"""The corners of a closed line [px of the footage]."""


def describe_result(folder: Path) -> dict[str, object]:
    """Return what the page says of the result in a folder.

    The ``verdict`` with the ``probability`` as text, the ``findings``, the serious ones first, each with its ``steps``,
    the steps to take next, the number of ``candidates``, and what was ``guessed``. A result that does not read is
    uncertain, and its error is the finding.
    """
    try:
        result = read_result(folder)[0]
    except InputError as error:
        found = {"serious": True, "message": str(error), "steps": []}
        about: dict[str, object] = {"verdict": "uncertain", "probability": "", "findings": [found]}
        return about | {"steps": [], "candidates": 0, "guessed": {}}
    findings = sorted(result.findings, key=lambda finding: not finding.serious)
    known, of = result.probability_looks_right, "right but for its distance"
    if known is None:
        known, of = result.probability_right, "right"
    word = result.verdict
    urgent = [step for one in findings if one.serious for step in STEPS_OF_CHECKS.get(one.check, ())]
    needed = () if word == "right" else (*urgent, *(() if urgent else USUAL_STEPS))
    return {
        "verdict": word,
        "probability": "" if known is None else f"{format_probability(known.value)} that it is {of}",
        "findings": [
            {
                "serious": finding.serious,
                "message": finding.message,
                "steps": _steps(result, STEPS_OF_CHECKS.get(finding.check, ())),
            }
            for finding in findings
        ],
        "steps": _steps(result, needed),
        "candidates": 0 if result.segments else len(result.candidates.scale),
        "guessed": {GUESSED_TOPICS.get(key, key.replace("_", " ")): text for key, text in result.assumptions.items()},
    }


def _steps(result: Reconstruction, wanted: Iterable[str]) -> list[dict[str, object]]:
    """Return those of the steps that a result allows, each once, with the names of their frames."""
    out = list[dict[str, object]]()
    for do in dict.fromkeys(wanted):
        step: dict[str, object] = {"do": do}
        if do == "draw":
            if not np.isfinite(result.iou).any():
                continue
            step["frames"] = [result.frames[int(np.nanargmin(result.iou))]]
        elif do == "cut":
            if result.segments or len(result.frames) < 3:
                continue
            before, after = largest_jump(result)
            first, last = result.frames[:before], result.frames[after:]
            longer = result.frames[: before + 1] if len(first) >= len(last) else last
            step["frames"] = [longer[0], longer[-1]]
        elif do == "candidate" and (result.segments or len(result.candidates.scale) < 2):
            continue
        out.append(step)
    return out


def largest_jump(result: Reconstruction) -> tuple[int, int]:
    """Return the two sampled frames between which the object moves most in the hand, of at least two."""
    sampled = result.frames_of("sampled")
    points = se3.transform(result.T_hand_obj[sampled], OBJECT_HALF_SIZE_M * np.concatenate([np.eye(3), -np.eye(3)]))
    n = int(np.square(points[1:] - points[:-1]).sum(axis=(1, 2)).argmax())
    return int(sampled[n]), int(sampled[n + 1])


class ResultOutlines:
    """The outlines of a result and its candidates over the footage."""

    def __init__(self, folder: Path) -> None:
        """Read the result in a folder, and its clip. Raises ``InputError``."""
        result, clip = read_result_and_clip(folder)
        self.view = View.of(result, clip, None)
        self.rows = {name: n for n, name in enumerate(result.frames)}

    def of(self, name: str, rank: int, width: int) -> dict[str, list[Outline]]:
        """Return the outlines of hand and object in a frame, of a candidate, in footage of a ``width`` [px].

        Candidate 0 is the result. Raises ``UsageError`` for a frame or candidate that the result lacks.
        """
        candidates = len(self.view.result.candidates.scale)
        if name not in self.rows or not 0 <= rank < candidates:
            raise UsageError(f"candidate must be 0 to {candidates - 1}, in a frame of the result")
        n, view = self.rows[name], candidate_view(self.view, rank)
        zoom = min(1.0, OUTLINE_LENGTH_PX / max(view.clip.size))
        size = (round(zoom * view.clip.size[0]), round(zoom * view.clip.size[1]))
        K, to_footage = np.diag([zoom, zoom, 1.0]) @ view.clip.K[n], width / size[0]

        def traced(surface: Surface) -> list[Outline]:
            return [(to_footage * one).round(1).tolist() for one in trace_outlines(render_coverage(*surface, K, size))]

        hands = [line for hand in view.hands(n) for line in traced(hand)]
        return {"object": traced(view.surface(n)), "hand": hands}


def trace_outlines(mask: Bool[ndarray, "H W"]) -> list[Float[ndarray, "_n 2"]]:
    """Return the closed lines around the parts of a mask and around its holes [px]."""
    import cv2

    found, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    lines = [np.asarray(cv2.approxPolyDP(one, OUTLINE_TOLERANCE_PX, True)[:, 0], float) for one in found
             if cv2.contourArea(one) >= MIN_OUTLINE_AREA_PX]  # fmt: skip
    return [line + 0.5 for line in lines if len(line) > 2]


def take_candidate(folder: Path, rank: int) -> Reconstruction:
    """Make a candidate the result in a folder, and the result candidate ``rank``; return the new result.

    It is judged by its own masks and findings, without a probability: none is calibrated for what a person chooses.
    Raises ``InputError``, ``UsageError`` for a candidate that the result lacks.
    """
    record, (result, clip) = read_result_record(folder), read_result_and_clip(folder)
    if result.segments or not 0 < rank < len(result.candidates.scale):
        raise UsageError(f"the result has no candidate {rank + 1}")
    view = View.of(result, clip, find_masks(clip))
    taken, order = candidate_view(view, rank).result, [*range(len(result.candidates.scale))]
    order[0], order[rank] = rank, 0
    of_poses = {check.name for check in result_checks()}
    iou, findings = taken.iou, [one for one in result.findings if one.check not in of_poses]
    checks = {name: value for name, value in result.checks.items() if name not in of_poses}
    if view.masks is not None:
        masks = view.masks if view.masks.say_what_hides else occluded_by_hand(view.clip, view.masks)
        poses = view.clip.hand.T_cam_hand @ taken.T_hand_obj
        iou = iou_of_poses(view.clip.mesh, taken.scale, poses, view.clip.K, masks).full
        grasp = Evidence(view.clip, view.masks, taken.T_hand_obj, taken.scale, iou)
        measured, after = run_checks(RESULT_CHECKS.working().values(), grasp)
        findings, checks = [*findings, *after], checks | measured
    chosen = replace(
        taken, iou=iou, findings=tuple(findings), checks=checks,
        energy={"total": float(result.candidates.energy[rank])},
        candidates=replace(
            result.candidates, T_hand_obj=result.candidates.T_hand_obj[order], scale=result.candidates.scale[order],
            energy=result.candidates.energy[order],
        ),
        notes=(*result.notes, f"candidate {rank + 1} of the fit was chosen by a person"),
    )  # fmt: skip
    write_result(
        chosen, folder, record["input_sha256"], clip_folder=clip.folder, overwrite=True,
        made_by=record["software"],
    )  # fmt: skip
    return chosen
