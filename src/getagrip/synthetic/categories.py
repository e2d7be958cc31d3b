"""The contents of synthetic clips: for each category the object and its grips.

Kitchen machines are assembled here, from closed parts that overlap: closed meshes of 500 to 1400 faces in metres, z up,
the front at +x, origins in the middle.

The clips of the ``synthetic`` benchmark: which categories, seeds and options its splits hold.

Each preset has the same motions and grasps (``wild`` has other shapes), observed with other hands and masks. The seeds
of train and test differ, and with them all that is drawn: a clip's random stream comes from its category and seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Literal, get_args

import numpy as np

from getagrip.errors import UsageError
from getagrip.geometry.mesh import Mesh
from getagrip.synthetic import objects
from getagrip.synthetic.grasp import Grip
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


@dataclass(frozen=True)
class ObjectKind:
    """A category: how to make the object, and the ways to take it."""

    make: Callable[[], Mesh]
    grips: tuple[Grip, ...]
    rarer: tuple[Grip, ...] = ()
    """Further ways, for clips whose grasps are to vary."""
    spread: float = 0.25
    """Standard deviation of the logarithm of its size, from one such object in a kitchen to another: a coarse guess."""
    stretch: float | None = None
    """Standard deviation of its stretches along x, y and z, if not that of any mesh (``fitting.stages.mesh_deformation``)."""
    bend: float | None = None
    """Standard deviation of its other deformations, if not that of any mesh: small where sides are flat."""
    opens_up: bool = False
    """True for a vessel or bottle, which is hardly ever held with its opening on the little finger's side."""


_ROUND_GRIP = Grip("palm", (0, 0, 0), (1, 0, 0), (0, 0, 1))
_ROUND_THUMB_DOWN_GRIP = Grip("palm", (0, 0, 0), (1, 0, 0), (0, 0, -1))
_BAR_GRIP = Grip("palm", (0, 0, 0), (0, 0.5, -1), (-1, 0, 0))
_BAR_FROM_BELOW_GRIP = Grip("palm", (0, 0, 0), (0, -0.6, 1), (-1, 0, 0))


def _rim_grip(radius: float, height: float) -> Grip:
    """By the rim of a vessel, the thumb inside."""
    return Grip("pinch", (radius, 0, height), (-0.25, 0, -1), (1, 0, 0))


SYNTHETIC_CATEGORIES: dict[str, ObjectKind] = {
    "bottle": ObjectKind(
        objects.bottle,
        (Grip("palm", (0, 0, -0.02), (1, 0, 0), (0, 0, 1)),),
        (Grip("palm", (0, 0, 0.06), (1, 0, 0), (0, 0, 1)), Grip("palm", (0, 0, 0.03), (1, 0, 0), (0, 0, -1))),
        spread=0.5,
        stretch=0.2,  # they are slim, squat or flat
        opens_up=True,
    ),
    "bowl": ObjectKind(objects.bowl, (Grip("pinch", (0.072, 0, 0.055), (-0.25, 0, -1), (1, 0, 0)),), opens_up=True),
    "can": ObjectKind(objects.can, (_ROUND_GRIP,), (_ROUND_THUMB_DOWN_GRIP,)),
    "cup": ObjectKind(
        objects.cup,
        (Grip("pinch", (0.058, 0, 0.042), (-1, 0, 0), (0, -1, 0)),),
        (Grip("pinch", (0, -0.042, 0.055), (0, 0.25, -1), (0, -1, 0)),),  # by the rim
        spread=0.15,
        opens_up=True,
    ),
    "glass": ObjectKind(
        objects.glass, (_ROUND_GRIP,), (_ROUND_THUMB_DOWN_GRIP, _rim_grip(0.036, 0.055)), opens_up=True
    ),
    "mug": ObjectKind(
        objects.mug,
        (
            Grip("palm", (0.077, 0, 0.05), (-1, 0, 0), (0, 0, 1)),  # by the handle
            Grip("palm", (0, 0, 0.05), (0.3, 1, 0), (0, 0, 1)),  # round the body, the handle beyond the fingers
        ),
        (Grip("pinch", (0, -0.039, 0.085), (0, 0.25, -1), (0, -1, 0)),),  # by the rim
        spread=0.15,
        opens_up=True,
    ),
    "pan": ObjectKind(objects.pan, (_BAR_GRIP,), (_BAR_FROM_BELOW_GRIP,), opens_up=True),
    "plate": ObjectKind(objects.plate, (Grip("pinch", (0.09, 0, 0.016), (-1, 0, 0), (0, 0, -1)),), spread=0.2),
    "saucepan": ObjectKind(objects.saucepan, (_BAR_GRIP,), (_BAR_FROM_BELOW_GRIP,), opens_up=True),
    "box": ObjectKind(
        objects.box,
        (Grip("palm", (0, -0.06, 0), (0, 1, 0), (0, 0, 1)),),
        (Grip("palm", (0, 0, 0.085), (0, 0, -1), (0, 1, 0)),),  # from above
        spread=0.5,
        bend=0.005,
    ),
    "capsule_machine": ObjectKind(capsule_machine, (Grip("palm", (-0.03, 0, 0), (1, 0, 0), (0, 0, 1)),)),
    "espresso_machine": ObjectKind(
        espresso_machine,
        (
            Grip("palm", (0.145, 0, 0.013), (0, 0.5, -1), (-1, 0, 0)),  # by the filter's handle
            Grip("palm", (-0.055, 0, -0.01), (1, 0, 0), (0, 0, 1)),  # by the column
        ),
    ),
    "kettle": ObjectKind(objects.kettle, (Grip("palm", (0.127, 0, 0.085), (-1, 0, 0), (0, 0, 1)),), opens_up=True),
    "ketchup": ObjectKind(objects.ketchup, (Grip("palm", (0, 0, 0.02), (1, 0, 0), (0, 0, 1)),)),
    "laptop": ObjectKind(
        objects.laptop, (Grip("pinch", (0.1, 0, 0), (-1, 0, 0), (0, 0, -1)),), spread=0.15, bend=0.005
    ),
    "microwave": ObjectKind(microwave, (Grip("palm", (0.151, 0.078, 0), (-1, -0.35, 0), (0, 0, 1)),)),
    "mixer": ObjectKind(mixer, (Grip("palm", (0, 0, 0.084), (0, 0.5, -1), (1, 0, 0)),)),
    "notebook": ObjectKind(notebook, (Grip("pinch", (0.055, 0, 0), (-1, 0, 0), (0, 0, -1)),)),
    "phone": ObjectKind(objects.phone, (Grip("palm", (0, -0.01, 0), (0, 0, 1), (0, 1, 0)),), spread=0.12, bend=0.005),
    "scissors": ObjectKind(objects.scissors, (Grip("pinch", (-0.095, 0, 0), (1, 0, 0), (0, 0, -1)),)),
    "spoon": ObjectKind(objects.spoon, (Grip("pinch", (-0.06, 0, 0.009), (1, 0, 0), (0, 0, -1)),)),
    "waffle_iron": ObjectKind(waffle_iron, (_BAR_GRIP,), (_BAR_FROM_BELOW_GRIP,)),
}
"""The nine categories of EPIC-Grasps, then those of ARCTIC and others."""

OBJECT_KINDS = SYNTHETIC_CATEGORIES | {
    "book": ObjectKind(objects.book, (Grip("pinch", (0.06, 0, 0), (-1, 0, 0), (0, 0, -1)),), spread=0.4, bend=0.005),
    "jar": ObjectKind(objects.jar, (_ROUND_GRIP,), spread=0.4, stretch=0.2),
    "pitcher": ObjectKind(objects.pitcher, (Grip("palm", (0.102, 0, 0.1), (-1, 0, 0), (0, 0, 1)),), opens_up=True),
}
"""The categories, and kinds of which no synthetic clips are made."""

SHAPE_MAKERS: dict[str, Callable[[], Mesh]] = {
    **{name: kind.make for name, kind in OBJECT_KINDS.items()},
    **{make.__name__: make for make in (objects.ball, objects.banana, objects.tape, objects.umbrella)},
}
"""All shapes that a clip can have by name: those of ``OBJECT_KINDS``, and others that have no usual grasp."""

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
