"""Hands from external estimators, as a clip holds them: ``read(files, tracker, request)``.

Every estimator's file becomes ``Estimates``: per frame MANO's parameters of the hand as it is, left or right, before
the camera that the clip has, or joints. ``hand.track`` makes the surface of them. Each estimator is a ``Tracker`` in a
file of its own, and a line in ``TRACKERS``: its fields are options of
``getagrip import hands``. Two things go wrong in this step everywhere, and are done in one place each:

- **The camera.** Most networks see a square crop, and say where the hand is in it by a scale and a shift (weak
  perspective). Where that is before the camera depends on the focal length (``WeakPerspective``); guessed focal
  lengths are reported as guesses.
- **Left hands.** Most networks know right hands only, and are shown left ones mirrored: their rotations are those of
  the right hand in the mirrored image (``mirror_rotation``), and the surface is the right one's mirror image.
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
    """Return all trackers that can be loaded, except those of other packages whose options are already ``taken``."""
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
