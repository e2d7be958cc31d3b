"""The contents of synthetic clips: for each category the object and its grips.

Kitchen machines are assembled here, from closed parts that overlap: closed meshes of 500 to 1400 faces in metres, z up,
the front at +x, origins in the middle.

The clips of the ``synthetic`` benchmark: which categories, seeds and options its splits hold.

Each preset has the same motions and grasps (``wild`` has other shapes), observed with other hands and masks. The seeds
of train and test differ, and with them all that is drawn: a clip's random stream comes from its category and seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Literal, get_args

import numpy as np

from getagrip.errors import UsageError
from getagrip.geometry.mesh import Mesh
from getagrip.synthetic import objects
from getagrip.synthetic.noise import NOISE_PRESETS
from getagrip.synthetic.objects import (
    handle,
    loft,
    merge_closed_meshes,
    parse_profile,
    revolve_profile,
    slab,
    vessel_with_handle,
)
from getagrip.synthetic.scene_options import SceneOptions

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


def _rounded_block(
    low: tuple[float, float, float], high: tuple[float, float, float], power: float = 7.0, layers: int = 2
) -> Mesh:
    """Make a rounded block between two corners."""
    size = np.subtract(high, low)
    part = slab((float(size[0]), float(size[1]), float(size[2])), power, 0.004, 18, layers)
    return Mesh(part.vertices + (np.array(low) + high) / 2.0, part.faces)


def _bent_bar(points: Sequence[tuple[float, float]], n: int, width: float, height: float) -> Mesh:
    """Make a bent bar of elliptical section through (x, z) points, closed at both ends."""
    return loft(handle(points, n, width, height).sections(12))


def notebook(size: tuple[float, float, float] = (0.15, 0.21, 0.014)) -> Mesh:
    """Make a closed notebook."""
    return slab(size, 24.0, 0.001, 48, 2)


def waffle_iron(radius: float = 0.095, height: float = 0.08, bar: float = 0.12) -> Mesh:
    """Make a round, closed waffle iron with a straight handle; the origin lies on the handle."""
    low = parse_profile("0.35 0, 0.7 0, 0.93 0.02, 1 0.14, 1 0.3, 1 0.44, 0.97 0.48", radius, height)
    return vessel_with_handle([*low, *((r, height - z) for r, z in low[::-1])], radius, height, bar, 0.006)


def mixer(length: float = 0.19, width: float = 0.075, height: float = 0.075) -> Mesh:
    """Make a hand mixer: a body along x, a handle above it, two beaters below its front."""
    s = np.linspace(0.0, 1.0, 12)
    full = np.interp(s, [0.0, 0.05, 0.2, 0.8, 0.95, 1.0], [0.35, 0.75, 1.0, 1.0, 0.7, 0.3]) / 2.0
    phi = np.arange(24) * np.pi / 12.0
    section = np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    section = np.sign(section) * np.abs(section) ** 0.75
    x = np.broadcast_to((length * (s - 0.5))[:, None], (12, 24))
    rings = np.stack([x, *np.moveaxis(full[:, None, None] * section * [width, height], -1, 0)], axis=-1)
    bow = [(-0.36 * length, 0.46 * height), (-0.40 * length, 0.86 * height), (0.0, 1.12 * height)]
    bow += [(0.34 * length, 0.98 * height), (0.36 * length, 0.46 * height)]
    profile = parse_profile("0.12 0, 0.6 0.06, 1 0.25, 0.75 0.42, 0.2 0.5, 0.18 0.8, 0.18 1, 0.05 1", 0.019, 0.13)
    beater = loft(revolve_profile(profile, 10, 0.02))
    places = np.array([0.22 * length, 0.021, -0.13 - 0.3 * height]) * [[1.0, -1.0, 1.0], [1.0, 1.0, 1.0]]
    return merge_closed_meshes(
        [loft(rings, [handle(bow, 12, 0.014, 0.011)]), *(Mesh(beater.vertices + at, beater.faces) for at in places)]
    )


def espresso_machine(width: float = 0.105, height: float = 0.22) -> Mesh:
    """Make a small espresso machine: base, column and head, the filter's handle in front."""
    y, z = width / 2.0, height / 2.0
    base = _rounded_block((-0.085, -y, -z), (0.085, y, -z + 0.035))
    column = _rounded_block((-0.085, -0.8 * y, -z + 0.02), (-0.025, 0.8 * y, z - 0.03), layers=5)
    head = _rounded_block((-0.09, -y, z - 0.075), (0.07, y, z))
    filter_handle = _bent_bar(
        [(0.03, z - 0.085), (0.08, z - 0.088), (0.13, z - 0.095), (0.18, z - 0.10)], 9, 0.014, 0.013
    )
    return merge_closed_meshes([base, column, head, filter_handle])


def capsule_machine(width: float = 0.085, height: float = 0.20) -> Mesh:
    """Make a narrow capsule machine: tray, column and rounded head, a lever above."""
    y, z = width / 2.0, height / 2.0
    tray = _rounded_block((-0.06, -y, -z), (0.11, y, -z + 0.025))
    column = _rounded_block((-0.07, -0.85 * y, -z + 0.01), (0.01, 0.85 * y, z - 0.03), 5.0, 5)
    head = _rounded_block((-0.075, -0.8 * y, z - 0.07), (0.10, 0.8 * y, z), 4.0)
    lever = [(-0.05, z - 0.01), (-0.045, z + 0.018), (0.0, z + 0.024), (0.05, z + 0.018), (0.085, z + 0.012)]
    return merge_closed_meshes([tray, column, head, _bent_bar(lever, 10, 0.012, 0.005)])


def microwave(size: tuple[float, float, float] = (0.17, 0.26, 0.15)) -> Mesh:
    """Make a small microwave oven with a bow handle at the edge of its door."""
    depth, width, height = size
    x, z = depth / 2.0, height / 2.0
    body = slab(size, 12.0, 0.005, 40, 5)
    bow = [(x - 0.01, 0.8 * z), (x + 0.052, 0.76 * z), (x + 0.066, 0.0), (x + 0.052, -0.76 * z), (x - 0.01, -0.8 * z)]
    grip = _bent_bar(bow, 16, 0.010, 0.009)
    return merge_closed_meshes([body, Mesh(grip.vertices + np.array([0.0, 0.3 * width, 0.0]), grip.faces)])


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
    "capsule_machine": capsule_machine,
    "espresso_machine": espresso_machine,
    "kettle": objects.kettle,
    "ketchup": objects.ketchup,
    "laptop": objects.laptop,
    "microwave": microwave,
    "mixer": mixer,
    "notebook": notebook,
    "phone": objects.phone,
    "scissors": objects.scissors,
    "spoon": objects.spoon,
    "waffle_iron": waffle_iron,
}
"""Makers of the categories' meshes: the nine of EPIC-Grasps, then those of ARCTIC and others."""

SHAPE_MAKERS: dict[str, Callable[[], Mesh]] = {
    **SYNTHETIC_CATEGORIES,
    **{make.__name__: make for make in (objects.book, objects.jar, objects.pitcher)},
    **{make.__name__: make for make in (objects.ball, objects.banana, objects.tape, objects.umbrella)},
}
"""All shapes that a clip can have by name: the categories, three more with a usual grasp (``hands.grips``), and others without."""


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
