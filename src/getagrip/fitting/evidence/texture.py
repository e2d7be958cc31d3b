"""Images of the frames (``frames``), of objects whose masks leave something open that colours tell.

Of a mesh with colours texture decides among poses (``stages.texture``); the surface of a body of revolution shows how
it turns about its axis (``stages.surface_motion``).
"""

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
from getagrip.geometry.mesh import Mesh, face_areas
from getagrip.geometry.mesh_files import read_mesh
from getagrip.geometry.mesh_files.colours import has_colours
from getagrip.io import files

TEXTURE_KEY = "texture"
"""Name of the modality."""
MIN_RELATED_CORRELATION, MIN_COLOUR_SPREAD = 0.15, 20.0
"""Correlation below which the images show other colours than the mesh, and standard deviation of a mesh's colours, 0 to
255, from which on these are looked for. Assumed."""
MIN_EQUAL_MOMENTS = 0.75
"""Least ratio of two principal moments of a surface that may be of revolution; an oval can still counts. Assumed."""


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
    """Return whether a clip's images are evidence: it is one stable grasp, and its mesh has colours or may be revolved.

    Raises ``InputError``.
    """
    fields = read_header(folder).fields
    if fields.get("segments"):
        return False
    path = files.inside(folder, fields["mesh"], "mesh", "a mesh")
    return has_colours(path) or may_be_revolved(read_mesh(path))


def may_be_revolved(mesh: Mesh) -> bool:
    """Return whether a mesh may be a body of revolution: two principal moments of its surface are about equal."""
    corners = mesh.vertices[mesh.faces]
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3)  # of edges: exact for second moments
    area = np.repeat(face_areas(mesh.vertices, mesh.faces), 3)
    about = middles - area @ middles / area.sum()
    moments = np.linalg.eigvalsh((about.T * area) @ about)
    return bool(np.any(moments[:-1] >= MIN_EQUAL_MOMENTS * moments[1:]))


def texture_correlation(it: Evidence) -> float:
    """Return the correlation of the mesh's colours with those of the images; NaN where these are nearly plain."""
    colours = it.clip.mesh.colours
    spread = 0.0 if colours is None else float(colours.std(axis=0).max())
    return it.texture.correlation if spread >= MIN_COLOUR_SPREAD else np.nan


class Texture(Modality[FrameImages]):
    """The colours of the images, of a mesh that has its own or may be a body of revolution."""

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
        if clip.segments or (clip.mesh.colours is None and not may_be_revolved(clip.mesh)):
            return None
        paths = tuple(clip.image_file(int(n)) for n in np.arange(len(clip)))
        return FrameImages(paths) if any(paths) else None

    def write(self, clip: Clip, folder: Path) -> None:
        return None  # ``write_clip`` takes images
