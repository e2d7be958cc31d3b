"""Rendered videos, each made when its draft is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import arg

from getagrip.bench.sources.source import ClipSource, Sample
from getagrip.errors import UsageError
from getagrip.io.options import OptionalFolder

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.scheduling import SchedulingOptions
    from getagrip.synthetic.filmed import FilmedClip

ORACLE_NAMES = (
    "masks", "first-mask", "interval", "hands", "hand-size", "depth", "mesh", "mesh+depth", "masks+mesh",
    "masks+hands", "masks+hands+mesh",
)  # fmt: skip
"""Names of ``bench.pixels.video_draft.ORACLES``, which load the solver."""


@dataclass(frozen=True, kw_only=True)
class RenderedVideos(ClipSource):
    """Draft rendered videos of people with objects, whose truth begins at the pixels: the error of each stage."""

    dataset: ClassVar[str] = "video"
    in_order: ClassVar[bool] = True

    meshes: OptionalFolder = None
    """Folder of textured .obj scans, which are filmed beside the built-in kinds; subfolders count."""
    models: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of the hand models (default: the cache; getagrip doctor --fetch hands). Without them, landmarks are
    simulated by their errors on real images, and the tables say so."""

    def filmed(self) -> list[FilmedClip]:
        """List what the videos show, in order. Raises ``UsageError`` for a folder without scans."""
        from getagrip.synthetic.filmed import filmed_clips

        scans = [] if self.meshes is None else sorted(self.meshes.rglob("*.obj"))
        if self.meshes is not None and not scans:
            raise UsageError(f"--meshes {self.meshes}: no .obj file in it")
        parts = [filmed_clips(part, scans) for part in ("train", "validation") if self.part in (part, "all")]
        places = [(n / len(part), clip) for part in parts for n, clip in enumerate(part)]
        return [clip for _, clip in sorted(places, key=lambda place: place[0])]

    def samples(
        self, clips: Path, debug: bool, share: SchedulingOptions | None = None
    ) -> tuple[list[Sample], list[Outcome]]:
        found = [Sample(clip.name, clips / clip.name) for clip in self.filmed()]
        self.claim(clips)
        return found, []
