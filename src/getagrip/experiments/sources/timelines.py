"""Recordings whose clips are timelines; noise of hands is added when a clip is read."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

from getagrip.errors import UsageError
from getagrip.experiments.sources.recorded import Recorded


@dataclass(frozen=True)
class Timelines(Recorded):
    """A dataset's timelines with their true segments."""

    preset: str = "all"
    """Level of noise, of ``timeline_trials.LEVELS``: the clips are without."""

    def __post_init__(self) -> None:
        from getagrip.experiments.timeline_trials import ALL, LEVELS

        self.check((ALL, *LEVELS))

    def check(self, presets: Collection[str]) -> None:
        """Raise ``UsageError`` for a preset that is none of these."""
        if self.preset not in presets:
            raise UsageError(f"--preset: got {self.preset!r}, expected one of {', '.join(presets)}")

    def claim(self, clips: Path) -> None:
        super(Timelines, replace(self, preset=type(self).preset)).claim(clips)
