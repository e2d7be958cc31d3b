"""The hand trackers whose files ``getagrip import hands --from <name>`` reads: a line for each.

The class stands with its reader: its fields are options of the command.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from keyword import iskeyword

from getagrip.errors import UsageError, unknown
from getagrip.hands.trackers.frankmocap import FrankMocap
from getagrip.hands.trackers.hamer import HaMeR
from getagrip.hands.trackers.hawor import HaWoR
from getagrip.hands.trackers.joints import Joints
from getagrip.hands.trackers.landmarks import Landmarks
from getagrip.hands.trackers.mano_parameters import ManoParameters
from getagrip.hands.trackers.tracker import Tracker
from getagrip.hands.trackers.wilor import WiLoR
from getagrip.io import plugins
from getagrip.io.plugins import Table

_TRACKERS: dict[str, Tracker] = {
    "hamer": HaMeR(),
    "wilor": WiLoR(),
    "hawor": HaWoR(),
    "frankmocap": FrankMocap(),
    "mano": ManoParameters(),
    "joints": Joints(),
    "landmarks": Landmarks(),
}


def _fits(name: str, it: object) -> bool:
    return isinstance(it, Tracker) and name.isidentifier() and not iskeyword(name)


TRACKERS = Table("trackers", _TRACKERS, "a Tracker, under a name that is a Python identifier", _fits)


def usable(taken: Iterable[str] = ()) -> dict[str, Tracker]:
    """Return all trackers that can be loaded, except those of other packages whose options are already ``taken``."""
    owners, there = dict.fromkeys(taken, "import hands"), dict[str, Tracker]()
    for name, tracker in TRACKERS.working().items():
        options = vars(tracker)
        if name not in _TRACKERS and (both := next((one for one in options if one in owners), None)):
            plugins.warn(f"{plugins.origin(tracker) or name} is left out: {owners[both]} has an option {both!r}, too")
            continue
        there[name] = tracker
        owners |= dict.fromkeys(options, f"the tracker {name}")
    return there


def choose(name: str, entry: Mapping[str, Tracker] = TRACKERS) -> Tracker:
    """Return the tracker of a name, with its options as ``given``.

    Raises ``UsageError`` for an unknown name, and for options that are given to another tracker.
    """
    if name not in entry:
        raise unknown("--from", name, entry)
    for other, tracker in entry.items():
        for option, value in vars(tracker).items():
            if other != name and value != vars(TRACKERS[other])[option]:
                dashed = option.replace("_", "-")
                raise UsageError(f"--{dashed} cannot be used with --from {name}: it belongs to --from {other}")
    return entry[name]
