"""Sources of a benchmark's clips: a file for each dataset, and one for folders of clips."""

from __future__ import annotations

from typing import TYPE_CHECKING

from getagrip.bench.sources.source import ClipSource, Sample, read_clip_names
from getagrip.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from getagrip.batch.job import Outcome
    from getagrip.batch.scheduling import SchedulingOptions

__all__ = ["ClipSource", "Sample", "read_clip_names", "sample_clips"]


def sample_clips(
    source: ClipSource, clips: Path, count: int | None, debug: bool, share: SchedulingOptions | None = None
) -> tuple[list[Sample], list[Outcome]]:
    """Return ``count`` clips of a source (None: all), and the outcomes of folders without a clip.

    They are sampled evenly or, of a source ``in_order``, the first.

    A source may make its clips in the folder ``clips``, scheduled by ``share``. Raises ``UsageError`` for a count
    below 1, and the source's errors.
    """
    import numpy as np

    from getagrip.batch.job import Outcome

    if count is not None and count < 1:
        raise UsageError(f"--clips must be 1 or more (got {count})")
    found, failed = source.samples(clips, debug, share)
    if source.only is not None:
        missing = sorted(source.only - {sample.name for sample in found})
        failed += [Outcome(name, "failed", f"no such clip of {source.title}") for name in missing]
        found = [sample for sample in found if sample.name in source.only]
    if count is not None and count < len(found):
        evenly = np.linspace(0, len(found) - 1, count).round().astype(int)
        found = found[:count] if source.in_order else [found[n] for n in evenly]
    return found, failed
