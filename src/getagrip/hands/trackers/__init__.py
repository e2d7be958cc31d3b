"""Hands from external estimators, as a clip holds them: ``read(files, tracker, request)``.

Every estimator's file becomes ``Estimates``: per frame MANO's parameters of the hand as it is, left or right, before
the camera that the clip has, or joints. ``hand.track`` makes the surface of them. Each estimator is a ``Tracker`` in a
file of its own, and a line in ``table``. Two things go wrong in this step everywhere, and are done in one place each:

- **The camera.** Most networks see a square crop, and say where the hand is in it by a scale and a shift (weak
  perspective). Where that is before the camera depends on the focal length (``weak_perspective``); guessed focal
  lengths are reported as guesses.
- **Left hands.** Most networks know right hands only, and are shown left ones mirrored: their rotations are those of
  the right hand in the mirrored image (``mirror_rotation``), and the surface is the right one's mirror image.
"""

from getagrip.hands.trackers.estimates import Estimates, Request
from getagrip.hands.trackers.reading import CHOSEN, EXTRAPOLATED, Hands, read
from getagrip.hands.trackers.table import TRACKERS, choose, usable
from getagrip.hands.trackers.tracker import Tracker

__all__ = ["CHOSEN", "EXTRAPOLATED", "TRACKERS", "Estimates", "Hands", "Request", "Tracker", "choose", "read", "usable"]
