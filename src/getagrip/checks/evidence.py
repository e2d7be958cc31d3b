"""The evidence of the checks: a clip, its masks and, after the fit, the result, in the same frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.clip import frame_indices
from getagrip.clip.views import views_of
from getagrip.geometry import se3
from getagrip.geometry.rasterize import nearest_surface, render_coverage
from getagrip.io.images import PackedMask, PackedMasks, pack_masks
from getagrip.metrics.contact import moving_distance
from getagrip.provenance import is_assumed

N_CONTACT_HAND_POINTS, N_CONTACT_FRAMES = 400, 15
"""Number of the hand's vertices whose distances to the object are measured, and of frames."""
SMALL_IMAGE_PX = 64
"""Longer side of the images in which the hand is rendered [px]."""
DEPTH_ORDER_IMAGE_PX, N_DEPTH_ORDER_FRAMES = 256, 8
"""Longer side of the images in which depth order is rendered [px], and number of frames."""
MAX_NAMED_FRAMES = 8
"""Maximum number of frames that a message names."""
N_POINTS_PER_REGION = 6
"""Number of vertices that represent a contact region of the hand."""


@dataclass(frozen=True)
class Glitches:
    """The frames of tracker glitches (``fitting.hand.refine_hand``).

    Attributes:
        frames: names of these frames.
        of: number of examined frames.
    """

    frames: tuple[str, ...]
    of: int

    @property
    def share(self) -> float:
        """Fraction of the frames."""
        return len(self.frames) / self.of

    def __str__(self) -> str:
        where, more = "frame" if len(self.frames) == 1 else "frames", len(self.frames) - MAX_NAMED_FRAMES
        names = ", ".join(self.frames[:MAX_NAMED_FRAMES]) + (f" and {more} more" if more > 0 else "")
        what = "the hand leaves its path and returns (tracker glitch); it was flipped back or interpolated"
        return f"{what}: {where} {names}"


@dataclass(frozen=True)
class TextureVote:
    """Vote of a mesh's texture on a result (``fitting.stages.texture``); NaN where it was not compared.

    Attributes:
        correlation: of its colours with those of the images.
        gain: nats by which it prefers the result to the pose that masks alone prefer; 0 where these are one.
        against: nats by which it prefers another pose to the result; 0 where it prefers the result.
        unread: number of images that do not read, and were not compared.
    """

    correlation: float = np.nan
    gain: float = np.nan
    against: float = np.nan
    unread: int = 0


@dataclass(frozen=True, eq=False)
class Evidence:
    """A clip with its masks and, after the fit, the result; each part is computed when a check first reads it.

    Attributes:
        clip: the clip, at the checked frames.
        masks: its input masks, in the same frames.
        T_hand_obj: (T, 4, 4) found poses; None before the fit.
        scale: found scale.
        iou: (n,) IOU of rendered and observed mask, in these frames or more; NaN where no mask shows the object, or the
            mask is an outlier.
        iou_frames: names of the frames of ``iou``; None: those of the clip.
        outliers: names of the frames with outlier masks; None if masks were not examined.
        deformed: root mean square deformation of the mesh by the fit [diameters]; NaN without a mesh fit.
        deformed_mm: the same in millimetres.
        hand_differing: fraction of the hand's visible pixels that differ from its silhouette; NaN where unknown.
        joints_left_out: True if the refinement of the hand ignored its 2D joints.
        misfit: contour distance to the masks, as a multiple of what the object's own mesh would leave.
        scale_check: scale that the energy prefers to a known one, and the fraction of energy that it saves; NaN where
            the scale was not checked.
        turned_away: angle by which the opening of a built-in vessel points away from the camera [degrees]; NaN for
            other meshes.
        handle_decided: how much more energy the result would have than another candidate if the fingers said nothing
            about the object's handle; NaN of an object without one.
        glitches: frames of tracker glitches, repaired in ``clip``; None where hands are used as given.
        texture: the vote of the mesh's texture.
        views_left_out: names of further views that contradict the clip, and were left out.
        view_outliers: outlier masks of further views in the fitted frames, each by the names of view and frame.
    """

    clip: Clip
    masks: Masks
    T_hand_obj: Float[ndarray, "T 4 4"] | None = None
    scale: float = 1.0
    iou: Float[ndarray, "n"] | None = None
    iou_frames: tuple[str, ...] | None = None
    outliers: tuple[str, ...] | None = None
    deformed: float = np.nan
    deformed_mm: float = np.nan
    hand_differing: float = np.nan
    joints_left_out: bool = False
    misfit: float = np.nan
    scale_check: tuple[float, float] = (np.nan, np.nan)
    turned_away: float = np.nan
    handle_decided: float = np.nan
    glitches: Glitches | None = None
    texture: TextureVote = TextureVote()
    views_left_out: tuple[str, ...] = ()
    view_outliers: tuple[tuple[str, str], ...] = ()

    @property
    def shape_assumed(self) -> bool:
        """True if the mesh is a built-in shape instead of the object's own mesh."""
        return is_assumed(self.clip.provenance.get("mesh"))

    @property
    def met_less(self) -> bool:
        """True if right poses meet masks less: of a built-in shape, and beside views with errors of their own."""
        return self.shape_assumed or bool(views_of(self.clip))

    @property
    def hand_lifted(self) -> bool:
        """True if the hand was lifted from 2D joints, so that its distance is uncertain."""
        return was_lifted(self.clip)

    @property
    def glitch_share(self) -> float:
        """Fraction of the frames with a tracker glitch; NaN if they were not looked for."""
        return np.nan if self.glitches is None else self.glitches.share

    @property
    def outlier_share(self) -> float:
        """Fraction of the frames with outlier masks; NaN if they were not looked for."""
        return np.nan if self.outliers is None else len(self.outliers) / len(self.overlaps)

    @cached_property
    def hand_middle(self) -> Float[ndarray, "T 3"]:
        """Mean of the hand's vertices, in the hand frame [m]."""
        return self.clip.hand.vertices.mean(axis=1)

    @cached_property
    def depth(self) -> Float[ndarray, "T"]:
        """Depth of the hand's middle in the camera frame [m]."""
        return np.asarray(se3.transform(self.clip.hand.T_cam_hand, self.hand_middle[:, None])[:, 0, 2])

    @cached_property
    def hand_size(self) -> float:
        """Largest side of the box around the hand, median over frames [m]."""
        return float(np.median(np.ptp(self.clip.hand.vertices, axis=1).max(axis=-1)))

    @cached_property
    def shown(self) -> PackedMasks:
        """The object's masks."""
        return pack_masks(self.masks.object)

    @cached_property
    def ignored(self) -> PackedMasks:
        """The ignore masks."""
        return pack_masks(self.masks.ignore)

    @cached_property
    def centroids(self) -> Float[ndarray, "T 2"]:
        """Middles of the object's masks [px]; NaN where a mask is empty."""
        sums = np.empty((len(self.boxes), 2))
        for n, (mask, (u0, v0, u1, v1)) in enumerate(zip(self.shown.frames, self.boxes, strict=True)):
            shown = mask.part(mask.box)
            sums[n] = shown.sum(axis=0) @ np.arange(u0, u1), shown.sum(axis=1) @ np.arange(v0, v1)
        with np.errstate(invalid="ignore"):
            return sums / self.mask_area[:, None] + 0.5

    @cached_property
    def boxes(self) -> Int[ndarray, "T 4"]:
        """Boxes around the object's masks [px]."""
        return self.shown.boxes

    @cached_property
    def mask_area(self) -> Float[ndarray, "T"]:
        """Pixels of the object's masks."""
        return self.shown.areas.astype(float)

    @cached_property
    def apparent_size(self) -> float:
        """Diagonal of the largest mask's box, at the hand's distance [m]."""
        return float(np.max(np.linalg.norm((self.boxes[:, 2:] - self.boxes[:, :2]) / self._focal, axis=1) * self.depth))

    @property
    def _focal(self) -> Float[ndarray, "T 2"]:
        return self.clip.K[:, [0, 1], [0, 1]]

    @cached_property
    def expected_size(self) -> float:
        """Half of the object's diameter in the image [px], about the root of a whole mask's area; 0 for a free scale.

        It is a lower bound on the mask's size: the part of an object that a hand leaves visible may lie anywhere in it.
        """
        if self.clip.scale != "known":
            return 0.0
        focal = self.clip.K[:, [0, 1], [0, 1]].mean(axis=1)
        return float(np.median(focal / self.depth)) * self.clip.mesh.diameter / 2.0

    @cached_property
    def drawn_hands(self) -> Bool[ndarray, "T h w"]:
        """Silhouettes of the input hand in small images."""
        K, size = np.diag([self._zoom, self._zoom, 1.0]) @ self.clip.K, self._small
        posed = se3.transform(self.clip.hand.T_cam_hand, self.clip.hand.vertices)
        return np.stack([render_coverage(v, self.clip.hand.faces, k, size) for v, k in zip(posed, K, strict=True)])

    @cached_property
    def small_ignore(self) -> Bool[ndarray, "T h w"]:
        """The ignore masks in small images."""
        return np.stack([_subsample_mask(mask, self._zoom, self._small) for mask in self.ignored.frames])

    @cached_property
    def small_hand_pixels(self) -> Bool[ndarray, "T h w"]:
        """The hand masks in small images; without hand masks, the ignore masks."""
        if self.masks.hand is None:
            return self.small_ignore
        return np.stack([_subsample_mask(mask, self._zoom, self._small) for mask in pack_masks(self.masks.hand).frames])

    @property
    def _zoom(self) -> float:
        return min(1.0, SMALL_IMAGE_PX / max(self.clip.size))

    @property
    def _small(self) -> tuple[int, int]:
        width, height = self.clip.size
        return max(1, int(width * self._zoom)), max(1, int(height * self._zoom))

    @property
    def overlaps(self) -> Float[ndarray, "n"]:
        """IOU of rendered and observed mask of each frame; NaN where no mask shows the object."""
        assert self.iou is not None
        return self.iou

    @cached_property
    def posed(self) -> Float[ndarray, "T V 3"]:
        """Vertices of the found object in the camera frame [m]."""
        assert self.T_hand_obj is not None
        T_cam_obj = self.clip.hand.T_cam_hand @ self.T_hand_obj
        return np.asarray(se3.transform(T_cam_obj, self.scale * self.clip.mesh.vertices))

    @cached_property
    def to_object(self) -> Float[ndarray, "n P"]:
        """Signed distances [m] of points of the hand to the found object in a few frames, negative inside."""
        return self._distance(frame_indices(self.clip.hand.vertices.shape[1], N_CONTACT_HAND_POINTS))

    @cached_property
    def region_distance(self) -> Float[ndarray, "n R"]:
        """Signed distance [m] of each contact region of the hand to the found object in these frames."""
        regions = self.clip.hand.regions.values()
        some = [ids[frame_indices(len(ids), N_POINTS_PER_REGION)] for ids in regions if len(ids)]
        ends = np.cumsum([len(ids) for ids in some])[:-1]
        parts = np.split(self._distance(np.concatenate(some)), ends, axis=1)
        return np.stack([part.min(axis=1) for part in parts], axis=1)

    def _distance(self, ids: Int[ndarray, "P"]) -> Float[ndarray, "n P"]:
        assert self.T_hand_obj is not None
        mesh, few = self.clip.mesh, frame_indices(len(self.clip), N_CONTACT_FRAMES)
        points = se3.transform(se3.inverse(self.T_hand_obj[few]), self.clip.hand.vertices[np.ix_(few, ids)])
        vertices = np.broadcast_to(self.scale * mesh.vertices, (len(points), *mesh.vertices.shape))
        return moving_distance(points, vertices, mesh.faces)

    @cached_property
    def in_front(self) -> tuple[float, float]:
        """Fractions of pixels with the wrong depth order, 0 where all is right; NaN without such pixels.

        The first is the fraction of the hand's visible pixels in which the object is in front of the hand, the second
        that of the object's mask in which the hand is in front.
        """
        assert self.T_hand_obj is not None
        few, zoom = frame_indices(len(self.clip), N_DEPTH_ORDER_FRAMES), DEPTH_ORDER_IMAGE_PX / max(self.clip.size)
        zoom = min(1.0, zoom)
        size = max(1, int(self.clip.size[0] * zoom)), max(1, int(self.clip.size[1] * zoom))
        hands = None if self.masks.hand is None else pack_masks(self.masks.hand)
        counts = np.zeros((2, 2))  # of the hand's, then of the object's pixels: with the other in front, and in all
        for n in few:
            hand = self.clip.hand.T_cam_hand[n]
            posed = se3.transform(hand @ self.T_hand_obj[n], self.scale * self.clip.mesh.vertices)
            posed_hand = se3.transform(hand, self.clip.hand.vertices[n])
            surfaces = (posed, self.clip.mesh.faces), (posed_hand, self.clip.hand.faces)
            nearest = nearest_surface(surfaces, np.diag([zoom, zoom, 1.0]) @ self.clip.K[n], size)
            for k, masks in enumerate((hands, self.shown)):
                if masks is None:
                    continue
                shown = _subsample_mask(masks.frames[n], zoom, size)
                counts[k] += np.count_nonzero(shown & (nearest == k)), np.count_nonzero(shown)
        with np.errstate(invalid="ignore"):
            over, under = counts[:, 0] / counts[:, 1]
        return float(over), float(under)


def was_lifted(clip: Clip) -> bool:
    """Return whether a clip's hand was lifted from 2D joints: it has them, and its size is, or was, assumed."""
    assumed_size = is_assumed(clip.provenance.get("hands_scale")) or clip.hand_scale != 1.0
    return clip.hand.joints_2d is not None and assumed_size


def _subsample_mask(mask: PackedMask, zoom: float, size: tuple[int, int]) -> Bool[ndarray, "h w"]:
    """Shrink a mask by ``zoom`` to an image of a size (width, height) [px]."""
    columns, rows = (((np.arange(side) + 0.5) / zoom).astype(int) for side in size)
    return mask.grid(rows, columns)
