"""``getagrip import``: the table of datasets, a subcommand each, and the imports into existing clips.

The fields of a dataset's class, which is in the module of its reader, are the subcommand's options. The readers load
numpy and more: this module is loaded for the command only, not for ``getagrip --help``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Annotated, Generic, TypeVar, Union

from tyro.conf import arg, subcommand

from getagrip.batch.import_dataset import import_clips
from getagrip.batch.scheduling import Executors, SchedulingOptions
from getagrip.cli.command import Command
from getagrip.cli.import_files import ImportCameras, ImportDepth, ImportMasks, ImportSegments
from getagrip.io.options import Folder, OptionalFolder
from getagrip.io.plugins import PluginTable
from getagrip.io.terminal import print_note
from getagrip.readers.datasets.arctic import Arctic
from getagrip.readers.datasets.dataset import Dataset, Note, Part
from getagrip.readers.datasets.dexycb.dexycb_clips import DexYcb
from getagrip.readers.datasets.epic.epic_grasps import EpicGrasps
from getagrip.readers.datasets.ho3d import Ho3d
from getagrip.readers.datasets.hocap import HoCap
from getagrip.readers.datasets.hoi4d import Hoi4d
from getagrip.readers.datasets.hot3d.hot3d_clips import Hot3d
from getagrip.readers.datasets.hrdexdb import HrDexDb
from getagrip.readers.datasets.track_files import Tracks


@dataclass(frozen=True, kw_only=True)
class ImportEpic(EpicGrasps):
    """EPIC-Grasps: its stable grasps in EPIC-KITCHENS, with VISOR's masks; hands come from an estimator's files."""

    priors: OptionalFolder = None
    """Initial poses of reconstruct --init priors, by category and hand: they are only checked."""

    def parts(self, note: Note) -> Sequence[Part]:
        """List the videos, and report whether and how the priors will be used. Raises ``InputError``."""
        parts = super().parts(note)
        if self.priors is not None:
            self._report(self.priors)
        return parts

    def _report(self, folder: Path) -> None:
        from getagrip.fitting.solver import initial_poses  # loads numba

        learnt = initial_poses.read_priors_folder(folder)
        kinds = sorted({(grasp.category, grasp.side) for grasp in self.grasps()})
        without = [f"{category} in a {side} hand" for category, side in kinds if not len(learnt.of(category, side))]
        print(f"to start from the poses of {folder}: getagrip reconstruct ... --init priors --priors {folder}")
        if without:
            print_note(f"{folder} has no poses of {', '.join(without)}")
        if self.cad is None:
            print_note("poses belong to the meshes they were made with: bring these with --cad")


_BUILTIN_DATASETS: dict[str, type[Dataset]] = {
    "hot3d": Hot3d, "dexycb": DexYcb, "arctic": Arctic, "hoi4d": Hoi4d, "ho3d": Ho3d, "hocap": HoCap,
    "hrdexdb": HrDexDb, "tracks": Tracks, "epic": ImportEpic,
}  # fmt: skip
NON_DATASET_IMPORTS = ("hands", "masks", "depth", "cameras", "segments")
"""Imports into existing clips."""


def _is_dataset(_: str, it: object) -> bool:
    return isinstance(it, type) and issubclass(it, Dataset) and is_dataclass(it)


DATASETS = PluginTable(
    "datasets", _BUILTIN_DATASETS, "a dataclass that subclasses Dataset", _is_dataset, NON_DATASET_IMPORTS
)

D = TypeVar("D", bound=Dataset)


@dataclass(frozen=True, kw_only=True)
class Import(Command, Generic[D]):
    """Make clips of a dataset."""

    dataset: Annotated[D, arg(name="")]
    out: Folder
    """Folder of the clips, one folder each. Existing clips are kept, unless they lack hands found now."""
    share: Executors = field(default_factory=SchedulingOptions)

    def run(self) -> int:
        return import_clips(self.dataset, self.out, self.debug, self.share)


def _dataset_summary(dataset: type[Dataset]) -> str:
    return (dataset.__doc__ or "").partition("\n\nAttributes:")[0]


def subcommands(name: str = "") -> object:
    """Return the subcommands of ``import``: the datasets, then the imports into existing clips.

    For a known ``name`` no other plug-in is loaded. Raises ``UsageError`` for a plug-in that cannot be loaded.
    """
    datasets = {name: DATASETS[name]} if name in DATASETS else {} if name in NON_DATASET_IMPORTS else DATASETS.working()
    kinds = [
        Annotated[Import[dataset], subcommand(name, description=_dataset_summary(dataset))]  # type: ignore[valid-type]
        for name, dataset in datasets.items()
    ]
    if name == "hands" or name not in (*DATASETS, *NON_DATASET_IMPORTS):
        from getagrip.cli.import_hands import ImportHands  # the options of all trackers are in it

        kinds.append(Annotated[ImportHands, subcommand("hands")])
    into_clips = {"masks": ImportMasks, "depth": ImportDepth, "cameras": ImportCameras, "segments": ImportSegments}
    return Union[*kinds, *(Annotated[command, subcommand(name)] for name, command in into_clips.items())]
