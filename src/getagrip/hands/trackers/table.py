"""The hand trackers whose files ``getagrip import hands --from <name>`` reads: a line for each.

The class stands with its reader: its fields are options of the command.
"""

from __future__ import annotations

from collections.abc import Mapping

from getagrip.errors import UsageError
from getagrip.hands.trackers.frankmocap import FrankMocap
from getagrip.hands.trackers.hamer import HaMeR, WiLoR
from getagrip.hands.trackers.hawor import HaWoR
from getagrip.hands.trackers.joints import Joints
from getagrip.hands.trackers.mano_parameters import ManoParameters
from getagrip.hands.trackers.tracker import Tracker

TRACKERS: dict[str, Tracker] = {
    "hamer": HaMeR(),
    "wilor": WiLoR(),
    "hawor": HaWoR(),
    "frankmocap": FrankMocap(),
    "mano": ManoParameters(),
    "joints": Joints(),
}


def choose(name: str, entry: Mapping[str, Tracker] = TRACKERS) -> Tracker:
    """The tracker of a name, with its options as ``given``.

    Raises ``UsageError`` for an unknown name, and for options that are given to another tracker.
    """
    if name not in entry:
        raise UsageError(f"unknown --from {name!r}; choose from {', '.join(entry)}")
    for other, tracker in entry.items():
        for option, value in vars(tracker).items():
            if other != name and value != vars(TRACKERS[other])[option]:
                dashed = option.replace("_", "-")
                raise UsageError(f"--{dashed} cannot be used with --from {name}: it belongs to --from {other}")
    return entry[name]
