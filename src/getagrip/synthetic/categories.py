"""The categories of synthetic clips, and the clips of the ``synthetic`` benchmark: its splits.

All presets have the same motions and grasps (``wild`` and ``measured`` have other shapes), with different hands and
masks. Clips of train and validation share nothing: a clip's random stream comes from its category and seed, and their
seeds differ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from getagrip.errors import UsageError
from getagrip.geometry.mesh import Mesh
from getagrip.synthetic import objects
from getagrip.synthetic.scene_options import SYNTHETIC_PRESETS, SceneOptions

Split = Literal["train", "validation"]
FORMER_PRESET_NAMES = {"hamer": "moderate", "frankmocap": "strong"}
"""Former names of presets."""
SPLIT_SEEDS: dict[Split, range] = {"train": range(100_000, 100_005), "validation": range(200_000, 200_009)}
"""Seeds of each category's clips."""
OTHER_HAND_FRACTION = 0.3
"""Fraction of clips in which the other hand comes in front."""


SYNTHETIC_CATEGORIES: dict[str, Callable[[], Mesh]] = {
    "bottle": objects.bottle,
    "bowl": objects.bowl,
    "can": objects.can,
    "cup": objects.cup,
    "glass": objects.glass,
    "mug": objects.mug,
    "pan": objects.pan,
    "plate": objects.plate,
    "saucepan": objects.saucepan,
    "box": objects.box,
    "capsule_machine": objects.capsule_machine,
    "espresso_machine": objects.espresso_machine,
    "kettle": objects.kettle,
    "ketchup": objects.ketchup,
    "laptop": objects.laptop,
    "microwave": objects.microwave,
    "mixer": objects.mixer,
    "notebook": objects.notebook,
    "phone": objects.phone,
    "scissors": objects.scissors,
    "spoon": objects.spoon,
    "waffle_iron": objects.waffle_iron,
}
"""Makers of the categories' meshes: the nine of EPIC-Grasps, then those of ARCTIC and others."""
SHAPE_MAKERS: dict[str, Callable[[], Mesh]] = {
    **SYNTHETIC_CATEGORIES,
    "book": objects.book,
    "jar": objects.jar,
    "pitcher": objects.pitcher,
    "ball": objects.ball,
    "banana": objects.banana,
    "tape": objects.tape,
    "umbrella": objects.umbrella,
    "french_press": objects.french_press,
    "jug": objects.jug,
    "spray_bottle": objects.spray_bottle,
    "watering_can": objects.watering_can,
    "hammer": objects.hammer,
    "knife": objects.knife,
    "remote": objects.remote,
    "screwdriver": objects.screwdriver,
}
"""All built-in shapes: the categories, three more with a usual grasp (``hands.grips``), four without, and eight with
one: vessels with a lever, a lid or a spout, and tools."""


def clips_of_split(name: Split, preset: str = "clean") -> list[tuple[str, int, SceneOptions]]:
    """List category, seed and options of every clip of a split, the arguments of ``synthesise``.

    Left and right hands alternate. Grips vary, and the object deviates from its axis by up to 4 degrees and 2 mm,
    except in ``measured``. Raises ``UsageError`` for an unknown split or preset.
    """
    if name not in SPLIT_SEEDS:
        raise UsageError(f"unknown split {name!r}; choose from {', '.join(get_args(Split))}")
    if preset in FORMER_PRESET_NAMES:
        now = FORMER_PRESET_NAMES[preset]
        raise UsageError(f"--preset: {preset!r} is now called {now!r}: its noise is no tracker's")
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
