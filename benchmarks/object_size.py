"""Would it help to know roughly how large an object is, where its size is free?

    python -m benchmarks.object_size OUT DEXYCB YCB

writes into docs/results-inputs.md, of DexYCB's training subjects and hands of ``moderate`` noise: how well the grip
tells an object's size, and how many clips are found where a term on the logarithm of the scale is added to the energy.
Its mean is the truth's own, which nobody knows as well, or 30 % more. Goes on where it was interrupted
(OUT/object-size.csv).
"""

from __future__ import annotations

import csv
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from benchmarks import page
from benchmarks.at_truth import share_off
from getagrip.clip import FINGERS, Clip, Masks, read_clip, read_masks
from getagrip.datasets.synthetic.noise import NOISE
from getagrip.experiments.changes import Noisy, ScaleFree
from getagrip.experiments.sources.dexycb import DexYcb
from getagrip.experiments.stamp import stamp
from getagrip.fitting.energy import PosesInCamera, Quadratic
from getagrip.fitting.methods.all_frames import soft_hinge
from getagrip.fitting.motion import placed
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare
from getagrip.geometry import se3
from getagrip.metrics.pose import SUCCESS, ObjectTrack

HANDS = Noisy(replace(NOISE["moderate"], mask_ragged_px=0.0))
EVERY = 2
"""Of the clips every so many."""
NAT = 1.0 / 0.03
"""Energy of a nat [px^2]: what it is where hands are corrected by their pixels."""


@dataclass(frozen=True)
class Size:
    """What is known of an object's size: how many times the true one it is taken to be, and the spread of that."""

    label: str
    factor: float = 1.0
    sd: float = np.inf
    """Of the scale's logarithm; 0: the size is known."""


SIZES = (
    Size("nothing"),
    Size("30 % too large, ± 25 %", 1.3, 0.25),
    Size("true, ± 25 %", sd=0.25),
    Size("true, ± 3 %", sd=0.03),
    Size("the size", sd=0.0),
)


@dataclass(frozen=True)
class SizeTerm:
    """``weight / 2 (log scale - mean)^2`` in each frame."""

    mean: float
    weight: float
    name: str = "size"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        out = Quadratic.zero(poses)
        off = (np.log(poses.scale) - self.mean)[:, None]
        out.value[:] = 0.5 * self.weight * off**2
        out.g[..., 6] = self.weight * off
        out.H[..., 6, 6] = self.weight
        return out


def found(clip: Clip, masks: Masks, size: Size) -> tuple[float, float]:
    """ADD up to symmetries as a share of the diameter, and the logarithm of found by true scale."""
    clip, masks = HANDS(*(clip, masks) if size.sd == 0.0 else ScaleFree()(clip, masks, 0), 0)
    problem = prepare(clip, masks, Options())
    clip = problem.clip
    assert clip.truth is not None
    term = SizeTerm(np.log(size.factor * clip.truth.scale), NAT / size.sd**2 / len(clip) if size.sd else 0.0)
    result = soft_hinge(problem, lambda _: None, lambda level, index: [term])
    got = ObjectTrack(placed(result.poses, clip.mesh.centre)[0], float(result.poses.scale[0]))
    true = ObjectTrack(se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj, clip.truth.scale)
    return share_off(clip.mesh, got, true), float(np.log(got.scale / true.scale))


def aperture(clip: Clip) -> float:
    """Mean distance of the thumb's pad from those of the fingers [m]."""
    hand = clip.hand
    thumb, *others = (hand.vertices[:, hand.regions[name]].mean(axis=(0, 1)) for name in FINGERS)
    return float(np.mean([np.linalg.norm(thumb - other) for other in others]))


def by_grip(clips: Sequence[Clip]) -> tuple[float, float]:
    """Spread of the logarithm of objects' diameters, and the error of predicting it from the grip's: root mean squares,
    each clip by a line through those of the other objects."""
    x, y = (np.log([of(clip) for clip in clips]) for of in (aperture, lambda clip: clip.mesh.diameter))
    names = np.array([clip.category for clip in clips])
    alone, told = [], []
    for name in {*names}:
        here = names == name
        alone.append(y[here] - y[~here].mean())
        told.append(y[here] - np.polyval(np.polyfit(x[~here], y[~here], 1), x[here]))
    return tuple(float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for e in (alone, told))  # type: ignore[return-value]


def main(out: Path, root: Path, meshes: Path) -> None:
    """Measure, and put it into the page."""
    samples = DexYcb(split="train", root=root, meshes=meshes).samples(out / "clips", False)[0][::EVERY]
    clips = [read_clip(sample.folder) for sample in samples]
    spread, told = by_grip(clips)
    file = out / "object-size.csv"
    done: dict[str, dict[str, tuple[float, float]]] = defaultdict(dict)
    if file.exists():
        for name, label, off, log_scale in csv.reader(file.open(encoding="utf-8")):
            done[label][name] = float(off), float(log_scale)
    for size in SIZES:
        for clip in clips:
            if clip.name not in done[size.label]:
                done[size.label][clip.name] = found(clip, read_masks(clip), size)
                with file.open("a", encoding="utf-8", newline="") as stream:
                    csv.writer(stream).writerow([clip.name, size.label, *done[size.label][clip.name]])
        print(size.label, np.mean([off < SUCCESS for off, _ in done[size.label].values()]), flush=True)
    rows = []
    for size in SIZES:
        off, log_scale = np.array([done[size.label][clip.name] for clip in clips]).T
        weight = "–" if not 0.0 < size.sd < np.inf else f"{NAT / size.sd**2:.0f}"
        error = "–" if size.sd == 0.0 else f"{100.0 * np.sqrt(np.mean(log_scale**2)):.1f}"
        rows.append([size.label, weight, f"{np.sum(off >= SUCCESS)} of {len(off)}", f"{np.median(off):.3f}", error])
    header = ["what is known", "weight, px²", "missed (ADD sym.)", "median ADD sym., diameters", "scale off by, %"]
    objects = len({clip.category for clip in clips})
    grip = (
        f"The diameters of these {objects} objects differ by {100 * spread:.0f} % (root mean square of logarithms, "
        f"from the mean of the others). Predicted from the distance of thumb and fingers in the {len(clips)} true "
        f"grasps, they are off by {100 * told:.0f} %."
    )
    page.write("object-size", f"*Made {stamp()}.*\n\n{page.table(header, rows)}\n\n{grip}")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
