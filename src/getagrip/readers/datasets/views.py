"""Further views of a track: other calibrated cameras of a dataset, which see the same hand and object.

Masks of all views are rendered from the true poses, as those of the track's own camera.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, Self

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import FrameMasks, Masks
from getagrip.clip.views import MAX_VIEWS, View
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.io.terminal import format_count
from getagrip.provenance import Provenance

if TYPE_CHECKING:
    from getagrip.geometry.rasterize import Surface
    from getagrip.readers.datasets.dataset import Note
    from getagrip.readers.datasets.tracks import Track

MIN_VISIBLE_PIXELS = 25
"""Minimum number of pixels of a visible object's mask."""
ViewCount = Annotated[int | Literal["all"], arg(metavar="N|all")]
"""The option for the number of views, the clip's own included."""


@dataclass(frozen=True)
class TrackView:
    """A further camera of a track's T frames."""

    name: str
    """Name of the camera, and of the view's folder."""
    K: Float[ndarray, "3 3"]
    """Pinhole intrinsics [px]."""
    size: tuple[int, int]
    """Width and height of its images [px]."""
    T_cam_view: Float[ndarray, "T 4 4"]
    """Poses of the camera in the frame of the track's camera [m]."""
    camera: str
    """Description of the camera, for the provenance."""
    known: Bool[ndarray, "T"] | None = None
    """False for frames in which its pose is unknown, and another frame's is in its place; None: known in all."""
    covered: Bool[ndarray, "H W"] | None = None
    """Pixels inside the image of its lens; None: all."""

    def take(self, index: Int[ndarray, "n"]) -> Self:
        """Return the camera at some frames."""
        known = None if self.known is None else self.known[index]
        return replace(self, T_cam_view=self.T_cam_view[index], known=known)


class Scene(NamedTuple):
    """The surfaces of one frame, in a camera frame."""

    grasped: Surface
    hands: list[Surface]
    """The track's hand first."""
    others: list[Surface]
    """Other objects."""

    def seen_from(self, T_view_cam: Float[ndarray, "4 4"]) -> Scene:
        """Return the surfaces in the frame of another camera."""

        def moved(surfaces: Sequence[Surface]) -> list[Surface]:
            return [(se3.transform(T_view_cam, vertices), faces) for vertices, faces in surfaces]

        return Scene(moved([self.grasped])[0], moved(self.hands), moved(self.others))

    def masks(
        self, K: Float[ndarray, "3 3"], size: tuple[int, int], covered: Bool[ndarray, "H W"] | None
    ) -> FrameMasks:
        """Render the masks; pixels that are not ``covered`` by the lens are ignored."""
        from getagrip.geometry.rasterize import true_masks  # loads numba

        visible, ignore, hand = true_masks(*self, K, size)
        if covered is None:
            return FrameMasks(visible, ignore, hand)
        return FrameMasks(visible & covered, ignore | ~covered, hand & covered)


def check_view_count(views: int | str) -> None:
    """Raise ``UsageError`` for an impossible number of views."""
    if views != "all" and not 1 <= int(views) <= MAX_VIEWS:
        raise UsageError(f"--views must be 1 to {MAX_VIEWS}, or all (got {views})")


def with_further_views(
    track: Track, views: int | Literal["all"], read: Callable[[], Sequence[TrackView]], note: Note
) -> Track:
    """Return a track with further views of those that ``read`` returns, ``views`` with its own; none for 1.

    Those are chosen first whose lines of sight to the object differ most from the chosen ones'. Raises the errors of
    ``read``.
    """
    if views == 1:
        return track
    found, wanted = list(read()), (MAX_VIEWS if views == "all" else views) - 1
    if views != "all" and len(found) < wanted:
        note(f"{track.name}: {format_count(1 + len(found), 'view')}, no more are calibrated")
    return replace(track, views=tuple(_most_different(track, found, wanted)))


def _most_different(track: Track, found: list[TrackView], count: int) -> list[TrackView]:
    """Choose views one by one: the largest of the smallest sines of the angles to the lines of sight chosen before.

    Opposite views have the same outline of the object, so that their sine counts as well as that of equal ones. A view
    counts by the share of frames that show the object's centre.
    """
    places = se3.transform(track.T_cam_obj, track.mesh.centre[None])[:, 0]
    sights = [_unit(places), *(_unit(places - view.T_cam_view[:, :3, 3]) for view in found)]
    shares = [
        share_in_image(view.K, view.size, se3.transform(se3.inverse(view.T_cam_view), places[:, None])[:, 0])
        for view in found
    ]
    least = np.ones(len(found))
    chosen = list[int]()
    for _ in range(min(count, len(found))):
        before = sights[1 + chosen[-1] if chosen else 0]
        sines = [float(np.linalg.norm(np.cross(before, sight), axis=1).mean()) for sight in sights[1:]]
        least = np.minimum(least, sines)
        left = [k for k in range(len(found)) if k not in chosen]
        chosen.append(max(left, key=lambda k: shares[k] * least[k]))
    return [found[k] for k in chosen]


def share_in_image(K: Float[ndarray, "3 3"], size: tuple[int, int], points: Float[ndarray, "T 3"]) -> float:
    """Compute the share of points in the camera frame that are in the image."""
    ahead = points[points[:, 2] > 0.0]
    pixels = (ahead @ K.T)[:, :2] / ahead[:, 2:]
    return float(np.sum(np.all((pixels > 0.0) & (pixels < size), axis=1)) / len(points))


def _unit(v: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def rendered_views(track: Track, provenance: Provenance, note: Note) -> list[View]:
    """Render the further views of a track; a view that never shows the object is left out, with a note.

    Masks of frames in which the object has fewer than ``MIN_VISIBLE_PIXELS`` visible pixels are unknown.
    """
    out = []
    for view in track.views:
        nothing = np.zeros(view.size[::-1], dtype=bool)
        unknown = FrameMasks(nothing, ~nothing, nothing)
        T_view_cam = se3.inverse(view.T_cam_view)
        frames = []
        for row in range(len(track)):
            seen = unknown
            if view.known is None or view.known[row]:
                seen = track.scene(row).seen_from(T_view_cam[row]).masks(view.K, view.size, view.covered)
            frames.append(seen if np.count_nonzero(seen.object) >= MIN_VISIBLE_PIXELS else unknown)
        masks = Masks.packed(frames, view.size)
        if not masks.known.any():
            note(f"{track.name}: the object is not visible in the view {view.name}: left out")
            continue
        about = {"camera": view.camera, "masks": provenance["masks"]}
        K = np.tile(view.K, (len(track), 1, 1))
        out.append(View(name=view.name, size=view.size, K=K, T_cam_view=view.T_cam_view, masks=masks, provenance=about))
    return out
