"""Measure how objects move in the hand in stable grasps, for the synthetic clips of the preset ``measured``.

    getagrip import dexycb DEXYCB --meshes YCB --whole --out whole-dexycb
    python -m benchmarks.arctic_folders ARTIGRASP folders
    python scripts/convert/artigrasp.py folders/study tracks
    getagrip import tracks tracks --whole --out whole-arctic
    python -m benchmarks.motion measure dexycb=whole-dexycb arctic=whole-arctic
    python -m benchmarks.motion table

The first finds the stable grasps of the training subjects, contact within 10 mm, and writes numbers over all of them,
of no single one, to ``datasets/synthetic/measured_motion.json``. The second measures the motions of the synthetic test
split in the same way, and puts a table of both into docs/datasets.md.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from benchmarks import page
from getagrip.clip import Clip, read_clip
from getagrip.datasets.synthetic.in_hand import MEASURED, TABLE
from getagrip.experiments.stamp import stamp
from getagrip.geometry import se3
from getagrip.grasps.definition import Definition
from getagrip.grasps.lists import BETWEEN
from getagrip.grasps.motion import MOTION_MEASURES, QUANTILES, MotionStatistics, Residual, measure
from getagrip.grasps.stable import PairwiseIou, contact_sets, stable_grasps
from getagrip.grasps.study import object_in_hand

TRAINING = {
    "dexycb": ("20200709-subject-01", "20200903-subject-04", "20200928-subject-07", "20201022-subject-10"),
    "arctic": ("s1", "s4", "s7"),
}
"""Subjects on which no method is compared: of every three, sorted by name, the first (docs/results-protocol.md)."""
DEFINITION = Definition(contact=0.010)
SECTION = "in-hand-motion"
COMPARED = ("clean", "measured")
"""Presets whose motions stand in the table."""
EVERY = 4
"""Of the test split's clips every fourth stands in it."""
Measured = tuple[dict[str, float], Residual]


def motion(clip: Clip, contact: Bool[ndarray, "T V"]) -> Measured:
    """The motion of a clip that is one grasp, with the vertices that are in contact in each frame."""
    assert clip.truth is not None
    areas = clip.mesh.vertex_areas / clip.mesh.vertex_areas.sum()
    vertices = clip.truth.scale * clip.mesh.vertices
    T_hand_obj = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    touched = vertices[contact.mean(axis=0) >= 0.5]
    return measure(T_hand_obj, areas @ vertices, object_in_hand(clip)[2], touched, clip.fps)


def grasps(folder: Path, subjects: tuple[str, ...]) -> list[Measured]:
    """All stable grasps of some subjects in a folder of whole sequences."""
    found = []
    for path in sorted(path.parent for path in folder.glob("*/clip.json")):
        if path.name.split(BETWEEN)[0] in subjects:
            clip = read_clip(path)
            assert clip.truth is not None
            contact = contact_sets(clip, DEFINITION.contact)
            iou = PairwiseIou.of(contact, articulation=clip.truth.articulation)
            for first, last in stable_grasps(iou, DEFINITION.tau, DEFINITION.shortest, DEFINITION.rule):
                rows = np.arange(first, last + 1)
                found.append(motion(clip.take(rows), contact[rows]))
            print(f"{path.name}: {len(found)} grasps so far", flush=True)
    return found


def write(given: dict[str, Path]) -> None:
    """Write the statistics of each dataset into the table."""
    made = stamp()
    rows = {name: MotionStatistics.of(grasps(folder, TRAINING[name])) for name, folder in given.items()}
    content = {
        "made": f"{made}, contact within {1e3 * DEFINITION.contact:g} mm",
        "subjects": {name: TRAINING[name] for name in rows},
        "statistics": {name: vars(row) for name, row in rows.items()},
    }
    TABLE.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def synthetic(preset: str) -> MotionStatistics:
    """The motions of a preset's clips."""
    from getagrip.datasets.synthetic.scene import make_scene
    from getagrip.datasets.synthetic.splits import split

    found = []
    for category, seed, options in split("validation", preset)[::EVERY]:
        clip = make_scene(category, seed, replace(options, size=(64, 48), focal=60.0)).clip
        found.append(motion(clip, contact_sets(clip, DEFINITION.contact)))
    return MotionStatistics.of(found)


def table() -> None:
    """Put the measured and the drawn motions beside each other into the page."""
    columns = {f"{name}, {s.grasps} grasps": s for name, s in MEASURED.items()}
    for preset in COMPARED:
        drawn = synthetic(preset)
        columns[f"`{preset}`, {drawn.grasps} clips"] = drawn
    shown = [QUANTILES.index(q) for q in (10, 50, 90)]
    rows = []
    for name, what in MOTION_MEASURES.items():
        digits = 2 if what.unit == "s" else 1
        cells = [
            " / ".join(f"{what.factor * s.quantiles[name][k]:.{digits}f}" for k in shown) for s in columns.values()
        ]
        rows.append([what.label + (f" [{what.unit}]" if what.unit else ""), *cells])
    page.write(SECTION, f"*Made {stamp()}.*\n\n{page.table(['', *columns], rows)}")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["measure", *given] if given:
            write({name: Path(folder) for name, _, folder in (one.partition("=") for one in given)})
        case ["table"]:
            table()
        case _:
            sys.exit(__doc__)
