"""What a user may choose about a reconstruction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from getagrip.errors import UsageError
from getagrip.fitting.methods import method_of
from getagrip.io.choices import check_values

Hands = Literal["corrected", "as-given"]
GivenMasks = Literal["checked", "as-given"]
GivenMesh = Literal["fitted", "as-given"]
Init = Literal["uniform", "clusters", "priors"]


@dataclass(frozen=True)
class PriorsFile:
    """A file or folder of initial poses (``pose_priors.given``)."""

    path: Path
    sha256: str
    """What it held when it was named: results say which initial poses they had."""
    alone: bool = False
    """Whether a search starts from its poses only, with no uniform rotations after them, as the paper's does."""


@dataclass(frozen=True)
class Departures:
    """What ``paper`` does our way; nothing, and it is the paper's method to the letter.

    With all of them it is ``one-dof`` with hands as given; but where the scale is free ``one-dof`` has twice as many
    initial poses, and gaps between the masks (``mask_gaps``) count as background here. Raises ``UsageError`` for a
    search without its optimiser.

    Attributes:
        scale: push is a mean over vertices, as pull is over fingers, and both weigh by the area of the masks
            (``objective.contact_weights``), instead of a sum, and of 0.1 f per millimetre.
        push: mean depth of the contact vertices in the object (``PushTerm``), instead of the sum of the depths of the
            object's vertices behind the hand's tangent planes (``PaperPushTerm``).
        pull: distance to the surface, at most 1 cm (``PullTerm``), instead of the signed height over a tangent plane of
            the object (``PaperPullTerm``).
        axis: axis and angles start from the data, by a coarse static and a coarse relaxed fit (``Search.relax``),
            instead of at the CAD's z-axis and at zero.
        optimiser: Levenberg-Marquardt (``solve.minimise``), instead of Adam (``adam.descend``).
        search: coarse to fine, pruned and rotated (``Search``), instead of every initial pose to its end.
        choice: the least energy, instead of the best IOU.
    """

    scale: bool = False
    push: bool = False
    pull: bool = False
    axis: bool = False
    optimiser: bool = False
    search: bool = False
    choice: bool = False

    def __post_init__(self) -> None:
        if self.search and not self.optimiser:
            raise UsageError("departures: got search without optimiser, whose stages are Levenberg-Marquardt's")


TO_THE_LETTER = Departures()
"""No departure."""


WITH_FREE_SCALE = 2
"""Times as many initial poses where the scale is free: another size makes up for a wrong turn for longer."""


@dataclass(frozen=True)
class Options:
    """How to reconstruct a clip.

    Attributes:
        method: a name in ``methods.METHODS``: how the object may move in the hand, or a baseline.
        inits: number of initial poses, twice as many where the scale is free (but for the paper's method to the
            letter); more is slower and safer, fewer than 50 is unsafe.
        init: where initial poses come from: uniform rotations only (``uniform``); before them, those that
            ``init learn`` has learnt (``clusters``), or a folder of poses by category and side, as the authors have
            theirs (``priors``).
        priors: the file or folder of the poses of ``init``, and whether they stand alone; None for ``uniform``.
        thorough: search two to three times as long, for the methods that fit all frames at once; no other changes.
        seed: rotates the set of initial rotations; the same seed gives the same result.
        frames: number of frames that are fitted together, sampled evenly from the clip.
        every_frame: go on from these to every frame of the clip.
        push: weight of E_push, the paper's lambda_2 without the focal length.
        pull: weight of E_pull, the paper's lambda_3 without the focal length.
        axis: where a hinge's axis may lie: anywhere (``free``), or through the origin of the hand frame
            (``hand``).
        occlusion: leave out pixels hidden by the hand (the paper's C_o).
        hands: correct the given hands where they jump (``hand_jumps``) and by their own pixels (``hand_correction``),
            or take them as they are given.
        masks: leave out those that contradict the others (``soft-hinge`` and ``one-dof``), or believe all.
        mesh: warp it where it is not the object's own (``soft-hinge`` and ``one-dof``), or take it as given.
        departures: what ``paper`` does our way; no other method has a choice.
    """

    method: str = "soft-hinge"
    inits: int = 50
    init: Init = "uniform"
    priors: PriorsFile | None = None
    thorough: bool = False
    seed: int = 0
    frames: int = 30
    every_frame: bool = True
    push: float = 0.1
    pull: float = 0.1
    axis: Literal["free", "hand"] = "free"
    occlusion: bool = True
    hands: Hands = "corrected"
    masks: GivenMasks = "checked"
    mesh: GivenMesh = "fitted"
    departures: Departures = TO_THE_LETTER

    def __post_init__(self) -> None:
        method_of(self.method)
        check_values(self)
        if self.departures != TO_THE_LETTER and self.method != "paper":
            raise UsageError(f"departures: got some with method {self.method!r}, expected none but with 'paper'")
        if self.inits < 1 or self.frames < 2:
            raise UsageError(f"inits and frames: got {self.inits} and {self.frames}, expected at least 1 and 2")
        if (self.init == "uniform") != (self.priors is None):
            wanted = "none for uniform rotations" if self.init == "uniform" else f"a file or folder for {self.init}"
            raise UsageError(f"priors: got {self.priors and self.priors.path}, expected {wanted}")
        if self.seed < 0:
            raise UsageError(f"seed: got {self.seed}, expected 0 or more")
        if not (0 <= self.push < math.inf and 0 <= self.pull < math.inf):
            raise UsageError(f"push and pull: got {self.push} and {self.pull}, expected finite weights of 0 or more")
