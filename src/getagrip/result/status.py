"""How a reconstruction ended."""

from __future__ import annotations

from enum import Enum
from typing import Self


class Status(Enum):
    """A word for programs, and a sentence that says what to do about it."""

    CONVERGED = "converged", "converged: further steps gain less than 0.1 % of the energy"
    STUCK = "stuck", "stopped: no step lowers the energy any more"
    LIMIT = (
        "iteration-limit",
        "stopped at the iteration limit while the energy was still falling a little; --thorough goes on longer",
    )
    FINISHED = "finished", "stopped: all iterations of the fixed number were made"
    JOINT = "joint", "all segments were fitted together"
    EXTERNAL = "given", "another system's poses, or the ground truth"
    PARTLY_FAILED = "partly-failed", "partly failed: low mask IOU in some segments"
    MISFIT = "misfit", "failed: even the best pose has a low mask IOU; the object's pose is unknown"
    INVISIBLE = "invisible", "failed: the object is behind the camera or too near to it in every hypothesis tried"

    sentence: str

    def __new__(cls, word: str, sentence: str = "") -> Self:
        """Make a member from its word; each member has its own sentence."""
        member = object.__new__(cls)
        member._value_, member.sentence = word, sentence
        return member

    @property
    def failed(self) -> bool:
        """True if the result, or a part of it, is not to be used."""
        return self in (Status.PARTLY_FAILED, Status.MISFIT, Status.INVISIBLE)

    @staticmethod
    def of_sentence(sentence: str) -> Status:
        """Return the status of a result of version 1, which has the sentence only; ``given`` for one from elsewhere."""
        known = next((status for status in Status if status.sentence == sentence), None)
        if known is not None:
            return known
        if sentence.startswith(("failed in part", "partly failed")):
            return Status.PARTLY_FAILED
        return Status.MISFIT if sentence.startswith("failed") else Status.EXTERNAL
