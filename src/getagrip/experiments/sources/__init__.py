"""Where the clips of a benchmark come from: a dataset of the table, or a folder of clips."""

from __future__ import annotations

from dataclasses import fields
from glob import has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Any

from getagrip.errors import InputError, UsageError
from getagrip.experiments.sources.dexycb import DexYcb, DexYcbSequences, DexYcbTimelines
from getagrip.experiments.sources.folder import ClipFolder
from getagrip.experiments.sources.hot3d import Hot3dTimelines
from getagrip.experiments.sources.source import ClipSource, Sample
from getagrip.experiments.sources.synthetic import Synthetic
from getagrip.io import files

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.share import Share

SOURCES: dict[str, type[ClipSource]] = {
    "synthetic": Synthetic,
    "dexycb": DexYcb,
    "dexycb-segments": DexYcbSequences,
    "dexycb-timelines": DexYcbTimelines,
    "hot3d-timelines": Hot3dTimelines,
}
"""The datasets, by the names that ``getagrip bench`` knows them by."""

__all__ = ["SOURCES", "ClipSource", "Sample", "names_in", "samples", "source_of"]


def source_of(dataset: str, **options: Any) -> ClipSource:
    """The source of a dataset's name, or of a folder of clips; an option of None is as if it were not given.

    Raises ``UsageError`` for an option that the source does not take, and as the source does.
    """
    kind = SOURCES.get(dataset, ClipFolder)
    if kind is ClipFolder and not Path(dataset).exists() and not has_magic(dataset):
        raise UsageError(f"DATASET: got {dataset}, expected {', '.join(SOURCES)}, or a folder of clips")
    taken = [field.name for field in fields(kind) if field.name != "dataset"]
    given = {name: value for name, value in options.items() if value is not None}
    for name, value in given.items():
        if name not in taken:
            takes = ", ".join(f"--{option}" for option in taken)
            raise UsageError(f"--{name}: got {value}, expected none: {dataset} takes {takes}")
    if "only" in given:
        if "split" in given:
            raise UsageError(f"--split: got {given['split']} and --only, expected one of them")
        given["split"] = "all"
    return kind(dataset, **given)


def names_in(path: Path) -> frozenset[str]:
    """The names of clips that a text file holds, one a line. Raises ``InputError``."""
    lines = files.read_bytes(path, files.LARGEST_JSON).decode("utf-8", "replace").splitlines()
    names = frozenset(filter(None, map(str.strip, lines)))
    bad = next((name for name in names if not files.is_plain_name(name)), None)
    if bad is not None or not names:
        given = "no names" if bad is None else f"the name {files.shown(bad)}"
        raise InputError(path, "", given, "names of clips, one a line")
    return names


def samples(
    source: ClipSource, clips: Path, count: int | None, debug: bool, share: Share | None = None
) -> tuple[list[Sample], list[Outcome]]:
    """The clips of a source, ``count`` of them evenly sampled, and what became of those that are none.

    ``clips`` is where a source may make them, shared out as ``share`` says.
    Raises ``UsageError`` for a count below 1, and as the source does.
    """
    import numpy as np

    from getagrip.batch.job import Outcome

    if count is not None and count < 1:
        raise UsageError(f"--clips: got {count}, expected 1 or more")
    found, failed = source.samples(clips, debug, share)
    if source.only is not None:
        missing = sorted(source.only - {sample.name for sample in found})
        failed += [Outcome(name, "failed", f"no such clip of {source.title}") for name in missing]
        found = [sample for sample in found if sample.name in source.only]
    if count is not None and count < len(found):
        found = [found[n] for n in np.linspace(0, len(found) - 1, count).round().astype(int)]
    return found, failed
