"""A dataset: plates that getagrip draws itself. A real one reads its files where this one calls ``synthesise``."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from getagrip.clip import Clip, Masks
from getagrip.readers.datasets.dataset import Dataset, Draft, Missing, Note
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions


@dataclass(frozen=True)
class Plate:
    """What one process reads."""

    name: str
    seed: int
    options: SceneOptions

    def drafts(self, missing: Missing, note: Note) -> Iterator[Draft]:
        if missing(self.name):
            yield Draft(self.name, self.made)

    def made(self) -> tuple[Clip, Masks]:
        """The clip and its masks."""
        clip, masks = synthesise("plate", self.seed, self.options)
        return replace(clip, name=self.name), masks


@dataclass(frozen=True, kw_only=True)
class Plates(Dataset):
    """Import plates that are drawn."""

    parts_are = "plates"

    count: int = 1
    """How many."""
    frames: int = 30
    """Frames of each."""

    def parts(self, note: Note) -> Sequence[Plate]:
        options = SceneOptions(frames=self.frames, size=(320, 240), focal=300.0)
        return [Plate(f"plate-{seed}", seed, options) for seed in range(self.count)]
