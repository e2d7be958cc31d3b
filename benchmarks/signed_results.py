"""Results with features and correctness, the data of ``benchmarks.probability``.

Clips of thirty real objects are reconstructed by the default method under ``CONDITIONS``:
each as it is and with hands at two levels of errors, and under one of the other conditions by turns.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.kept_rows import Row, described
from getagrip.batch.scheduling import SchedulingOptions
from getagrip.bench.inputs.perturbations import UNCHANGED, Noisy, OtherObject, OtherSize, ScaleFree, Several
from getagrip.bench.sources.recorded import DexYcb
from getagrip.clip import Clip, Masks, read_clip, read_masks
from getagrip.fitting.options import Options
from getagrip.reconstruct import reconstruct
from getagrip.synthetic.noise import NOISE_PRESETS, Noise

DEXYCB, OTHER, ARCTIC = "DexYCB", "DexYCB, the ten others", "ARCTIC"
"""Names of the datasets."""
PER_OBJECT = {DEXYCB: 12, OTHER: 12, ARCTIC: 5}
"""Maximum number of clips of an object, evenly spaced."""
Change = Callable[[Clip, Masks, int], tuple[Clip, Masks]]
TEN = Noisy(Noise(hand_bias_mm=10.0, hand_bias_deg=8.0, hand_jitter_mm=5.0, hand_jitter_deg=4.0, jitter_memory_s=0.1))
STRONG = Noisy(NOISE_PRESETS["strong"])


def unseen_hand(clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
    """Add the noise ``TEN``, and remove the hand pixels that could correct it."""
    clip, masks = TEN(clip, masks, seed)
    return clip, replace(masks, ignore=np.zeros_like(masks.ignore), hand=None)


ALWAYS: dict[str, Change] = {"as it is": UNCHANGED, "10 mm, 8°": TEN, "strong": STRONG}
"""Changes of every clip of ``PER_OBJECT``, by condition."""
BY_TURNS: dict[str, Change] = {
    "other size": OtherSize(),
    "moderate": Noisy(NOISE_PRESETS["moderate"]),
    "masks off by 4 px": Noisy(Noise(mask_ragged_px=4.0)),
    "other size, 10 mm, 8°": Several((OtherSize(), TEN)),
    "size unknown": ScaleFree(),
    "estimated": Noisy(NOISE_PRESETS["estimated"]),
    "other size, strong": Several((OtherSize(), STRONG)),
    "other shape": OtherObject(),
    "10 mm, 8°, no hand pixels": unseen_hand,
}
"""Other changes, of which each clip gets the next one."""
CONDITIONS = ALWAYS | BY_TURNS


@dataclass(frozen=True)
class Case:
    """A clip and its change."""

    dataset: str
    clip: str
    condition: str
    make: Callable[[], tuple[Clip, Masks]]

    @property
    def key(self) -> tuple[str, ...]:
        """Key of the row (``KEY``)."""
        return self.dataset, self.clip, self.condition


KEY = ("dataset", "clip", "condition")


def read_from(folder: Path, condition: str) -> tuple[Clip, Masks]:
    """Read a clip and its masks, and change them."""
    clip = read_clip(folder)
    return CONDITIONS[condition](clip, read_masks(clip), 0)


def cases(out: Path, root: Path, other: Path, meshes: Path, arctic: Path) -> list[Case]:
    """List all cases in random order, cases of ``ALWAYS`` first: an unfinished file is a sample of all cases.

    ``root`` and ``other`` are DexYCB's sequences, ``meshes`` its models, ``arctic`` a folder of clips.
    """
    folders = {ARCTIC: {file.parent.name: file.parent for file in sorted(arctic.glob("*/clip.json"))}}
    for dataset, of, name in ((DEXYCB, root, "clips"), (OTHER, other, "other")):
        found, _ = DexYcb(split="all", root=of, meshes=meshes).samples(out / name, False, SchedulingOptions(workers=1))
        folders[dataset] = {sample.name: sample.folder for sample in found}
    every = [*_cases(folders)]
    mixed = [every[n] for n in np.random.default_rng(0).permutation(len(every))]
    return sorted(mixed, key=lambda case: case.condition not in ALWAYS)


def _cases(folders: dict[str, dict[str, Path]]) -> Iterator[Case]:
    """Yield cases clip by clip, object by object."""
    turns = [*BY_TURNS]
    for dataset, clips in folders.items():
        by_object = defaultdict[str, list[str]](list)
        for name, folder in clips.items():
            by_object[read_clip(folder).category].append(name)
        for n, name in enumerate(name for names in by_object.values() for name in evenly(names, PER_OBJECT[dataset])):
            for condition in (*ALWAYS, turns[n % len(turns)]):
                yield Case(dataset, name, condition, partial(read_from, clips[name], condition))


def evenly(names: Sequence[str], most: int) -> list[str]:
    """Return at most that number of items, evenly spaced."""
    return [names[n] for n in np.unique(np.linspace(0, len(names) - 1, min(most, len(names))).round().astype(int))]


def row(case: Case) -> Row | None:
    """Reconstruct a case, and return its row; None on failure."""
    start = time.process_time()
    try:
        clip, masks = case.make()
        result = reconstruct(clip, masks, Options(every_frame=False))
    except Exception as error:  # an error in one clip must not end the others
        print(f"{case.key}: {error}", file=sys.stderr)
        return None
    about = {"category": clip.category, "seconds": time.process_time() - start}
    return dict(zip(KEY, case.key, strict=True)) | about | described(result, clip)
