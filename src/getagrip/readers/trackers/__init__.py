"""Hands from trackers' files, as in a clip: ``read_tracked_hands(paths, tracker, request)``.

Every tracker's file becomes ``Estimates``: in each frame, MANO's parameters of a left or right hand before the clip's
camera, or joints, from which ``read_hands`` makes a surface. Each tracker is a ``Tracker`` in a file of its own and a
line in ``TRACKERS``; its fields are options of ``getagrip import hands``. Two conversions are common to most trackers:

- **The camera.** Most networks see a square crop, and give the hand's position in it by a scale and a shift (weak
  perspective). The position before the camera depends on the focal length (``WeakPerspective``); assumed focal
  lengths are reported as assumptions.
- **Left hands.** Most networks are trained on right hands, and see left hands mirrored: their rotations are those of
  the right hand in the mirrored image (``mirror_rotation``), and the surface is the right hand's mirror image.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from keyword import iskeyword

from getagrip.errors import UsageError, unknown_choice_error
from getagrip.io import plugins
from getagrip.io.plugins import PluginTable
from getagrip.readers.trackers.dynhamr import DynHaMR
from getagrip.readers.trackers.egodex import EgoDex
from getagrip.readers.trackers.egohandkit import EgoHandKit
from getagrip.readers.trackers.egovision import EgoVision
from getagrip.readers.trackers.estimates import Estimates, Request
from getagrip.readers.trackers.frankmocap import FrankMocap
from getagrip.readers.trackers.hamer import HaMeR, WiLoR
from getagrip.readers.trackers.hawor import HaWoR
from getagrip.readers.trackers.joints import Joints, Soma
from getagrip.readers.trackers.landmarks_2d import Landmarks
from getagrip.readers.trackers.lerobot_hands import LeRobot
from getagrip.readers.trackers.mano_parameters import ManoParameters
from getagrip.readers.trackers.read_hands import CHOSEN_HANDS_KEY, TrackedHands, read_tracked_hands
from getagrip.readers.trackers.records import recognise
from getagrip.readers.trackers.tracker import Tracker
from getagrip.readers.trackers.v2d import V2D

__all__ = [
    "CHOSEN_HANDS_KEY",
    "TRACKERS",
    "Estimates",
    "Request",
    "TrackedHands",
    "Tracker",
    "choose_tracker",
    "read_tracked_hands",
    "recognise",
    "usable",
]

_BUILTIN_TRACKERS: dict[str, Tracker] = {
    "hamer": HaMeR(),
    "wilor": WiLoR(),
    "hawor": HaWoR(),
    "frankmocap": FrankMocap(),
    "mano": ManoParameters(),
    "dynhamr": DynHaMR(),
    "egodex": EgoDex(),
    "egohandkit": EgoHandKit(),
    "egovision": EgoVision(),
    "v2d": V2D(),
    "lerobot": LeRobot(),
    "soma": Soma(),
    "joints": Joints(),
    "landmarks": Landmarks(),
}


def _is_tracker(name: str, it: object) -> bool:
    return isinstance(it, Tracker) and name.isidentifier() and not iskeyword(name)


TRACKERS = PluginTable("trackers", _BUILTIN_TRACKERS, "a Tracker, its name a Python identifier", _is_tracker)


def usable(taken: Iterable[str] = ()) -> dict[str, Tracker]:
    """Return all loadable trackers, except for plug-ins with an option that is already ``taken``."""
    owners, there = dict.fromkeys(taken, "import hands"), dict[str, Tracker]()
    for name, tracker in TRACKERS.working().items():
        options = vars(tracker)
        if name not in _BUILTIN_TRACKERS and (both := next((one for one in options if one in owners), None)):
            plugin = plugins.plugin_of(tracker) or name
            plugins.warn_once(f"{plugin} is left out: {owners[both]} has an option {both!r}, too")
            continue
        there[name] = tracker
        owners |= dict.fromkeys(options, f"the tracker {name}")
    return there


def choose_tracker(name: str, entry: Mapping[str, Tracker] = TRACKERS) -> Tracker:
    """Return the tracker ``name`` of ``entry``, with its options.

    Raises ``UsageError`` for an unknown name, and for options of another tracker.
    """
    if name not in entry:
        raise unknown_choice_error("--from", name, entry)
    for other, tracker in entry.items():
        for option, value in vars(tracker).items():
            if other != name and value != vars(TRACKERS[other])[option]:
                dashed = option.replace("_", "-")
                raise UsageError(f"--{dashed} cannot be used with --from {name}: it belongs to --from {other}")
    return entry[name]
