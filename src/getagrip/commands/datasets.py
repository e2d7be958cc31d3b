"""The datasets that ``getagrip import`` reads: a line for each.

The name is the subcommand's. The class stands with its reader: its fields are the subcommand's options.
"""

from __future__ import annotations

from getagrip.commands.import_epic import ImportEpic
from getagrip.datasets.arctic import Arctic
from getagrip.datasets.dataset import Dataset
from getagrip.datasets.dexycb.reader import DexYcb
from getagrip.datasets.ho3d import Ho3d
from getagrip.datasets.hoi4d import Hoi4d
from getagrip.datasets.hot3d.reader import Hot3d
from getagrip.datasets.track_files import Tracks

DATASETS: dict[str, type[Dataset]] = {
    "hot3d": Hot3d,
    "dexycb": DexYcb,
    "arctic": Arctic,
    "hoi4d": Hoi4d,
    "ho3d": Ho3d,
    "tracks": Tracks,
    "epic": ImportEpic,
}
