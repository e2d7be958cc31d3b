"""The options of a reconstruction, once for Python and for the command line."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Fixed, FlagConversionOff, Suppress, arg

from getagrip.errors import NamedFields, UsageError
from getagrip.fitting.methods import METHODS, method_of
from getagrip.io.options import (
    Flag,
    check_values,
    check_word,
    expand_user_path,
    explain_fields,
    parsed_argument,
    switch,
)

Hands = Literal["corrected", "as-given"]
MaskUse = Literal["checked", "as-given"]
MeshUse = Literal["fitted", "as-given"]
IntervalUse = Literal["firm", "as-given"]
Init = Literal["uniform", "clusters", "priors", "poses"]
BesideMasks = Literal["texture", "profile", "handle", "surface-motion"]


@dataclass(frozen=True)
class PriorsFile:
    """A file or folder of initial poses."""

    path: Path
    sha256: str = ""
    """Checksum of its content when the options were made, for the record in results."""
    first: int | None = None
    """The number of the first frame's pose, where poses are numbered from another start than the clip's frames."""

    @classmethod
    def of(cls, text: str) -> PriorsFile:
        """Make the choice from a path that a user types."""
        return cls(Path(expand_user_path(text)))


@dataclass(frozen=True)
class Departures:
    """Ablation switches: each replaces one part of the paper's method by ours.

    With all of them the method is ``one-dof`` with ``hands="as-given"``; but where the scale is free ``one-dof`` has
    twice as many initial poses, and gaps between the masks count as background here. Raises ``UsageError`` for a search
    without its optimiser.

    Attributes:
        scale: push is a mean over vertices, as pull is over fingers, and both weigh by the area of the masks
            (``objective.contact_weights``), instead of a sum, and of 0.1 f per metre.
        push: mean depth of the contact vertices in the object (``PushTerm``), instead of the sum of the depths of the
            object's vertices behind the hand's tangent planes (``PaperPushTerm``).
        pull: distance to the surface, at most 1 cm (``PullTerm``), instead of the height over a tangent plane of the
            object (``PaperPullTerm``).
        axis: axis and angles start from the data, by a coarse static and a coarse relaxed fit (``Search.relax``),
            instead of at the CAD's z-axis and at zero.
        optimiser: Levenberg-Marquardt (``solve.minimise``), instead of Adam (``solve.minimise_by_adam``).
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
            raise UsageError("missing departures.optimiser: the stages of departures.search are Levenberg-Marquardt's")


NO_DEPARTURE = Departures()
"""The paper's method."""
FREE_SCALE_START_FACTOR = 2
"""Factor on the number of initial poses where the scale is free: another size compensates a wrong rotation longer."""


def _methods(default: str) -> str:  # called when help is shown
    return f"(one of {', '.join(METHODS)}; default: {default})"


@explain_fields
@dataclass(frozen=True)
class SearchOptions(NamedFields):
    """Options that all methods of a comparison share. Raises ``UsageError`` for a value that is not allowed."""

    inits: Annotated[int, arg(metavar="N")] = 50
    """Number of initial poses; doubled if the scale is free (except by the paper's own method). More initial poses are
    slower and find the right pose more often; fewer than 50 may miss it."""
    init: Init = "uniform"
    """Source of the initial rotations. uniform: spread evenly; clusters: from a file that init learn has written;
    priors: from a folder with a file per category and side, as the paper's authors publish theirs; poses: another
    system's poses of the clip in each frame, as for evaluate --poses. These come first and are filled up with evenly
    spread ones."""
    priors: Annotated[
        PriorsFile | None,
        parsed_argument("PATH", PriorsFile.of, PriorsFile),
        arg(metavar="PATH", help_behavior_hint=""),
    ] = None
    """The file of --init clusters, the folder of --init priors, or the file or folder of --init poses."""
    priors_only: Flag = False
    """Use only the poses of --priors, at most --inits of them, without evenly spread ones. The paper does so. A clip
    fails if --priors has no pose for its category and side."""
    thorough: Flag = False
    """Search two to three times as long, as is always done beside a hand that was lifted from 2D; only methods that fit
    all frames together do."""
    hands: Annotated[Hands, switch("as-given"), arg(name="given-hands", help_behavior_hint="")] = "corrected"
    """Do not refine the hands (as-given). By default (corrected) they are aligned to the hand's pixels (masks/hand,
    else masks/ignore) where they disagree, and tracker glitches are repaired."""
    masks: Annotated[MaskUse, switch("as-given"), arg(name="given-masks", help_behavior_hint="")] = "checked"
    """Use all masks (as-given). By default (checked) soft-hinge and one-dof leave out outlier masks, those that
    contradict the masks of other frames."""
    mesh: Annotated[MeshUse, switch("as-given"), arg(name="given-mesh", help_behavior_hint="")] = "fitted"
    """Do not deform the mesh (as-given). By default (fitted) soft-hinge and one-dof deform it if the masks show that it
    is not the object's own."""
    interval: Annotated[IntervalUse, switch("as-given"), arg(name="given-interval", help_behavior_hint="")] = "firm"
    """Use all frames (as-given). By default (firm) soft-hinge and one-dof leave out the frames at the ends of a clip in
    which a hand that was lifted from 2D, as in a draft, does not hold the object firmly."""
    seed: Annotated[int, arg(metavar="S")] = 0
    """Seed of the initial rotations. The same seed gives the same result."""

    def __post_init__(self) -> None:
        check_values(self)
        if self.inits < 1:
            raise UsageError(f"inits must be 1 or more (got {self.inits})")
        if self.seed < 0:
            raise UsageError(f"seed must be 0 or more (got {self.seed})")
        if self.init == "uniform" and (self.priors is not None or self.priors_only):
            which = "--priors" if self.priors is not None else "--priors-only"
            raise UsageError(f"{which} cannot be used with --init uniform, only with --init clusters, priors or poses")
        if self.init != "uniform" and self.priors is None:
            raise UsageError(f"missing --priors: --init {self.init} needs a file or folder")
        if self.priors is not None and not self.priors.sha256:
            from getagrip.fitting.solver.initial_poses import priors_checksum

            checked = replace(self.priors, sha256=priors_checksum(self.priors.path, self.init))
            object.__setattr__(self, "priors", checked)


@explain_fields
@dataclass(frozen=True)
class Options(SearchOptions):
    """Options of a reconstruction. Raises ``UsageError`` for a value that is not allowed."""

    method: Annotated[str, arg(metavar="METHOD", help_behavior_hint=_methods)] = "soft-hinge"
    """How the object may move in the hand. soft-hinge: about one axis, with small deviations; one-dof: about one axis
    exactly; static: not at all; dynamic: freely in each frame. paper and paper-... are the paper's own methods by its
    energy and optimiser; they are slow. The others are baselines."""
    axis: Literal["free", "hand"] = "free"
    """Position of the latent axis of one-dof and soft-hinge: anywhere (free), or through the origin of the hand frame,
    as in the paper's Eq. 3 (hand)."""
    frames: Annotated[int, arg(metavar="N")] = 30
    """Fit N frames together, sampled evenly from the clip. More frames are slower, and safer if the motion is fast."""
    every_frame: Annotated[bool, FlagConversionOff, switch(False), arg(name="sampled-only", help_behavior_hint="")] = (
        True
    )
    """Return poses for these N frames only (every_frame=False). By default each other frame is then fitted to its own
    mask with the shared parameters fixed, or interpolated if its mask does not show the object."""
    push: Annotated[float, Suppress, Fixed] = 0.1
    """Weight of E_push, the paper's lambda_2 without the focal length."""
    pull: Annotated[float, Suppress, Fixed] = 0.1
    """Weight of E_pull, the paper's lambda_3 without the focal length."""
    occlusion: Annotated[bool, Suppress, Fixed] = True
    """Leave out pixels hidden by the hand (the paper's C_o)."""
    without: Annotated[tuple[BesideMasks, ...], Suppress, Fixed] = ()
    """Evidence beside the masks that is left out, for ablations: the mesh's texture, the free profile of a body of
    revolution, the handle in the fingers, the turns of a body of revolution by the motion of its surface."""
    departures: Annotated[Departures, Suppress, Fixed] = NO_DEPARTURE
    """Parts of the method ``paper`` that are replaced by ours; for ablations. Other methods do not use it."""

    @property
    def as_published(self) -> bool:
        """True if the method is left as its authors state it: nothing is done to its input."""
        return method_of(self.method).as_published

    def __post_init__(self) -> None:
        method_of(self.method)
        super().__post_init__()
        if self.departures != NO_DEPARTURE and self.method != "paper":
            raise UsageError(f"departures cannot be used with method {self.method!r}, only with 'paper'")
        for name in self.without:
            check_word("without", name, BesideMasks)
        if self.frames < 2:
            raise UsageError(f"frames must be 2 or more (got {self.frames})")
        if not (0 <= self.push < math.inf and 0 <= self.pull < math.inf):
            raise UsageError(f"push and pull must be finite and 0 or more (got {self.push} and {self.pull})")
