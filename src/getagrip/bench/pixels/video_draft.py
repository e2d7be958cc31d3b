"""A draft of a rendered video, stage by stage, each beside the truth; and with the truth in place of some stages.

The stages are those of ``getagrip draft VIDEO --object-box ... --no-page``, by the same functions: landmarks, lifted
hand, first mask from the box, frames of the grasp, masks carried from the first one, clip, fit. An ``Oracle`` puts the
truth in place of stages; those after it are made of it. What the pipeline gains by an oracle is what that stage costs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypeVar, cast

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.bench.inputs.simulated_evidence import (
    DEPTH_ERROR_LEVELS,
    JOINT_ERROR_LEVELS,
    simulate_depth,
    simulate_joints_2d,
)
from getagrip.bench.pixels.pixel_errors import PixelTruth, hand_errors, mask_overlap, measure
from getagrip.clip import Clip, HandTrack, Masks, Truth, read_clip, read_masks
from getagrip.clip.depth import DEPTH_KEY
from getagrip.errors import GetagripError, UsageError
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.lens import Lens
from getagrip.geometry.mesh import Mesh
from getagrip.hands.model import Side
from getagrip.io.files import Json
from getagrip.io.images import write_mask
from getagrip.provenance import estimated, measured
from getagrip.reconstruct import reconstruct
from getagrip.studio.detect_grasps import trim_reach
from getagrip.studio.hands import HandLandmarks
from getagrip.studio.hands.detect_hands import (
    DetectedHands,
    HandDetectionFiles,
    find_landmarks,
    lift_detected_landmarks,
    write_detected_hands,
)
from getagrip.studio.hands.networks import Nets
from getagrip.studio.jobs import RunCall
from getagrip.studio.masks.box_prompt import segment_box_by_motion, track_box
from getagrip.studio.masks.polygon_drafts import trace_polygons
from getagrip.studio.masks.uncertain_pixels import finger_pixels
from getagrip.studio.store.export_clip import new_clip_call, write_labelled_clip_files
from getagrip.studio.store.labels import OBJECT_LABEL, FrameLabels, Labels
from getagrip.studio.store.tasks import open_footage
from getagrip.synthetic.filmed import GRASP_FRAMES, REACH_FRAMES, FilmedClip
from getagrip.synthetic.scene import Scene, ground_truth_masks
from getagrip.synthetic.video import describe_rendered_video

M = TypeVar("M")
SIMULATED_LANDMARKS = "landmarks"
"""Key of ``JOINT_ERROR_LEVELS``: errors of the networks on real images, drawn where the networks are absent."""
SIMULATED_LOST_FRACTION = 0.05
"""Fraction of frames without a hand, where the networks are absent."""
SIMULATED_DEPTH = "realsense"
"""Key of ``DEPTH_ERROR_LEVELS``: errors of the sensor's depth."""


@dataclass(frozen=True)
class Oracle:
    """Stages in whose place the truth is put.

    Attributes:
        hands: the hand in 2D, its visible pixels and, at the fit, its shape and poses in 3D.
        first_mask: the object's mask in the first frame with a hand, from which the others are carried.
        interval: the frames of the grasp, and the object's mask in the first of them.
        masks: the masks of object and hand in all frames, the first one included.
        hand_size: the hand's size, and with it its distance: the lifted hand is scaled about the camera.
        depth: nothing; a sensor's depth images are added.
        mesh: the object's mesh, with its size, in place of a built-in shape.
    """

    hands: bool = False
    first_mask: bool = False
    interval: bool = False
    masks: bool = False
    hand_size: bool = False
    depth: bool = False
    mesh: bool = False


ORACLES: dict[str, Oracle] = {
    "masks": Oracle(masks=True),
    "first-mask": Oracle(first_mask=True),
    "interval": Oracle(interval=True),
    "hands": Oracle(hands=True),
    "hand-size": Oracle(hand_size=True),
    "depth": Oracle(depth=True),
    "mesh": Oracle(mesh=True),
    "mesh+depth": Oracle(mesh=True, depth=True),
    "masks+mesh": Oracle(masks=True, mesh=True),
    "masks+hands": Oracle(masks=True, hands=True, interval=True),
    "masks+hands+mesh": Oracle(masks=True, hands=True, interval=True, mesh=True),
}
"""Oracles by name."""


class VideoDraft:
    """The draft of a video whose scene is known; what oracles share is made once."""

    def __init__(
        self, filmed: FilmedClip, scene: Scene, video: Path, out: Path, nets: Nets | None, run: RunCall
    ) -> None:
        """Prepare the draft of a video; files go into the folder ``out``. Without ``nets`` landmarks are simulated.

        ``run`` makes a clip of files as ``clip new`` does. Raises ``InputError`` for a video that does not read.
        """
        self.filmed, self.scene, self.video, self.out, self.nets, self.run = filmed, scene, video, out, nets, run
        self._made: dict[str, object] = {}
        self.stages: Json = {}
        """Errors of the stages, without oracles."""
        with closing(open_footage(video)) as footage:
            self.frames = [footage.image(n) for n in range(footage.frames)]
            self.names, self.fps = [footage.name(n) for n in range(footage.frames)], footage.fps
        self.known = describe_rendered_video(scene, video.parent, scene.clip.size)
        self.lens, self.last = Lens(K=self.known.K), len(self.frames) - 1
        self.true_masks = ground_truth_masks(scene)
        truth = scene.clip.truth
        assert truth is not None
        assert scene.clip.hand.joints is not None
        self.true_joints = se3.transform(truth.T_cam_hand, scene.clip.hand.joints)
        mesh = Mesh(truth.scale * scene.clip.mesh.vertices, scene.clip.mesh.faces)
        self.truth = PixelTruth(
            tuple(self.names), mesh, truth.T_cam_obj, self.true_joints, self.true_masks.object, truth.T_cam_hand
        )

    def solve(self, oracle: Oracle, options: Options) -> Json:
        """Reconstruct the draft with an oracle, and return its errors, or a failure in words."""
        since = time.process_time()
        try:
            clip, masks = self.inputs(oracle)
            ready = time.process_time()
            result = reconstruct(clip, masks, options)
        except GetagripError as error:
            return {"failure": str(error), "seconds": time.process_time() - since}
        fitted = time.process_time() - ready
        truth = replace(self.truth, mesh=clip.mesh) if oracle.mesh else self.truth
        errors = measure(truth, clip, result, masks)
        return asdict(errors) | {"seconds": time.process_time() - since, "fit_seconds": fitted}

    def inputs(self, oracle: Oracle) -> tuple[Clip, Masks]:
        """Return the clip of the draft, and its masks. Raises ``GetagripError`` where a stage finds nothing."""
        files = replace(oracle, hand_size=False, depth=False, mesh=False)  # these three change the clip only
        return self._changed(oracle, *self._once(f"{files}", lambda: self._clip(files)))

    def _once(self, key: str, make: Callable[[], M]) -> M:
        """Return what ``make`` makes, made once; it fails once, too."""
        if key not in self._made:
            try:
                self._made[key] = make()
            except GetagripError as error:
                self._made[key] = error
        made = self._made[key]
        if isinstance(made, GetagripError):
            raise made
        return cast(M, made)

    def _clip(self, oracle: Oracle) -> tuple[Clip, Masks]:
        """Make the clip of the draft by files, as ``draft`` does."""
        plain = oracle == Oracle()
        name = "true" if oracle.hands else "found"
        found, side = self._once(name, self._true_hands if oracle.hands else self._found_hands)
        labels = self._grasp(found, self._first_mask(found, side, oracle), oracle)
        folder = self.out / ("-".join(name for name, on in asdict(oracle).items() if on) or "plain")
        since = time.process_time()
        write_labelled_clip_files(
            labels, self.frames.__getitem__, self.lens, folder, found=found, name=self.names.__getitem__
        )
        carried = time.process_time() - since
        mesh = self.filmed.kind if self.filmed.scan is None else str(self.filmed.scan)
        size = float(round(self.known.size_mm)) if self.filmed.sized else None
        call = new_clip_call(labels, folder, str(self.video))
        self.run(replace(call, mesh=mesh, size_mm=size, out=folder / "clip", overwrite=True, quiet=True))
        clip = read_clip(folder / "clip")
        masks = read_masks(clip)
        if plain:
            true = self.true_masks.object[self.truth.rows(clip.frames)]
            each = [mask_overlap([one], [other]) for one, other in zip(masks.object, true, strict=True)]
            self.stages |= {"masks_iou": float(np.median(each)), "masks_iou_least": min(each)}
            self.stages["masks_seconds"] = carried
        return clip, masks

    def _found_hands(self) -> tuple[HandDetectionFiles, Side]:
        """Find the hand, lift it, and measure both; return its files and its side."""
        since = time.process_time()
        if self.nets is None:
            landmarks = self._simulated_landmarks(exact=False)
        else:
            with closing(open_footage(self.video)) as footage:
                landmarks = find_landmarks(footage, (0, self.last), self.nets, None, np.array(self.known.box))
        files, lifted = self._write_hands(landmarks, "found")
        seconds = time.process_time() - since
        rows, true = np.array(landmarks.rows), project(self._K, self.true_joints)
        size = np.ptp(true[rows], axis=1).max(axis=1)
        off = np.linalg.norm(landmarks.points[rows] - true[rows], axis=2).mean(axis=1) / size
        assert lifted.hand.joints is not None
        joints = se3.transform(lifted.hand.T_cam_hand, lifted.hand.joints)
        errors = hand_errors(joints, self.true_joints[np.array(lifted.frames)])
        self.stages |= {
            "hand_found": len(rows) / len(self.frames),
            "side_right": landmarks.side == self.filmed.side,
            "landmarks_off": float(np.median(off)),
            "lifted": None if errors is None else asdict(errors),
            "simulated": self.nets is None,
            "hands_seconds": seconds,
        }
        return files, landmarks.side

    def _true_hands(self) -> tuple[HandDetectionFiles, Side]:
        """Write the true landmarks, as if they were found, and the true visible pixels of the hand."""
        files, lifted = self._write_hands(self._simulated_landmarks(exact=True), "true")
        assert self.true_masks.hand is not None
        for n in lifted.frames:
            write_mask(files.folder / "masks" / f"{n + 1:06d}.png", self.true_masks.hand[n])
        return files, self.filmed.side

    def _write_hands(self, landmarks: HandLandmarks, name: str) -> tuple[HandDetectionFiles, DetectedHands]:
        lifted = lift_detected_landmarks(landmarks, 0, self.scene.clip.size, self._K, measured("given"))
        (self.out / name).mkdir()
        folder = write_detected_hands(self.out / name, lifted, self.frames.__getitem__, lambda _: None)
        return HandDetectionFiles(folder), lifted

    @property
    def _K(self) -> Float[ndarray, "3 3"]:
        return self.scene.clip.K[0]

    def _simulated_landmarks(self, exact: bool) -> HandLandmarks:
        """Return the true joints as landmarks, ``exact`` or with the networks' measured errors."""
        clip, side = self.scene.clip, self.filmed.side
        points, joints = project(self._K, self.true_joints), self.true_joints
        confidence = np.ones(points.shape[:2])
        if not exact:
            rng = np.random.default_rng([self.filmed.seed, *b"landmarks"])
            points = simulate_joints_2d(clip, self.true_masks, JOINT_ERROR_LEVELS[SIMULATED_LANDMARKS], rng)
            confidence[rng.random(len(confidence)) < SIMULATED_LOST_FRACTION] = 0.0
        world = joints - joints.mean(axis=1, keepdims=True)
        lost = confidence[:, 0] == 0.0
        points, world = (np.where(lost[:, None, None], np.nan, each) for each in (points, world))
        return HandLandmarks(side, points, confidence, world, estimated(f"{side}, simulated"))

    def _first_mask(self, found: HandDetectionFiles, side: Side, oracle: Oracle) -> Labels:
        """Return labels of the first frame with a hand. Raises ``UsageError`` where nothing stands out in the box."""
        n = min(found.joints)
        true = self.true_masks.object[n]
        if oracle.first_mask or oracle.masks:
            mask = true
        else:
            *_, (box, _) = track_box(self.frames.__getitem__, self.known.box, 0, n)
            fingers, image = finger_pixels(found.joints[n], true.shape), self.frames.__getitem__
            mask = segment_box_by_motion(image, n, (0, self.last), box, found.mask(n), fingers) == OBJECT_LABEL
            if oracle == Oracle():
                self.stages["first_mask_iou"] = mask_overlap([mask], [true])
        shapes = tuple(trace_polygons(mask))
        if not shapes:
            raise UsageError("first mask: nothing stands out in the box")
        labels = {n: FrameLabels(object=shapes)}
        first, last = min(found.joints), max(found.joints)
        return Labels(self.video.name, self.scene.clip.size, side, self.fps, first, last, labels)

    def _grasp(self, found: HandDetectionFiles, labels: Labels, oracle: Oracle) -> Labels:
        """Return labels of the frames of the grasp; with true masks, of the object in each of them."""
        true = REACH_FRAMES, REACH_FRAMES + GRASP_FRAMES - 1
        if oracle.interval:
            extent = max(true[0], labels.first), min(true[1], labels.last)
            labels = replace(labels, frames=labels.frames if extent[0] in labels.frames else self._drawn(extent[:1]))
        else:
            trimmed = trim_reach(labels, self.frames.__getitem__, found.joints, found.mask, (0, self.known.box))
            labels, (extent, *_) = trimmed.labels, trimmed.extents
        if oracle == Oracle():
            self.stages |= {"interval_off": [extent[0] - true[0], extent[1] - true[1]]}
        inside = range(extent[0], extent[1] + 1)
        drawn = {n: shapes for n, shapes in labels.frames.items() if n in inside}
        if oracle.masks:
            drawn = self._drawn(inside)
        return replace(labels, first=extent[0], last=extent[1], frames=drawn)

    def _drawn(self, frames: Sequence[int]) -> dict[int, FrameLabels]:
        """Return the true mask of some frames as polygons."""
        return {n: FrameLabels(object=tuple(trace_polygons(self.true_masks.object[n]))) for n in frames}

    def _changed(self, oracle: Oracle, clip: Clip, masks: Masks) -> tuple[Clip, Masks]:
        """Return the inputs of the fit with the truth in place of the oracle's."""
        rows, scene = self.truth.rows(clip.frames), self.scene.clip
        if oracle.masks:
            masks = self.true_masks.take(rows)
        if oracle.hands:
            known = {key: value for key, value in clip.provenance.items() if not key.startswith("hands")}
            known |= {"hands": measured("the truth")}
            clip = replace(clip, hand=scene.hand.take(rows), side=self.filmed.side, provenance=known)
        if oracle.hand_size:
            clip = replace(
                clip,
                hand=self._at_true_distance(clip.hand, self.true_joints[rows]),
                provenance=clip.provenance | {"hands_scale": measured("the truth")},
            )
        if oracle.mesh:
            known = clip.provenance | {"mesh": measured("the object's own"), "scale": measured("the truth")}
            clip = replace(clip, mesh=self.scene.object, scale="known", provenance=known)
        if oracle.depth:
            truth = scene.truth
            assert truth is not None
            shown = replace(
                scene.take(rows),
                mesh=self.scene.object,
                truth=Truth(truth.T_cam_obj[rows], 1.0, truth.T_cam_hand[rows], truth.hand_vertices[rows]),
            )
            rng = np.random.default_rng([self.filmed.seed, *b"depth"])
            depth = simulate_depth(shown, masks, DEPTH_ERROR_LEVELS[SIMULATED_DEPTH], rng)
            clip = replace(clip, evidence={**clip.evidence, DEPTH_KEY: depth})
        return clip, masks

    def _at_true_distance(self, hand: HandTrack, joints: Float[ndarray, "T 21 3"]) -> HandTrack:
        """Scale a hand about the camera, by one factor, to the median distance of the true joints."""
        assert hand.joints is not None
        found = se3.transform(hand.T_cam_hand, hand.joints)
        near, true = (np.linalg.norm(each.mean(axis=1), axis=1) for each in (found, joints))
        factor = float(np.median(true / near))
        T = hand.T_cam_hand.copy()
        T[:, :3, 3] *= factor
        return replace(hand.scaled(factor), T_cam_hand=T)
