"""Further views (``views``): the evidence of other calibrated cameras on the same hand and object."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.checks.check import Check
from getagrip.checks.evidence import MAX_NAMED_FRAMES, Evidence
from getagrip.clip import Clip, Modality
from getagrip.clip.views import VIEWS_KEY, Views, read_views, view_files, views_of, write_view
from getagrip.fitting.energy import Energy, Terms

if TYPE_CHECKING:  # files of clips are asked for by commands that fit nothing
    from getagrip.fitting.energy.in_view import ViewedEnergy
    from getagrip.fitting.problem import Problem


MAX_FRAMES_OUT_OF_STEP = 0.1
"""Offset in time of a view that makes no difference [frames]."""


def describe_views_left_out(it: Evidence) -> str:
    """Name the further views that were left out."""
    names = ", ".join(it.views_left_out)
    if len(it.views_left_out) == 1:
        return f"the view {names} contradicts the clip and was left out"
    return f"the views {names} contradict the clip or each other and were left out"


def describe_view_outliers(it: Evidence) -> str:
    """List the outlier masks of further views."""
    masks = ", ".join(f"{view} {frame}" for view, frame in it.view_outliers[:MAX_NAMED_FRAMES])
    more = len(it.view_outliers) - MAX_NAMED_FRAMES
    return f"masks of further views contradict the others and were left out: {masks}" + f" and {more} more" * (more > 0)


def frames_out_of_step(it: Evidence) -> float:
    """Return the largest stated offset in time of a further view [frames of the clip]; NaN without any."""
    return max((abs(view.time_offset) * it.clip.fps for view in views_of(it.clip)), default=float("nan"))


def unseen_views(it: Evidence) -> list[str]:
    """Name the further views without a mask that shows the object."""
    return [view.name for view in views_of(it.clip) if not view.masks.observed.any()]


class FurtherViews(Modality[Views]):
    """Masks, depth and joints of other cameras."""

    name = VIEWS_KEY
    result_checks = (
        Check(
            "view-contradicts", lambda it: float(len(it.views_left_out)), high=0.0, serious=False,
            fault=describe_views_left_out,
            advice="compare the poses and intrinsics of the cameras, the times of their images, and whether all show "
            "this object; with two views either may be the wrong one",
        ),
        Check(
            "view-outliers", lambda it: float(len(it.view_outliers)), high=0.0, serious=False,
            fault=describe_view_outliers, advice="look at these masks",
        ),
        Check(
            "view-out-of-step", frames_out_of_step, high=MAX_FRAMES_OUT_OF_STEP, serious=False,
            fault="cameras are up to {value} frames out of step",
            advice="start them together, or use frames in which hand and object are slow",
        ),
        Check(
            "view-unseen", lambda it: float(len(unseen_views(it))), high=0.0, serious=False,
            fault=lambda it: f"no mask of {', '.join(unseen_views(it))} shows the object in the clip's frames",
            advice="add its masks (import masks --view), under the names of the clip's frames",
        ),
    )  # fmt: skip

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return view_files(folder, frames)

    def read(self, clip: Clip) -> Views | None:
        return read_views(clip)

    def write(self, clip: Clip, folder: Path) -> None:
        for view in () if (views := self.of(clip)) is None else views.each:
            write_view(view, clip, folder)

    def terms(self, problem: Problem) -> Terms | None:
        from getagrip.fitting.energy.in_view import ViewedEnergy

        objects, hands = list[ViewedEnergy](), list[ViewedEnergy]()
        for view in problem.views:
            for terms in problem.in_view(view).evidence:
                for energy, energies in ((terms.object, objects), (terms.hand, hands)):
                    if energy is not None:
                        energies.append(ViewedEnergy(energy, view.name, view.rows, view.T_view_cam))
        return Terms(_sum_of(objects), _sum_of(hands)) if objects or hands else None


def _sum_of(energies: Sequence[ViewedEnergy]) -> Energy | None:
    """Return the energy of all views; None without any."""
    return (lambda level, index: [term for one in energies for term in one(level, index)]) if energies else None
