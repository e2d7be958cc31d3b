"""Agreement of views after the fit: a further view that no pose meets together with the others is left out.

A camera that is turned about the object, or moved along its ray, contradicts no other by geometry alone
(``evidence.epipolar``). Then no pose meets all masks. A view is suspect where a few iterations without it, from the
joint fit, meet the masks of the others better; the clip is fitted again without it, and the view is left out if that
meets them far better.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from getagrip.fitting.energy.in_view import VIEW_SEPARATOR
from getagrip.fitting.motion import hand_object_transforms
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solver.solve import minimise
from getagrip.fitting.stages.robust_masks import image_iou

RELEASE_LEVEL_PX, RELEASE_ITERATIONS = 128, 8
"""Resolution [px] and iterations of the fit without a view."""
SUSPICIOUS_RELEASE_RATIO, MAX_JOINT_RATIO = 1.12, 2.5
"""Energy of the masks of all other views in the joint fit, in that after these iterations, above which a view is
suspect, and in that of a fit without the view, above which the view is left out."""
MIN_VIEW_IOU = 0.5
"""Mean IOU below which a view is suspect, too."""


def suspect_view(problem: Problem, found: MethodResult) -> str | None:
    """Find the further view without which the masks of the others are met better most; None if all agree.

    The problem has the mesh and the hand of the fit (``Problem.as_found``).
    """
    T_hand_obj = hand_object_transforms(found.poses, problem.clip.mesh.centre)[0]
    scale, ratios = float(found.poses.scale[0]), dict[str, float]()
    for view in problem.views:
        iou = image_iou(view.clip(problem.clip), view.masks, T_hand_obj[view.rows], scale)
        ratios[view.name] = np.inf if np.nanmean(iou) < MIN_VIEW_IOU else _release_ratio(problem, found, view.name)
    worst = max(ratios, key=lambda name: ratios[name], default=None)
    return worst if worst is not None and ratios[worst] > SUSPICIOUS_RELEASE_RATIO else None


def is_in_the_way(view: str, joint: MethodResult, without: MethodResult) -> bool:
    """Return whether a view's masks keep a joint fit from the masks of the others, which a fit without it meets."""
    return _mask_energy(joint.terms, view) > MAX_JOINT_RATIO * _mask_energy(without.terms, view)


def _mask_energy(terms: Mapping[str, float], but: str) -> float:
    """Sum the energy of the masks of all views but one."""
    names = (name.partition(VIEW_SEPARATOR) for name in terms)
    return sum(terms["".join(name)] for name in names if name[0] == "mask" and name[2] != but)


def _release_ratio(problem: Problem, found: MethodResult, name: str) -> float:
    """Compute the energy of all masks but a view's in the fit, in their energy after a few iterations without it.

    0 of a method without a motion of its own.
    """
    if found.motion is None or found.energy_of is None:
        return 0.0
    without = replace(problem, views=tuple(view for view in problem.views if view.name != name))
    terms = found.energy_of(without)(RELEASE_LEVEL_PX, np.arange(len(problem.clip)))
    motion, T_cam_hand = found.motion.take(np.zeros(1, int)), problem.clip.hand.T_cam_hand
    ends = (minimise(motion, terms, T_cam_hand, iterations).terms for iterations in (0, RELEASE_ITERATIONS))
    before, after = (_mask_energy({key: float(value[0]) for key, value in end.items()}, name) for end in ends)
    return before / max(after, 1e-9)
