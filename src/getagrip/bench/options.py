"""The comparison of methods that ``getagrip bench`` makes: its options, loaded for ``--help``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from tyro.conf import arg

from getagrip.batch.scheduling import KeepOptions
from getagrip.errors import unknown_choice_error
from getagrip.fitting.methods import METHODS
from getagrip.io.options import Flag

ABLATION_NAMES = (
    "physical", "occlusion", "axis", "inits", "hand-noise", "hand-refinement", "evidence", "wrong-evidence",
    "hand-flips", "true-hands", "mask-noise", "mask-gaps", "wrong-masks", "other-mesh", "scale", "sca", "inputs",
    "final", "final-evidence", "wrong-input", "pixels", "departures",
)  # fmt: skip
"""Names of ``bench.ablations.ABLATIONS``, which load the solver."""


def _methods_help(_: str) -> str:
    return f"(of {', '.join(METHODS)}; default: all of getagrip's but paper...)"


def _ablations_help(_: str) -> str:
    return f"(one of {', '.join(ABLATION_NAMES)}; default: none)"


@dataclass(frozen=True)
class ComparisonOptions:
    """Methods, or settings of methods, hands or other systems. Raises ``UsageError``."""

    methods: Annotated[tuple[str, ...], arg(metavar="METHOD...", help_behavior_hint=_methods_help)] = ()
    """Methods to compare. By default, ablations compare one-dof and soft-hinge, and the ablation departures compares
    the paper's. Methods of other packages, and the paper's, which are slow, run only if they are named."""
    ablation: Annotated[str | None, arg(metavar="NAME", help_behavior_hint=_ablations_help)] = None
    """Compare settings of each method, instead of the methods as they are."""
    hands: Annotated[tuple[str, ...], arg(metavar="NAME=DIR...", help_behavior_hint="")] = ()
    """Compare hands of several estimators for the same clips, on the frames that all have: DIR holds clips of the same
    names, or a hand file <clip>.npz for each (import hands --out)."""
    views: Annotated[tuple[int, ...], arg(metavar="N...", help_behavior_hint="(default: as the clips are)")] = ()
    """Compare numbers of views, 1 to 8: of further cameras around the grasp, rendered from the ground truth, with exact
    and estimated hands, and with masks that are off by 4 px."""
    others: Annotated[tuple[str, ...], arg(name="with", metavar="NAME=DIR...", help_behavior_hint="")] = ()
    """Add rows with other systems' results: DIR holds the poses of each clip under its name, as for evaluate --poses,
    or result folders."""
    contact: Annotated[
        tuple[float, ...],
        arg(metavar="MM...", help_behavior_hint="(default: 10; for clips that import made, the value that cut them)"),
    ] = ()
    """In SCA, SCA-ADD and SCA-IOU, points of the object within MM of the hand's surface are in contact; with several
    values, rows for each. The paper uses 0 on ARCTIC."""
    replay: Flag = False
    """Also simulate each result (getagrip replay): in what share of the frames the object stays in the hand."""
    columns: Annotated[
        tuple[Literal["paper", "motion", "recall"], ...],
        arg(help_behavior_hint="(default: paper; of ho3d-eval: recall)"),
    ] = ()
    """Columns of the tables. paper: its own; motion: ARCTIC's metrics; recall: areas under curves of ADD and ADD-S, and
    BOP's average recall."""
    refine: Flag = False
    """Add a row for each system of --with: our joint fit that starts from its poses, as of refine."""
    keep: Annotated[KeepOptions, arg(name="")] = field(default_factory=KeepOptions)

    def __post_init__(self) -> None:
        for name in self.methods:
            if name not in METHODS:
                raise unknown_choice_error("--methods", name, METHODS)
