"""Masks of the object, and of what hides it: ``masks/object`` and ``masks/ignore``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.clip import Clip, Masks, Modality
from getagrip.clip.masks import OBJECT, mask_files, read_object_masks, write_masks
from getagrip.fitting.energy import Terms

if TYPE_CHECKING:  # files of clips are asked for by commands that fit nothing
    from getagrip.fitting.problem import Problem


class ObjectMasks(Modality[Masks]):
    """The object's silhouette; every clip that is fitted has it.

    Its checks are those of ``checks.table``, which compare it with the mesh, the camera and the hand of any clip.
    """

    name = OBJECT

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        return [name for kind in ("object", "ignore") for name in mask_files(folder, kind, frames)]

    def read(self, clip: Clip) -> Masks:
        return read_object_masks(clip)

    def write(self, clip: Clip, folder: Path) -> None:
        masks = self.of(clip)
        if masks is None:
            return
        known, kinds = masks.known, {"object": masks.object}
        for kind, pixels in (kinds | {"ignore": masks.ignore} if masks.say_what_hides else kinds).items():
            write_masks(pixels, known, clip.frames, folder / "masks" / kind)

    def terms(self, problem: Problem) -> Terms:
        from getagrip.fitting.objective import mask_of

        return Terms(object=mask_of(problem))
