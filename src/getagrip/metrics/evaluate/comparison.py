"""A reconstruction beside its clip: the parts from which metrics are computed.

A result of ``bench --hands`` has hands that no clip has: they are stored beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Clip, Masks, input_sha256
from getagrip.clip.depth import sensor_images
from getagrip.clip.masks import occluded_by_hand
from getagrip.clip.read_arrays import read_hand
from getagrip.clip.write import write_hand
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import depth_and_face
from getagrip.io import arrays, files
from getagrip.metrics import pose
from getagrip.metrics.contact import (
    CONTACT_DEFINITIONS,
    CONTACT_SIDES,
    MAX_SIGNED_DISTANCE_M,
    ContactDefinition,
    ContactDistances,
    Side,
    StableContact,
    contact_distances,
    stable_contact,
)
from getagrip.metrics.mask import MaskIou
from getagrip.metrics.motion import ContactPairs
from getagrip.metrics.pose import (
    MSPD_THRESHOLDS_PX,
    MSSD_THRESHOLDS,
    ObjectTrack,
    PoseErrors,
    SymmetricErrors,
    best_symmetry,
    pose_errors,
    recall_at_thresholds,
)
from getagrip.metrics.symmetry import Symmetries, find_symmetries

V = TypeVar("V")

TRUTH_CACHE_SIZE = 8
"""Maximum number of cached values of ground truths: those of the latest clips, in all and in fitted frames."""
_TRUTH_CACHE: dict[tuple[object, ...], Any] = {}
RESULT_HANDS_FILE = "hand.npz"
RESULT_HANDS_KEYS = ("names", "K", "clip_sha256")
"""Arrays of the file besides the hand's: frame names, the camera of each frame, the checksum of the clip without it."""


class MissingPartError(Exception):
    """A part of a comparison that is unknown: metrics that depend on it are left out."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A reconstruction beside its clip; subclasses define the kind of reconstruction.

    Each part is computed when a metric first reads it. Unknown parts raise ``MissingPartError``: without ground truth,
    masks or corresponding vertices.

    Attributes:
        clip: the clip, in the frames of the reconstruction.
        masks: the clip's masks, in the same frames.
        contacts: definitions of contact by which stable contact is measured.
    """

    clip: Clip
    masks: Masks | None
    contacts: tuple[ContactDefinition, ...] = field(default=CONTACT_DEFINITIONS, kw_only=True)

    @property
    def reach(self) -> float:
        """Distance up to which signed distances of hand and object must be exact [m]."""
        return max(MAX_SIGNED_DISTANCE_M, *(contact.threshold + 1e-3 for contact in self.contacts))

    @property
    def iou(self) -> MaskIou:
        """IOU with the observed masks."""
        raise NotImplementedError

    @property
    def distances(self) -> ContactDistances:
        """Distances between the reconstructed object and the clip's hand."""
        raise NotImplementedError

    @property
    def sides(self) -> Sequence[Side]:
        """Sides whose points correspond in all frames."""
        return CONTACT_SIDES

    @property
    def predicted(self) -> ObjectTrack:
        """Predicted poses of the clip's mesh in the hand."""
        raise MissingPartError

    @property
    def meshes(self) -> Sequence[Mesh | None]:
        """A mesh for each frame, in the hand frame [m]."""
        raise MissingPartError

    @property
    def has_object(self) -> Bool[ndarray, "T"]:
        """True in the reconstructed frames."""
        return np.ones(len(self.clip), dtype=bool)

    @cached_property
    def true(self) -> ObjectTrack:
        """The true object in the true hand's frame."""
        truth = self.clip.truth
        if truth is None:
            raise MissingPartError
        return ObjectTrack(se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj, truth.scale)

    @cached_property
    def predicted_in_camera(self) -> ObjectTrack:
        """Predicted poses of the clip's mesh in the camera, by the clip's hand."""
        return ObjectTrack(self.clip.hand.T_cam_hand @ self.predicted.T_ref_obj, self.predicted.scale)

    @cached_property
    def true_in_camera(self) -> ObjectTrack:
        """The true object in the camera frame."""
        if self.clip.truth is None:
            raise MissingPartError
        return ObjectTrack(self.clip.truth.T_cam_obj, self.clip.truth.scale)

    @cached_property
    def true_distances(self) -> ContactDistances:
        """Distances between the true object and the true hand; all methods on a clip share them."""
        clip, true = self.clip, self.true
        if clip.truth is None:
            raise MissingPartError
        hand, mesh = clip.truth.hand_vertices, clip.mesh
        return _compute_truth_cached(
            lambda: contact_distances(mesh, [true], hand, clip.hand.faces, self.reach)[0],
            mesh.vertices, mesh.faces, true.T_ref_obj, true.scale, hand, clip.hand.faces, self.reach,
        )  # fmt: skip

    @cached_property
    def errors(self) -> PoseErrors:
        """Errors of the object's pose in the hand."""
        return pose_errors(self.clip.mesh, self.predicted, self.true)

    @cached_property
    def errors_sym(self) -> PoseErrors:
        """Errors of the object's pose in the hand, up to the object's symmetries."""
        symmetry = best_symmetry(self.clip.mesh, self.predicted, self.true, self.symmetries)
        return pose_errors(self.clip.mesh, self.predicted, self.true, symmetry)

    @cached_property
    def errors_cam(self) -> PoseErrors:
        """Errors of the object's pose in the camera; equal to the errors in the hand if the hand is the true one."""
        if self._hand_is_true:
            return self.errors
        return pose_errors(self.clip.mesh, self.predicted_in_camera, self.true_in_camera)

    @cached_property
    def errors_sym_cam(self) -> PoseErrors:
        """Errors of the object's pose in the camera, up to the object's symmetries."""
        if self._hand_is_true:
            return self.errors_sym
        predicted, true = self.predicted_in_camera, self.true_in_camera
        symmetry = best_symmetry(self.clip.mesh, predicted, true, self.symmetries)
        return pose_errors(self.clip.mesh, predicted, true, symmetry)

    @property
    def _hand_is_true(self) -> bool:
        """True if the hand has its true pose: errors in the hand and in the camera are equal."""
        truth = self.clip.truth
        return truth is not None and np.array_equal(truth.T_cam_hand, self.clip.hand.T_cam_hand)

    @property
    def symmetries(self) -> Symmetries:
        """Symmetries of the clip's mesh."""
        return find_symmetries(self.clip.mesh)

    @property
    def scale_error(self) -> float:
        """Ratio of predicted and true scale, minus 1; missing for clips of known scale."""
        if self.clip.scale == "known":
            raise MissingPartError
        return self.predicted.scale / self.true.scale - 1.0

    @cached_property
    def object_in_camera(self) -> tuple[Float[ndarray, "T V 3"], Float[ndarray, "T V 3"]]:
        """Vertices of the predicted and of the true object in the camera frame [m]."""
        vertices = self.clip.mesh.vertices
        return self.predicted_in_camera.placed(vertices), self.true_in_camera.placed(vertices)

    @cached_property
    def symmetric_errors(self) -> SymmetricErrors:
        """Errors of the object in the camera, minimised over its symmetries."""
        return SymmetricErrors.of(self.clip.mesh, self.predicted_in_camera, self.true_in_camera, self.symmetries)

    @cached_property
    def mssd_recall(self) -> Float[ndarray, "T"]:
        """BOP's recall of the maximum distance in space (MSSD)."""
        return recall_at_thresholds(self.symmetric_errors.mssd(), MSSD_THRESHOLDS * self.errors_cam.diameter)

    @cached_property
    def mspd_recall(self) -> Float[ndarray, "T"]:
        """BOP's recall of the maximum distance in the image (MSPD)."""
        thresholds = MSPD_THRESHOLDS_PX * self.clip.size[0] / 640
        return recall_at_thresholds(self.symmetric_errors.mspd(self.clip.K), thresholds)

    @cached_property
    def vsd_recall(self) -> Float[ndarray, "T"]:
        """BOP's recall of the visible surface (VSD), in the frames with a sensor's depth image; NaN in the others."""
        clip = self.clip
        found = np.full(len(clip), np.nan)
        for n, (image, K) in sensor_images(clip):
            size = image.shape[::-1]
            rays = pose.ray_lengths(K, size)
            predicted, true = (
                depth_and_face(track.placed(clip.mesh.vertices)[n], clip.mesh.faces, K, size)[0]
                for track in (self.predicted_in_camera, self.true_in_camera)
            )
            predicted, true = (rays * np.where(np.isfinite(z), z, 0.0) for z in (predicted, true))
            tolerances = pose.VSD_TOLERANCES * clip.mesh.diameter * self.true_in_camera.scale
            found[n] = pose.vsd_recall(pose.discrepancy(predicted, true, rays * image, tolerances))
        if np.isnan(found).all():
            raise MissingPartError
        return found

    @cached_property
    def hand_in_camera(self) -> tuple[Float[ndarray, "T V 3"], Float[ndarray, "T V 3"]]:
        """Vertices of the predicted and of the true hand in the camera frame [m]; missing if they do not correspond."""
        hand, truth = self.clip.hand, self.clip.truth
        if truth is None or truth.hand_vertices.shape != hand.vertices.shape:
            raise MissingPartError
        return se3.transform(hand.T_cam_hand, hand.vertices), se3.transform(truth.T_cam_hand, truth.hand_vertices)

    @cached_property
    def contact_pairs(self) -> ContactPairs:
        """The nearest vertices of the true object to those of the true hand."""
        hand, object_ = self.hand_in_camera[1], self.object_in_camera[1]
        return _compute_truth_cached(lambda: ContactPairs.of(hand, object_), hand, object_)

    def contact(self, definition: ContactDefinition) -> StableContact:
        """Measure the stable contact of the reconstruction."""
        if definition.side not in self.sides:
            raise MissingPartError
        return self._stable(definition, False)

    def true_contact(self, definition: ContactDefinition) -> StableContact:
        """Measure the stable contact of the ground truth."""
        return self._stable(definition, True)

    def depth(self, side: Side) -> Float[ndarray, "T _"]:
        """Return the depth of each point of a side inside the other body [m]; NaN in frames without an object."""
        if not self.has_object.any():
            raise MissingPartError
        return np.where(self.has_object[:, None], self.distances.depth(side), np.nan)

    def true_depth(self, side: Side) -> Float[ndarray, "T _"]:
        """Return the depth of each point of the ground truth inside the other body [m]."""
        return self.true_distances.depth(side)

    def _stable(self, definition: ContactDefinition, true: bool) -> StableContact:
        """Stable contact, computed once per definition."""
        key = definition, true
        if key not in self._known:
            self._known[key] = stable_contact(self.true_distances if true else self.distances, definition)
        return self._known[key]

    @cached_property
    def _known(self) -> dict[tuple[ContactDefinition, bool], StableContact]:
        return {}

    @cached_property
    def judged_masks(self) -> Masks:
        """The observed masks; where they have no ignore masks, the hand is ignored, as methods do."""
        if self.masks is None:
            raise MissingPartError
        return self.masks if self.masks.say_what_hides else occluded_by_hand(self.clip, self.masks)


def _compute_truth_cached(compute: Callable[[], V], *inputs: ndarray | float) -> V:
    """Compute a value of the ground truth once for all methods on a clip; it depends on ``inputs`` alone."""
    key = tuple(part.tobytes() if isinstance(part, ndarray) else part for part in inputs)
    if key not in _TRUTH_CACHE:
        while len(_TRUTH_CACHE) >= TRUTH_CACHE_SIZE:
            _TRUTH_CACHE.pop(next(iter(_TRUTH_CACHE)))
        _TRUTH_CACHE[key] = compute()
    found: V = _TRUTH_CACHE[key]
    return found


def write_result_hands(clip: Clip, result: Path, clip_sha256: str) -> None:
    """Write the hands of a clip into the folder of its result."""
    stored = np.array(clip.frames), clip.K, np.array(clip_sha256)
    with files.new_file(result / RESULT_HANDS_FILE) as part:
        write_hand(clip.hand, part, dict(zip(RESULT_HANDS_KEYS, stored, strict=True)))


def with_result_hands(clip: Clip, result: Path) -> Clip | None:
    """Return the clip with the hands stored beside a result, in their frames; None without stored hands.

    Raises ``InputError`` for a malformed file, and where the clip has changed since.
    """
    path = result / RESULT_HANDS_FILE
    if not path.is_file():
        return None
    stored = arrays.read(path, RESULT_HANDS_KEYS.__contains__)
    for key in RESULT_HANDS_KEYS:
        if key not in stored:
            raise InputError(path, key, "nothing", "hands that bench --hands kept")
    if str(stored["clip_sha256"]) != input_sha256(clip.origin):
        raise InputError(path, "clip_sha256", f"another: {clip.name} has changed", "the clip's checksum; do it again")
    names = tuple(map(str, np.atleast_1d(stored["names"]).tolist()))
    K = arrays.floats(path, stored, "K", (len(names), 3, 3))
    return replace(clip.take(clip.index_of(names)), hand=read_hand(path, len(names)), K=K)
