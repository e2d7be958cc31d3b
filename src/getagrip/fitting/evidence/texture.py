"""Images of the frames (``frames``) beside a mesh with colours: texture decides among poses (``stages.texture``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.checks import Check, Evidence
from getagrip.clip import Clip, Modality
from getagrip.clip.clip import find_image
from getagrip.clip.read import read_header
from getagrip.geometry.mesh_files.colours import has_colours
from getagrip.io import files

TEXTURE_KEY = "texture"
"""Name of the modality."""
MIN_RELATED_CORRELATION, MIN_COLOUR_SPREAD = 0.15, 20.0
"""Correlation below which the images show other colours than the mesh, and standard deviation of a mesh's colours, 0 to
255, from which on these are looked for. Assumed."""


@dataclass(frozen=True)
class FrameImages:
    """Files of the frames' images, read where they are compared.

    Attributes:
        paths: of each frame; None for a frame without an image.
    """

    paths: tuple[Path | None, ...]

    def __len__(self) -> int:
        return len(self.paths)

    def take(self, index: Int[ndarray, "n"]) -> FrameImages:
        """Return the files of some of the frames, in this order."""
        return FrameImages(tuple(self.paths[n] for n in index))


def reads_images(folder: Path) -> bool:
    """Return whether a clip's images are evidence: its mesh has colours, and it is one stable grasp.

    Raises ``InputError``.
    """
    fields = read_header(folder).fields
    return not fields.get("segments") and has_colours(files.inside(folder, fields["mesh"], "mesh", "a mesh"))


def texture_correlation(it: Evidence) -> float:
    """Return the correlation of the mesh's colours with those of the images; NaN where these are nearly plain."""
    colours = it.clip.mesh.colours
    spread = 0.0 if colours is None else float(colours.std(axis=0).max())
    return it.texture.correlation if spread >= MIN_COLOUR_SPREAD else np.nan


class Texture(Modality[FrameImages]):
    """The colours of the images, of a mesh that has its own."""

    name = TEXTURE_KEY
    result_checks = (
        Check(
            "texture-turned", lambda it: it.texture.gain, high=0.0, serious=False,
            fault="the mesh's texture chose another pose than the masks, by {value} nats",
            advice="compare its texture with the images",
        ),
        Check(
            "texture-elsewhere", texture_correlation, low=MIN_RELATED_CORRELATION, serious=False,
            fault="the images do not show the mesh's texture: their colours correlate by {value}",
            advice="check that the texture is this object's; if so, the pose is wrong, or the images are dim or blurry",
        ),
        Check(
            "texture-unread", lambda it: float(it.texture.unread), high=0.0, serious=False,
            fault="{value} images do not read, and were not compared with the mesh's texture",
            advice="open the images in frames",
        ),
        Check(
            "texture-contradicts", lambda it: it.texture.against, high=10.0,
            fault="the mesh's texture prefers a pose that the masks exclude, by {value} nats",
            advice="compare its texture with the images; check that mesh and masks are of this object",
        ),
    )  # fmt: skip

    def files(self, folder: Path, frames: Sequence[str]) -> list[str]:
        if not (folder / "frames").is_dir() or not reads_images(folder):
            return []
        return [name for frame in frames if (name := find_image(folder, frame)) is not None]

    def read(self, clip: Clip) -> FrameImages | None:
        if clip.mesh.colours is None or clip.segments:
            return None
        paths = tuple(clip.image_file(int(n)) for n in np.arange(len(clip)))
        return FrameImages(paths) if any(paths) else None

    def write(self, clip: Clip, folder: Path) -> None:
        return None  # ``write_clip`` takes images
