"""The clips of the ``synthetic`` benchmark: which categories, seeds and options its splits hold.

Each preset has the same motions and grasps (``wild`` has other shapes), observed with other hands and masks. The seeds
of train and test differ, and with them all that is drawn: a clip's random stream comes from its category and seed.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Literal, get_args

import numpy as np

from getagrip.datasets.synthetic.categories import SYNTHETIC_CATEGORIES
from getagrip.datasets.synthetic.noise import NOISE_PRESETS
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.errors import UsageError

Split = Literal["train", "validation"]

SYNTHETIC_PRESETS: dict[str, SceneOptions] = {
    "clean": SceneOptions(),
    "moderate": SceneOptions(**asdict(NOISE_PRESETS["moderate"])),
    "strong": SceneOptions(**asdict(NOISE_PRESETS["strong"])),
    "estimated": SceneOptions(**asdict(NOISE_PRESETS["estimated"])),
    "wild": SceneOptions(**asdict(NOISE_PRESETS["moderate"]), cad="mean", vary=0.15, scale="free"),
    "measured": SceneOptions(
        **asdict(NOISE_PRESETS["moderate"]), cad="mean", vary=0.15, deform=0.03, scale="free", motion="measured"
    ),
}
"""Levels of knowledge: everything; noisy hands and masks; and, as in the wild, only the mean shape, without its
size."""
FORMER_PRESET_NAMES = {"hamer": "moderate", "frankmocap": "strong"}
"""Former names of presets."""
SPLIT_SEEDS: dict[Split, range] = {"train": range(100_000, 100_005), "validation": range(200_000, 200_009)}
"""Seeds of each category's clips."""
OTHER_HAND_FRACTION = 0.3
"""Share of clips in which the other hand comes in front."""


def clips_of_split(name: Split, preset: str = "clean") -> list[tuple[str, int, SceneOptions]]:
    """List category, seed and options of every clip of a split, as ``synthesise`` takes them.

    Left and right hands alternate. Grips vary, and the object departs from its axis by up to 4 degrees and 2 mm, except
    in ``measured``.
    Raises ``UsageError`` for an unknown split or preset.
    """
    if name not in SPLIT_SEEDS:
        raise UsageError(f"unknown split {name!r}; choose from {', '.join(get_args(Split))}")
    if preset in FORMER_PRESET_NAMES:
        raise UsageError(
            f"--preset: {preset!r} is now called {FORMER_PRESET_NAMES[preset]!r}: its noise is no tracker's"
        )
    if preset not in SYNTHETIC_PRESETS:
        raise UsageError(f"unknown --preset {preset!r}; choose from {', '.join(SYNTHETIC_PRESETS)}")
    rng = np.random.default_rng(list(f"synthetic {name}".encode()))
    clips = []
    for c, category in enumerate(SYNTHETIC_CATEGORIES):
        for seed in SPLIT_SEEDS[name]:
            options = replace(
                SYNTHETIC_PRESETS[preset],
                side="left" if (c + seed) % 2 else "right",
                other_hand=bool(rng.random() < OTHER_HAND_FRACTION),
                grip_deg=12.0,
                turn_deg=(5.0, 60.0),
                residual_deg=float(rng.uniform(0.5, 4.0)),
                residual_mm=float(rng.uniform(0.5, 2.0)),
            )
            clips.append((category, seed, options))
    return clips
