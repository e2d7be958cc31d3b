"""The view that pictures show: a result or one of its candidates with clip and masks, and its curves over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks, Segment
from getagrip.clip import views as clip_views
from getagrip.clip.masks import occluded_by_hand
from getagrip.clip.views import clip_in_view, find_cameras, masks_in_view
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, diameter
from getagrip.geometry.rasterize import Surface
from getagrip.metrics.mask import iou_of_poses
from getagrip.result import Axis, Reconstruction
from getagrip.stable_grasps.axis import pose_hinge

OWN_CAMERA = "camera"
"""Name of a clip's own camera among its views."""


@dataclass(frozen=True)
class View:
    """A result with its clip and masks at the result's frames, with hand and mesh as the result has them.

    It is what the clip's own camera sees, or another one (``in_view``).
    """

    clip: Clip
    masks: Masks | None
    result: Reconstruction
    input_mesh: Mesh | None = None
    """The clip's mesh before the mesh fit, which the ground truth poses; None: ``clip.mesh``."""
    of_truth: bool = False
    """True if the result is the clip's ground truth (``ground_truth_view``)."""
    posed: bool = True
    """True if the object's poses are known; False for a hand alone (``hand_only_view``)."""
    frame_meshes: Sequence[Mesh | None] | None = None
    """A mesh per frame in the hand frame [m], from a system without a CAD model, in place of the posed mesh."""
    cameras: tuple[clip_views.View, ...] = ()
    """The further cameras, at the result's frames."""

    @property
    def frames_in_words(self) -> str:
        """Number of frames and, where they differ, their kinds."""
        counts = Counter(self.result.frame_kind)
        kinds = ", ".join(f"{count} {kind}" for kind, count in counts.most_common())
        return f"{len(self.result.frames)} frames" + (f" ({kinds})" if len(counts) > 1 else "")

    @property
    def size_in_words(self) -> list[str]:
        """Knowledge and assumptions about the object's size and shape."""
        size = f"scale {self.result.scale:.3f} is a guess" if self.clip.scale == "free" else "scale known"
        hand = [f"hand scaled by {self.result.hand_scale:.3f}"] * (self.result.hand_scale != 1.0)
        return [size, *hand, *["shape is a guess"] * (self.result.warp is not None)]

    def called(self, segment: Segment) -> tuple[str, ...]:
        """Return the names of a segment, the long one first."""
        words = segment.state if segment.side is None else f"{segment.state}, {segment.side} hand"
        followed = {segment.first for segment in self.result.segments if segment.by_masks}
        by_masks = self.clip.frames[segment.first] in followed
        return (f"{words}, by masks only",) if by_masks else (words, segment.state)

    def hand(self, n: int) -> Float[ndarray, "V 3"]:
        """Return the hand in the camera frame [m]."""
        return se3.transform(self.clip.hand.T_cam_hand[n], self.clip.hand.vertices[n])

    def hands(self, n: int) -> list[Surface]:
        """Return the hands in the camera frame [m]: the clip's own and, where known, the other one."""
        other = self.clip.other_hand
        shown = [(self.hand(n), self.clip.hand.faces)]
        if other is not None and other.known[n]:
            shown.append((se3.transform(other.track.T_cam_hand[n], other.track.vertices[n]), other.track.faces))
        return shown

    def by_other_hand(self) -> View | None:
        """Return the view relative to the other hand, at the frames in which that is known; None without any."""
        seen = self.clip.with_side(self.clip.other_side)
        known = np.flatnonzero(self.clip.hand_known(self.clip.other_side))
        if seen is None or not len(known):
            return None
        T_hand_obj = se3.inverse(seen.hand.T_cam_hand) @ self.clip.hand.T_cam_hand @ self.result.T_hand_obj
        result = replace(self.result, T_hand_obj=T_hand_obj, T_cam_hand=None, T_cam_other_hand=None, axis=None)
        return replace(self, clip=seen, result=result).at([self.result.frames[n] for n in known])

    def object(self, n: int) -> Float[ndarray, "V 3"]:
        """Return the reconstructed object in the camera frame [m]."""
        T_cam_obj = self.clip.hand.T_cam_hand[n] @ self.result.T_hand_obj[n]
        return se3.transform(T_cam_obj, self.result.scale * self.clip.mesh.vertices)

    def ground_height(self) -> float | None:
        """Return the ground's height along up [m]: the clip's support, else the lowest point of the static object."""
        clip, world = self.clip, self.clip.world
        if world is None or world.up is None:
            return None
        if world.support is not None:
            return world.support
        rows = [int(n) for s in clip.segments if s.state == "static" for n in s.rows]
        lowest = [float((se3.transform(world.T_world_cam[n], self.object(n)) @ world.up).min()) for n in rows]
        return float(np.median(lowest)) if lowest else None

    def surface(self, n: int) -> Surface:
        """Return the object in the camera frame [m]; an empty surface where the frame has no mesh."""
        if self.frame_meshes is None:
            return self.object(n), self.clip.mesh.faces
        if (mesh := self.frame_meshes[n]) is None:
            return np.zeros((0, 3)), np.zeros((0, 3), dtype=int)
        return se3.transform(self.clip.hand.T_cam_hand[n], mesh.vertices), mesh.faces

    @staticmethod
    def of(result: Reconstruction, clip: Clip, masks: Masks | None) -> View:
        """Make the view of a result with a clip and masks at the same frames."""
        light = clip.light()
        seen = light.warped(result.warp).with_hand_at(result.T_cam_hand, result.T_cam_other_hand, result.hand_scale)
        return View(seen, masks, result, light.mesh, cameras=find_cameras(clip))

    def in_view(self, camera: clip_views.View, with_masks: bool = True) -> View:
        """Return what a further camera sees: poses in its frame, its masks and its images; axis and IOU as they are.

        Raises ``InputError`` for masks that do not read.
        """
        clip = clip_in_view(self.clip, camera)
        masks = masks_in_view(clip, camera) if with_masks else None
        result = replace(self.result, T_cam_hand=None, T_cam_other_hand=None)
        return replace(self, clip=clip, masks=masks, result=result, cameras=())

    def in_each_view(self) -> dict[str, View]:
        """Return what each further camera sees, by name. Raises as ``in_view`` does."""
        return {camera.name: self.in_view(camera) for camera in self.cameras}

    def seen_by(self, name: str) -> View:
        """Return what one camera alone sees, the clip's own (``OWN_CAMERA``) or a further one.

        Raises ``UsageError`` for a name that the clip lacks, and as ``in_view`` does.
        """
        if name == OWN_CAMERA:
            return replace(self, cameras=())
        camera = next((one for one in self.cameras if one.name == name), None)
        if camera is None:
            known = " or ".join((OWN_CAMERA, *(one.name for one in self.cameras)))
            raise UsageError(f"--view must be {known} for the clip {self.clip.name} (got {name!r})")
        return self.in_view(camera)

    def measured_iou(self) -> Float[ndarray, "T"]:
        """Compute the IOU in the whole images, as this view's camera sees it; NaN without a mask of the object."""
        if self.masks is None:
            return np.full(len(self.clip), np.nan)
        masks = self.masks if self.masks.say_what_hides else occluded_by_hand(self.clip, self.masks)
        poses = self.clip.hand.T_cam_hand @ self.result.T_hand_obj
        return iou_of_poses(self.clip.mesh, self.result.scale, poses, self.clip.K, masks).full

    def image_file(self, n: int) -> Path | None:
        """Return the file of the frame's image; None without one."""
        return self.clip.image_file(n)

    def at(self, frames: Sequence[str]) -> View:
        """Return the view at some of the result's frames, in the given order."""
        place = {name: n for n, name in enumerate(self.result.frames)}
        index = np.array([place[name] for name in frames])
        result, axis = self.result, self.result.axis
        taken = replace(
            result,
            frames=tuple(frames),
            T_hand_obj=result.T_hand_obj[index],
            T_cam_hand=None if result.T_cam_hand is None else result.T_cam_hand[index],
            T_cam_other_hand=None if result.T_cam_other_hand is None else result.T_cam_other_hand[index],
            iou=result.iou[index],
            frame_kind=tuple(result.frame_kind[n] for n in index),
            axis=None if axis is None else replace(axis, angle=axis.angle[index]),
            candidates=replace(result.candidates, T_hand_obj=result.candidates.T_hand_obj[:, index]),
        )
        masks = None if self.masks is None else self.masks.take(index)
        meshes = None if self.frame_meshes is None else [self.frame_meshes[n] for n in index]
        cameras = tuple(camera.take(index) for camera in self.cameras)
        return replace(
            self, clip=self.clip.take(index), masks=masks, result=taken, frame_meshes=meshes, cameras=cameras
        )

    def true(self) -> View | None:
        """Return the view of the ground truth; None where unknown."""
        truth = self.clip.truth
        if truth is None:
            return None
        T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
        hand = replace(self.clip.hand, vertices=truth.hand_vertices, T_cam_hand=truth.T_cam_hand)
        result = replace(self.result, T_hand_obj=T_hand_obj, T_cam_hand=None, scale=truth.scale, axis=None, findings=())
        clip = replace(self.clip, hand=hand, mesh=self.input_mesh or self.clip.mesh)
        return View(clip, self.masks, replace(result, warp=None))


def candidate_view(view: View, rank: int) -> View:
    """Return the view of candidate ``rank``; 0 is the result.

    Its axis is fitted to its poses. IOU, findings, probabilities and distance's interval are the result's only.
    """
    if rank == 0:
        return view
    found = view.result
    T_hand_obj, scale = found.candidates.T_hand_obj[rank], float(found.candidates.scale[rank])
    axis = None if found.axis is None else fit_hinge_axis(T_hand_obj, scale * view.clip.mesh.vertices)
    other = replace(found, T_hand_obj=T_hand_obj, scale=scale, iou=np.full(len(found.frames), np.nan), axis=axis)
    unknown = replace(
        other, findings=(), probability_right=None, probability_right_in_camera=None, probability_looks_right=None,
        distance_interval_mm=None,
    )  # fmt: skip
    return replace(view, result=unknown)


def candidate_views(view: View) -> list[View]:
    """Return the view of each candidate, the result's first."""
    return [candidate_view(view, rank) for rank in range(len(view.result.candidates.scale))]


def fit_hinge_axis(T_hand_obj: Float[ndarray, "T 4 4"], vertices: Float[ndarray, "V 3"]) -> Axis | None:
    """Fit the axis of poses (Eq. 4), with angles relative to the first frame [rad]; None for a single pose."""
    if len(T_hand_obj) < 2:
        return None
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
    R, c = T_hand_obj[:, :3, :3], se3.transform(T_hand_obj, centre[None])[:, 0]
    best = pose_hinge(R, c, diameter(vertices) / 2.0)
    angle = np.unwrap(best.angles(R, c))
    return Axis(point=best.point, direction=best.direction, angle=angle - angle[0])


@dataclass(frozen=True, eq=False)
class AngleCurve:
    """An angle of the object in each of T frames [rad], of the result and, where known, of the ground truth."""

    title: str
    """Name of the angle."""
    found: Float[ndarray, "T"]
    true: Float[ndarray, "T"] | None


def result_times(view: View) -> Float[ndarray, "T"]:
    """Return the frames' times since the first frame [s]."""
    times = view.clip.time[view.clip.index_of(view.result.frames)]
    return np.asarray(times - times[0])


def angle_curve(view: View) -> AngleCurve:
    """Return the angle about the axis minus its mean or, without an axis, of the rotation since the first frame."""
    result, truth = view.result, view.clip.truth
    true = None if truth is None else (se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj)[:, :3, :3]
    if result.axis is None:
        R = result.T_hand_obj[:, :3, :3]
        turned = [None if r is None else se3.angle_between(r[:1], r) for r in (R, true)]
        assert turned[0] is not None
        which = "" if view.clip.other_hand is None else f"{view.clip.side} "
        return AngleCurve(f"rotation in the {which}hand since the start", turned[0], turned[1])
    found, about = result.axis.angle - result.axis.angle.mean(), None
    if true is not None:
        about = se3.log_so3(true @ true[0].T) @ result.axis.direction
        about -= about.mean()
    return AngleCurve("angle of the object about the axis", found, about)
