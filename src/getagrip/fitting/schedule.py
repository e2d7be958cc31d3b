"""The stages of a search, from coarse to fine: how many frames and pixels, how many hypotheses, how long."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Rotations:
    """Rotations of the object that lead from one local minimum to another, from and to how many degrees.

    Attributes:
        random: smallest and largest rotation about a random axis [degrees].
        principal: rotations about each of the three principal axes, either way [degrees].
    """

    random: tuple[float, float]
    principal: tuple[float, float]


GLOBAL_ROTATIONS = Rotations(random=(10.0, 40.0), principal=(180.0, 180.0))
"""To other poses; half a turn about a principal axis shows nearly the same silhouette."""
LOCAL_ROTATIONS = Rotations(random=(5.0, 20.0), principal=(8.0, 25.0))
"""Out of a minimum beside the best."""

ALL_FRAMES = 10**9
"""Number that stands for all frames."""


@dataclass(frozen=True)
class Stage:
    """One resolution: how many frames, which level, how long, and how many hypotheses go on to the next.

    Attributes:
        name: name, as in progress reports.
        level: side of the masks [px]: 64, 128 or 256.
        frames: largest number of frames that are used.
        iterations: most iterations of the solver.
        keep: number of hypotheses that the next stage takes over.
        within: how many times the least energy these may have. After the coarse stage the right one may still have many
            times as much (docs/method.md).
        rounds: how often the best hypotheses of the stage are rotated and fitted again.
        parents: number of hypotheses that are rotated.
        rotations: rotations of each of them.
        half_turns: the best hypothesis is fitted turned by half a turn too, where that nearly leaves the surface as it
            is (``ObjectSurface.half_turns``); both are kept where their energies are alike. Coarser stages do not tell
            the two apart.
    """

    name: str
    level: int
    frames: int
    iterations: int
    keep: int
    rounds: int = 0
    parents: int = 8
    rotations: Rotations = GLOBAL_ROTATIONS
    within: float = np.inf
    half_turns: bool = False


@dataclass(frozen=True)
class Schedule:
    """The whole search.

    Attributes:
        static_iterations: iterations of the first fit, with one pose for all frames.
        relaxed_iterations: iterations of the second fit, in which each frame may deviate from that pose.
        relaxed: number of hypotheses that go on from there.
        coarse: stages that see some of the frames. The first two fits are made at the first one's frames and level.
        fine: stages that see all frames.
    """

    static_iterations: int = 6
    relaxed_iterations: int = 3
    relaxed: int = 30
    coarse: tuple[Stage, ...] = (
        Stage("coarse", level=64, frames=8, iterations=5, keep=16, rounds=3),
        Stage(
            "middle",
            level=64,
            frames=15,
            iterations=6,
            keep=6,
            rounds=1,
            parents=6,
            rotations=LOCAL_ROTATIONS,
            within=4.0,
        ),
    )
    fine: tuple[Stage, ...] = (
        Stage("fine", level=128, frames=ALL_FRAMES, iterations=8, keep=4, within=2.5),
        Stage("finest", level=256, frames=ALL_FRAMES, iterations=8, keep=4, half_turns=True),
    )


DEFAULT_SCHEDULE = Schedule()
THOROUGH_SCHEDULE = Schedule(
    relaxed=ALL_FRAMES,
    coarse=(
        Stage("coarse", level=64, frames=8, iterations=5, keep=32, rounds=8, parents=12),
        Stage("middle", level=64, frames=15, iterations=8, keep=12, rounds=2, parents=8, rotations=LOCAL_ROTATIONS),
    ),
    fine=(
        Stage("fine", level=128, frames=ALL_FRAMES, iterations=12, keep=6, rounds=2, parents=3),
        Stage("finest", level=256, frames=ALL_FRAMES, iterations=16, keep=4, half_turns=True),
    ),
)
"""A longer search: more hypotheses go on, and further, and are rotated once more with all frames in view."""
