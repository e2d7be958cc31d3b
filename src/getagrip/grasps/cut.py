"""Rules for cutting sequences: the definition of a stable grasp, or a list; for imports, ``segment`` and ``study``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field

from getagrip.clip import Clip
from getagrip.grasps.definition import MIN_GRASP_FRAMES, Definition
from getagrip.grasps.lists import GraspList, ListedGrasp
from getagrip.grasps.stable import PairwiseIou, segment

FIRST_FRAME_KEY = "first_frame"
"""In a clip's provenance: the number in the name of its sequence's first frame, by which lists count."""


@dataclass(frozen=True)
class CutRules:
    """How sequences are cut into stable grasps."""

    definition: Definition = field(default_factory=Definition)
    """Definition of a stable grasp; with a list, of contact only."""
    listed: GraspList | None = None
    """The grasps, if they are not to be found."""

    @property
    def shortest(self) -> int:
        """Frames of the shortest grasp."""
        return self.definition.shortest if self.listed is None else MIN_GRASP_FRAMES

    @property
    def description(self) -> str:
        """In words."""
        return self.definition.description if self.listed is None else f"the grasps of {self.listed.file}"

    def record(self) -> dict[str, object]:
        """Return what identifies the rule, as JSON values; for a list also the definition of contact in the grasps."""
        if self.listed is None:
            return asdict(self.definition)
        contact: dict[str, object] = {"contact": self.definition.contact, "points": self.definition.points}
        return {"list": self.listed.file, "sha256": self.listed.sha256} | contact

    def of(
        self, clip: Clip, progress: Callable[[float], None] = lambda _: None
    ) -> tuple[PairwiseIou, list[tuple[int, int]]]:
        """Return the contact IOU of a clip's frames, and its grasps: first and last frame of each, both included.

        Raises ``InputError`` for a clip without ground truth.
        """
        iou, found = segment(clip, self.definition, progress)
        if self.listed is not None:
            origin = clip.provenance.get(FIRST_FRAME_KEY)
            spans = [
                grasp.positions(clip.frames, origin if type(origin) is int else None)
                for grasp in self.listed.of(clip.name, clip.side, clip.category)
            ]
            found = sorted({(int(span[0]), int(span[-1])) for span in spans if len(span) >= MIN_GRASP_FRAMES})
        return iou, found


def as_listed(clip: Clip, first: int, last: int) -> ListedGrasp:
    """Return a grasp of a clip, from its frame ``first`` to ``last``, as lists have it."""
    duration = (last + 1 - first) / clip.fps
    return ListedGrasp(clip.name, clip.side, clip.category, clip.frames[first], clip.frames[last], duration)
