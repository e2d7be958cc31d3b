"""The camera as a user states it: options of several commands, light to load."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from getagrip.io.arguments import Flag, numbers_argument


@dataclass(frozen=True)
class Lens:
    """Knowledge about the camera: at most one of three fields is set."""

    K: Annotated[
        tuple[float, float, float, float] | None,
        numbers_argument(4, "FX FY CX CY"),
        arg(name="K", help_behavior_hint=""),
    ] = None
    """The camera's focal lengths and principal point [px]."""
    focal: Annotated[float | None, arg(metavar="PX", help_behavior_hint="")] = None
    """Instead of K, the focal length; the principal point is in the middle."""
    guess_focal: Flag = False
    """Assume the focal length; depths and sizes are then assumptions as well."""

    @property
    def is_set(self) -> bool:
        """True if any field is set."""
        return self.K is not None or self.focal is not None or self.guess_focal
