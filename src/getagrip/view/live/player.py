"""Which frame is shown while time goes on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0)
REST = 0.6
"""The last frame is shown for so long before the first one follows [s]."""
LONGEST = 1.0
"""No other frame is shown for longer, at speed 1: footage may have gaps [s]."""


@dataclass
class Player:
    """Plays T frames over and over.

    Attributes:
        time: (T,) when each frame was taken, rising [s].
        frame: the one that is shown.
        speed: seconds of footage in a second.
        playing: whether time goes on.
    """

    time: Float[ndarray, "T"]
    frame: int = 0
    speed: float = 1.0
    playing: bool = False

    @property
    def duration(self) -> float:
        """How long the frame is shown [s]."""
        last = self.frame == len(self.time) - 1
        span = REST if last else float(np.clip(self.time[self.frame + 1] - self.time[self.frame], 0.0, LONGEST))
        return span / self.speed

    def go(self, frame: int) -> None:
        """Show a frame; what is beyond the last or before the first comes round."""
        self.frame = frame % len(self.time)

    def late(self, seconds: float) -> float:
        """Go on by as many frames as ``seconds`` cover, and return what is left of them: slow pages skip frames."""
        while (duration := self.duration) <= seconds and duration > 0.0:
            self.go(self.frame + 1)
            seconds -= duration
            if self.frame == 0:
                return 0.0
        return seconds
