"""Recordings whose clips are timelines; noise of hands is added when a clip is read."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from getagrip.errors import unknown
from getagrip.experiments.sources.recorded import Recorded

Preset = Annotated[str, arg(metavar="NAME")]


@dataclass(frozen=True, kw_only=True)
class Timelines(Recorded):
    """A dataset's timelines with their true segments."""

    preset: Preset = "all"
    """Noise of hands: exact, moderate or strong; ragged: strong, and noise of masks; all: each of these."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.preset not in self.presets():
            raise unknown("--preset", self.preset, self.presets())

    def presets(self) -> Collection[str]:
        """Return the values of ``preset``: the clips are without noise."""
        from getagrip.experiments.timeline_trials import ALL, LEVELS

        return (ALL, *LEVELS)

    def claim(self, clips: Path) -> None:
        super(Timelines, replace(self, preset=type(self).preset)).claim(clips)
