"""A folder of clips."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.errors import UsageError
from getagrip.experiments.sources.source import ClipSource, Sample, Split

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome


@dataclass(frozen=True)
class ClipFolder(ClipSource):
    """A folder of clips, or a clip: ``dataset`` is its path. It has no splits."""

    split: Split = "all"

    def __post_init__(self) -> None:
        if self.split != "all":
            raise UsageError(f"--split: got {self.split} for a folder of clips, expected all")

    @property
    def title(self) -> str:
        return "a folder of clips"  # its path is private

    def samples(self, clips: Path, debug: bool) -> tuple[list[Sample], list[Outcome]]:
        from getagrip.batch.job import by_name

        found, failed = by_name([Path(self.dataset)])
        return [Sample(name, path) for name, path in sorted(found.items())], failed
