"""Results with their signs, and whether they are right: what ``benchmarks.probability`` is fitted to and tested on.

Every clip is reconstructed by the default method under each of ``CONDITIONS``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.kept_rows import Row
from getagrip.clip import Clip, Masks, read_clip, read_masks
from getagrip.datasets.synthetic.noise import NOISE, Noise
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.splits import Split, split
from getagrip.evaluation import evaluate
from getagrip.evaluation.metric import ADD_SYM, ADD_SYM_CAM
from getagrip.experiments.changes import UNCHANGED, Noisy, OtherObject, ScaleFree
from getagrip.experiments.sources.recorded import DexYcb
from getagrip.fitting.options import Options
from getagrip.io.code import stamp
from getagrip.timelines.reconstruct import reconstruct

EVERY: dict[Split, tuple[int, int]] = {"train": (1, 3), "validation": (2, 5)}
"""Step from one clip that is used to the next: among DexYCB's, and among the synthetic ones of each preset."""
PRESETS = ("clean", "moderate", "strong", "estimated", "wild", "measured")
Change = Callable[[Clip, Masks, int], tuple[Clip, Masks]]
TEN = Noisy(Noise(hand_bias_mm=10.0, hand_bias_deg=8.0, hand_jitter_mm=5.0, hand_jitter_deg=4.0, jitter_memory_s=0.1))


def unseen_hand(clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
    """As far off as ``TEN``, and no pixels of the hand to mend it by."""
    clip, masks = TEN(clip, masks, seed)
    return clip, Masks(masks.object, np.zeros_like(masks.ignore))


CONDITIONS: dict[str, Change] = {
    "as it is": UNCHANGED,
    "moderate": Noisy(NOISE["moderate"]),
    "strong": Noisy(NOISE["strong"]),
    "estimated": Noisy(NOISE["estimated"]),
    "10 mm, 8°": TEN,
    "10 mm, 8°, no hand pixels": unseen_hand,
    "masks off by 4 px": Noisy(Noise(mask_ragged_px=4.0)),
    "size unknown": ScaleFree(),
    "other shape": OtherObject(),
}
"""What is done to the clips of DexYCB. Synthetic clips are as their preset has them."""


@dataclass(frozen=True)
class Case:
    """A clip, and what is to be done with it."""

    dataset: str
    part: Split
    clip: str
    condition: str
    make: Callable[[], tuple[Clip, Masks]]

    @property
    def key(self) -> tuple[str, ...]:
        """What its row is known by: ``KEY``."""
        return self.dataset, self.part, self.clip, self.condition


KEY = ("dataset", "part", "clip", "condition")


def read_from(folder: Path, condition: str) -> tuple[Clip, Masks]:
    """Read a clip and its masks, and change them."""
    clip = read_clip(folder)
    return CONDITIONS[condition](clip, read_masks(clip), 0)


def cases(clips: Path, root: Path, meshes: Path) -> list[Case]:
    """All clips in a random order: what there is of an interrupted run is a sample of everything."""
    found = list(_cases(clips, root, meshes))
    return [found[n] for n in np.random.default_rng(0).permutation(len(found))]


def _cases(clips: Path, root: Path, meshes: Path) -> Iterator[Case]:
    """Clip by clip."""
    for part, (every, every_synthetic) in EVERY.items():
        found = DexYcb(split=part, root=root, meshes=meshes).samples(clips, False)[0]
        for sample, name in product(found[::every], CONDITIONS):
            yield Case("DexYCB", part, sample.name, name, partial(read_from, sample.folder, name))
        for preset in PRESETS:
            for category, seed, options in split(part, preset)[::every_synthetic]:
                make = partial(synthesise, category, seed, options)
                yield Case("synthetic", part, f"{category}-{seed}", preset, make)


def row(case: Case) -> Row | None:
    """Reconstruct a clip: its signs, and where it is right; None where that fails."""
    start = time.process_time()
    try:
        clip, masks = case.make()
        result = reconstruct(clip, masks, Options(every_frame=False))
    except Exception as error:  # one clip's trouble must not end the others
        print(f"{case.key}: {error}", file=sys.stderr)
        return None
    seconds, metrics = time.process_time() - start, evaluate(result, clip, None, wanted=(ADD_SYM, ADD_SYM_CAM)).metrics
    right = {"hand": metrics[ADD_SYM.name] > 0.5, "camera": metrics[ADD_SYM_CAM.name] > 0.5}
    serious = any(finding.serious for finding in result.findings)
    return dict(zip(KEY, case.key, strict=True)) | {
        "right": right, "serious": serious, "seconds": seconds, "made": stamp(), "signs": result.signs,
    }  # fmt: skip
