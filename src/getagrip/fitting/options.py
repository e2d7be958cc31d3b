"""What a user may choose about a reconstruction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from getagrip.errors import UsageError
from getagrip.fitting.methods import METHODS

Init = Literal["uniform", "clusters", "priors"]


@dataclass(frozen=True)
class PriorsFile:
    """A file or folder of initial poses (``pose_priors.given``)."""

    path: Path
    sha256: str
    """What it held when it was named: results say which initial poses they had."""


@dataclass(frozen=True)
class Options:
    """How to reconstruct a clip."""

    method: str = "soft-hinge"
    """A name in ``methods.METHODS``: how the object may move in the hand, or a baseline."""
    inits: int = 50
    """Number of initial poses, their rotations spread uniformly; more is slower and safer, fewer than 50 is unsafe."""
    init: Init = "uniform"
    """Which initial poses come first: none but uniform rotations (uniform), those that ``init learn`` has learnt
    (clusters), or a folder of poses by category and side, as the paper's authors keep theirs (priors)."""
    priors: PriorsFile | None = None
    """The file or folder of ``init``."""
    thorough: bool = False
    """Search two to three times as long. Affects the methods that fit all frames at once."""
    seed: int = 0
    """Rotates the set of initial rotations; the same seed gives the same result."""
    frames: int = 30
    """Frames sampled linearly from the clip."""
    push: float = 0.1
    """Weight of E_push, the paper's lambda_2 without the focal length."""
    pull: float = 0.1
    """Weight of E_pull, the paper's lambda_3 without the focal length."""
    axis: Literal["free", "hand"] = "free"
    """Where a hinge's axis may lie: anywhere (free), or through the origin of the hand frame (hand)."""
    occlusion: bool = True
    """Leave out pixels hidden by the hand (the paper's C_o)."""

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise UsageError(f"method: got {self.method!r}, expected one of {', '.join(METHODS)}")
        if self.inits < 1 or self.frames < 2:
            raise UsageError(f"inits and frames: got {self.inits} and {self.frames}, expected at least 1 and 2")
        if (self.init == "uniform") != (self.priors is None):
            wanted = "none for uniform rotations" if self.init == "uniform" else f"a file or folder for {self.init}"
            raise UsageError(f"priors: got {self.priors and self.priors.path}, expected {wanted}")
        if self.seed < 0:
            raise UsageError(f"seed: got {self.seed}, expected 0 or more")
        if not (0 <= self.push < math.inf and 0 <= self.pull < math.inf):
            raise UsageError(f"push and pull: got {self.push} and {self.pull}, expected finite weights of 0 or more")
