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
    GIVEN = "given", "another system's poses, or the ground truth"
    PARTLY_FAILED = "partly-failed", "failed in part: masks are hardly met (mean IOU) in some segments"
    MISFIT = "misfit", "failed: the best pose hardly meets the masks; nothing is known of the object"
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
        if sentence.startswith("failed in part"):
            return Status.PARTLY_FAILED
        return Status.MISFIT if sentence.startswith("failed") else Status.GIVEN
