"""HO-3D's evaluation split, as for RGB-D systems: whole sequences, with the dataset's or with estimated masks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from getagrip.bench.sources.recorded import RecordedSource
from getagrip.bench.sources.source import Sample
from getagrip.errors import UsageError
from getagrip.io.options import OptionalFolder

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.scheduling import SchedulingOptions
    from getagrip.bench.ablations import Ablation
    from getagrip.bench.tables import PublishedResults
    from getagrip.readers.datasets.dataset import Dataset


@dataclass(frozen=True, kw_only=True)
class Ho3dEval(RecordedSource):
    """HO-3D's evaluation split: AUC of ADD and ADD-S, and BOP's average recall, for each sequence."""

    dataset: ClassVar[str] = "ho3d-eval"
    every_frame: ClassVar[bool] = True

    meshes: OptionalFolder = None
    """The folder of the YCB models, where they are not in --root."""
    masks: OptionalFolder = None
    """Add rows with estimated masks: DIR/<sequence>/ of the object, and perhaps DIR/<sequence>_hand/."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.split not in (None, "all"):
            raise UsageError(f"--split {self.split} cannot be used with {self.dataset}, which is one split")

    @property
    def part(self) -> Literal["all"]:
        return "all"

    @property
    def columns(self) -> tuple[Literal["recall"], ...]:
        return ("recall",)

    @property
    def published(self) -> Mapping[str, PublishedResults]:
        from getagrip.bench.tables import read_published_results

        return read_published_results("ho3d_published.json")

    def part_of(self, clip: str, category: str) -> str:
        """Return the sequence of a clip, which has a table of its own."""
        return sequence_of(clip)

    def reader(self, root: Path) -> Dataset:
        from getagrip.readers.datasets.ho3d import Ho3dEvaluation

        return Ho3dEvaluation(root=root, meshes=self.meshes)

    @property
    def compared(self) -> Ablation:
        from getagrip.bench.ablations import Ablation, Setting
        from getagrip.bench.inputs.estimated_masks import WithMasks, without_depth

        masks = {"given masks": None} | ({} if self.masks is None else {"estimated masks": WithMasks(self.masks)})
        settings = [
            Setting(label + words, change=without_depth(change, depth))
            for label, change in masks.items()
            for words, depth in (("", True), (", no depth", False))
        ]
        return Ablation("HO-3D, evaluation split", "given masks", tuple(settings), ("soft-hinge",))

    def claim(self, clips: Path) -> None:
        super(Ho3dEval, replace(self, masks=None)).claim(clips)  # the clips do not depend on it

    def samples(
        self, clips: Path, debug: bool, share: SchedulingOptions | None = None
    ) -> tuple[list[Sample], list[Outcome]]:
        """Import the sequences, with depth images where they exist."""
        from getagrip.clip.depth import DEPTH_KEY
        from getagrip.clip.read import read_header
        from getagrip.readers.depth_files import DEPTH_FORMATS, add_depth, open_depth

        found, failed = super().samples(clips, debug, share)
        assert self.root is not None
        for sample in found:
            images = self.root / "evaluation" / sequence_of(sample.name) / DEPTH_KEY
            if images.is_dir() and not (sample.folder / DEPTH_KEY).exists():
                header = read_header(sample.folder)
                depth = open_depth(images, "ho3d", header.frames, "")
                add_depth(header, depth, DEPTH_FORMATS["ho3d"].source, "HO-3D's")
        return found, failed


def sequence_of(clip: str) -> str:
    """Return the sequence in a clip's name."""
    return clip.split("--")[1]
