"""Synthetic clips, each made when it is first used."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import arg

from getagrip.bench.sources.source import ClipSource, Sample

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.scheduling import SchedulingOptions
    from getagrip.synthetic.scene_options import SceneOptions


@dataclass(frozen=True, kw_only=True)
class SyntheticSource(ClipSource):
    """Synthetic clips, made when they are first used."""

    dataset: ClassVar[str] = "synthetic"

    preset: Annotated[str, arg(metavar="NAME")] = "clean"
    """Changes of the input. clean: nothing; moderate, strong or estimated: noise of hands and masks; wild: moderate
    noise, and a mean shape of unknown scale; measured: that, and deformed, with motion as measured."""

    @property
    def description(self) -> str:
        return f"{self.dataset}, {self.preset}"

    def samples(
        self, clips: Path, debug: bool, share: SchedulingOptions | None = None
    ) -> tuple[list[Sample], list[Outcome]]:
        from getagrip.synthetic.categories import SPLIT_SEEDS, clips_of_split
        from getagrip.synthetic.scene import clip_name

        found = []
        for part in SPLIT_SEEDS if self.part == "all" else (self.part,):
            for category, seed, options in clips_of_split(part, self.preset):
                name = clip_name(category, seed, options)
                found.append(Sample(name, clips / name, partial(_make_synthetic_clip, category, seed, options)))
        self.claim(clips)
        return found, []


def _make_synthetic_clip(category: str, seed: int, options: SceneOptions, folder: Path) -> None:
    from getagrip.clip import write_clip
    from getagrip.synthetic.scene import synthesise

    write_clip(*synthesise(category, seed, options), folder)
