"""What a user may choose about a reconstruction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from getagrip.errors import UsageError

Method = Literal["one-dof", "soft-hinge", "static", "dynamic", "single-frame", "homan", "contact-consistency"]
Init = Literal["uniform", "clusters", "priors"]


@dataclass(frozen=True)
class PriorsFile:
    """A file or folder of starting poses (``priors.given``)."""

    path: Path
    sha256: str
    """What it held when it was named: results say which poses they started from."""


@dataclass(frozen=True)
class Options:
    """How to reconstruct a clip."""

    method: Method = "soft-hinge"
    """How the object may move in the hand: turn about one axis, as in the paper (one-dof); deviate from that a little
    in each frame (soft-hinge); not at all (static); freely (dynamic). Or as others do it: each frame on its own
    (single-frame); HOMan (homan); freely, but for distances to the hand that stay (contact-consistency)."""
    inits: int = 50
    """Starting rotations, spread evenly over all rotations; 50 is about the least, 100 is safe."""
    init: Init = "uniform"
    """Whether rotations spread evenly are all the starts (uniform), or come after the poses in ``priors``: those that
    ``init learn`` has found (clusters), or a folder of poses by category and side, as the authors keep theirs
    (priors)."""
    priors: PriorsFile | None = None
    """Where the poses of ``init`` are."""
    thorough: bool = False
    """Search two to three times as long. For the methods that fit all frames at once; no other changes by it."""
    seed: int = 0
    """Turns the set of starting rotations; the same seed gives the same result."""
    frames: int = 30
    """Frames sampled linearly from the clip."""
    push: float = 0.1
    """Weight of E_push, the paper's lambda_2 without the focal length."""
    pull: float = 0.1
    """Weight of E_pull, the paper's lambda_3 without the focal length."""
    axis: Literal["free", "hand"] = "free"
    """Where the axis of one-dof lies: anywhere (free), or through the origin of the hand frame (hand)."""
    occlusion: bool = True
    """Leave out pixels hidden by the hand (the paper's C_o)."""

    def __post_init__(self) -> None:
        if self.inits < 1 or self.frames < 2:
            raise UsageError(f"inits and frames: got {self.inits} and {self.frames}, expected at least 1 and 2")
        if (self.init == "uniform") != (self.priors is None):
            wanted = "none for uniform rotations" if self.init == "uniform" else f"a file or folder for {self.init}"
            raise UsageError(f"priors: got {self.priors and self.priors.path}, expected {wanted}")
        if self.seed < 0:
            raise UsageError(f"seed: got {self.seed}, expected 0 or more")
        if not (0 <= self.push < math.inf and 0 <= self.pull < math.inf):
            raise UsageError(f"push and pull: got {self.push} and {self.pull}, expected finite weights of 0 or more")
