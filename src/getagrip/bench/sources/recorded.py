"""Datasets of recordings, imported on demand and split by subjects: grasps, timelines, uncut sequences."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import arg

from getagrip.bench.sources.source import ClipSource, Sample
from getagrip.errors import GetagripError, UsageError, unknown_choice_error
from getagrip.io import files
from getagrip.io.options import OptionalFolder
from getagrip.io.terminal import print_note

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.scheduling import SchedulingOptions
    from getagrip.readers.datasets.dataset import Dataset

Preset = Annotated[str, arg(metavar="NAME")]


@dataclass(frozen=True, kw_only=True)
class RecordedSource(ClipSource):
    """A dataset's grasps; all clips of a subject belong to one split."""

    root: OptionalFolder = None
    """The dataset's folder, as for import."""

    def reader(self, root: Path) -> Dataset:
        """Return the dataset to import."""
        raise NotImplementedError

    def training(self, subjects: Collection[str]) -> Collection[str]:
        """Return the subjects of the training split: by default every third, starting with the first."""
        return sorted(subjects)[::3]

    def samples(
        self, clips: Path, debug: bool, share: SchedulingOptions | None = None
    ) -> tuple[list[Sample], list[Outcome]]:
        from getagrip.batch.clips import clips_by_name
        from getagrip.batch.import_dataset import import_clips
        from getagrip.batch.scheduling import DEFAULT_SCHEDULING, WHOLE_SHARD
        from getagrip.readers.datasets.tracks import subject_from_clip_name

        if self.root is None:
            raise UsageError(f"missing --root: the folder of {self.dataset}")
        self.claim(clips)
        done = clips / "imported"
        missing = self.only is None or any(not (clips / name).exists() for name in self.only)
        if not done.exists() and missing:
            if self.only is None:
                # Which clips there are, of which --clips takes some, is known once masks show where objects are seen.
                note = "all clips are imported first, and kept; --only FILE imports the clips that FILE names"
                print_note(f"{self.dataset}: {note}")
            share = share or DEFAULT_SCHEDULING
            # Every call needs all clips; their ledger is in their folder.
            whole = replace(share, shard=WHOLE_SHARD, ledger=None)
            status = import_clips(self.reader(self.root), clips, debug, whole, self.only)
            if status and share.fail_fast:
                raise GetagripError(f"{self.dataset}: not all clips could be imported, and --fail-fast ends the call")
            if status == 0 and self.only is None:
                files.write_bytes(done, b"")  # without it, the next call retries the clips that failed
        found, failed = clips_by_name([clips])
        subject = {name: subject_from_clip_name(name) for name in found}
        train = self.training({*subject.values()})
        splits = {name: ("all", "train" if subject[name] in train else "validation") for name in found}
        chosen = [name for name in sorted(found) if self.part in splits[name]]
        if found and not chosen:
            raise UsageError(f"--split {self.part} cannot be used with {self.dataset}: no clip of it is in that part")
        return [Sample(name, found[name]) for name in chosen], failed


@dataclass(frozen=True, kw_only=True)
class TimelineSource(RecordedSource):
    """A dataset's timelines with their true segments."""

    preset: Preset = "all"
    """Noise of hands: exact, moderate or strong; ragged: strong, and noise of masks; all: each of these."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.preset not in self.presets():
            raise unknown_choice_error("--preset", self.preset, self.presets())

    def presets(self) -> Collection[str]:
        """Return the values of ``preset``. The clips in the folder have no noise."""
        from getagrip.bench.sequences.timelines import ALL_NOISE_LEVELS, TIMELINE_NOISE_LEVELS

        return (ALL_NOISE_LEVELS, *TIMELINE_NOISE_LEVELS)

    def claim(self, clips: Path) -> None:
        super(TimelineSource, replace(self, preset=type(self).preset)).claim(clips)


@dataclass(frozen=True, kw_only=True)
class DexYcb(RecordedSource):
    """DexYCB's visible stable grasps."""

    dataset: ClassVar[str] = "dexycb"

    meshes: OptionalFolder = None
    """The folder of the YCB models, where they are not in --root."""

    def reader(self, root: Path) -> Dataset:
        from getagrip.readers.datasets.dexycb import dexycb_clips

        return dexycb_clips.DexYcb(root=root, meshes=self.meshes)


@dataclass(frozen=True, kw_only=True)
class DexYcbTimelines(TimelineSource, DexYcb):
    """DexYCB's uncut sequences, with their true segments."""

    dataset: ClassVar[str] = "dexycb-timelines"

    def reader(self, root: Path) -> Dataset:
        from getagrip.readers.datasets.dexycb import dexycb_clips

        return dexycb_clips.DexYcb(root=root, meshes=self.meshes, timelines=True)


@dataclass(frozen=True, kw_only=True)
class DexYcbSequences(DexYcbTimelines):
    """DexYCB's uncut sequences; grasps are found without 3D labels."""

    dataset: ClassVar[str] = "dexycb-segments"
    preset: Preset = "none"
    """Noise of hands and masks: none, moderate, strong or estimated."""

    def presets(self) -> Collection[str]:
        from getagrip.synthetic.noise import NOISE_PRESETS

        return NOISE_PRESETS


@dataclass(frozen=True, kw_only=True)
class Hot3dTimelines(TimelineSource):
    """HOT3D's timelines by the true poses; the head moves."""

    dataset: ClassVar[str] = "hot3d-timelines"

    def reader(self, root: Path) -> Dataset:
        from getagrip.readers.datasets.hot3d import hot3d_clips

        return hot3d_clips.Hot3d(root=root, timelines=True)
