"""The list of a served page: clips, and results of one clip side by side, the worst first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from getagrip.clip import read_clip
from getagrip.errors import GetagripError
from getagrip.evaluation import read_with_clip
from getagrip.fitting.methods import label_of
from getagrip.io.files import Json
from getagrip.pictures.shown import View
from getagrip.pictures.stored_results import StoredResult, at_common_frames, distinct, hand_alone, true_view
from getagrip.result import Reconstruction, read_record, read_result

TRUTH, ALONE = "ground truth", "the hand alone: no result and no ground truth"


@dataclass(frozen=True, eq=False)
class Column:
    """A result or a clip, and what it is called; ``record`` is the content of its ``result.json``."""

    label: str
    view: View
    record: Json


@dataclass(frozen=True)
class Entry:
    """A line of the list.

    Attributes:
        label: what the list calls it.
        results: folders of the results of one clip; none where a clip itself is shown.
        clip: folder of the clip that is shown itself.
        clips: where the clips of results are; None: where the results say.
    """

    label: str
    results: tuple[Path, ...] = ()
    clip: Path | None = None
    clips: Path | None = None

    def read(self) -> list[Column]:
        """Read a column for each result, at the frames that all of them have, without masks. Raises ``InputError``."""
        if self.clip is not None:
            clip = read_clip(self.clip)
            return [
                Column(ALONE, hand_alone(clip), {}) if clip.truth is None else Column(TRUTH, true_view(self.clip), {})
            ]
        stored = [StoredResult(folder, self.clips) for folder in self.results]
        read = [(one, View.of(*read_with_clip(one.folder, one.clips), None)) for one in stored]
        views, names = at_common_frames(read), labels([view for _, view in read], distinct(stored))
        return [Column(*each) for each in zip(names, views, map(read_record, self.results), strict=True)]


def labels(views: Sequence[View], folders: Sequence[str]) -> list[str]:
    """Return the results' methods; where these agree, also the folders that tell the results apart."""
    named = [label_of(v.result.method) for v in views]
    return [
        label if named.count(label) == 1 else f"{label} ({folder})"
        for label, folder in zip(named, folders, strict=True)
    ]


def entries(
    results: Sequence[Path], clip_folders: Sequence[Path], clips: Path | None, fail: Callable[[Exception], None]
) -> list[Entry]:
    """Group results of the same clip and inputs: the serious ones first, then by mean IOU; clips follow.

    Those that cannot be read go to ``fail``.
    """
    groups: dict[tuple[str, str], list[tuple[Path, Reconstruction]]] = {}
    for folder in dict.fromkeys(path.resolve() for path in results):
        try:
            result, record = read_result(folder)
            groups.setdefault((result.clip, record["input_sha256"]), []).append((folder, result))
        except (GetagripError, OSError) as error:
            fail(error)
    ranked = sorted(groups.values(), key=lambda group: badness([result for _, result in group]))
    found = [Entry(_label(group), tuple(folder for folder, _ in group), clips=clips) for group in ranked]
    found += [Entry(folder.resolve().name, clip=folder) for folder in clip_folders]
    twice = {label for label, count in Counter(entry.label for entry in found).items() if count > 1}
    return [replace(e, label=f"{n + 1}. {e.label}") if e.label in twice else e for n, e in enumerate(found)]


def badness(results: Sequence[Reconstruction]) -> tuple[bool, float]:
    """Return a key that sorts the worst first: whether nothing serious is found, then the lowest mean IOU."""
    serious = any(finding.serious for result in results for finding in result.findings)
    return not serious, min(_iou(result) for result in results)


def _label(group: Sequence[tuple[Path, Reconstruction]]) -> str:
    results = [result for _, result in group]
    overlap = f"IOU {100 * min(_iou(result) for result in results):.0f} %"
    serious = {finding.check for result in results for finding in result.findings if finding.serious}
    several = [f"{len(group)} results"] if len(group) > 1 else []
    return ", ".join([results[0].clip, overlap, *several, *sorted(serious)])


def _iou(result: Reconstruction) -> float:
    return float(np.nan_to_num(result.mean_iou))
