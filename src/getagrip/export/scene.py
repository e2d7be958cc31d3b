"""What is exported: a result with its clip, as poses in time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.result import FrameKind, Reconstruction

AXES = "camera frame of each image: x right, y down, z forward; X_cam = T_cam_obj @ X_obj; metres"


@dataclass(frozen=True, eq=False)
class Scene:
    """Hand and object in T frames, in metres and in the camera frame of each image (x right, y down, z forward).

    Attributes:
        name: name of the clip.
        method: name of the method.
        side: which hand.
        category: what the object is.
        frames: (T,) names of the frames.
        time: (T,) time since the clip's first frame [s].
        fps: frames per second of the clip.
        T_cam_hand: (T, 4, 4) pose of the hand, hand frame to camera frame.
        T_hand_obj: (T, 4, 4) pose of the object, object frame to hand frame.
        object: the mesh at the size that was found, in the object frame [m].
        scale: factor by which the clip's mesh was scaled.
        hand_vertices: (T, V, 3) the hand's vertices in the hand frame [m].
        hand_faces: (F, 3) their faces.
        joints: (T, 21, 3) the hand's joints in the hand frame [m], as in ``HandTrack``; None where not known.
        K: (T, 3, 3) intrinsics [px].
        size: width and height of the images [px].
        iou: (T,) mask IOU of each frame; NaN where no mask shows the object.
        frame_kind: (T,) how each frame's pose was found: sampled, fitted or interpolated.
        angle: (T,) angle about the latent axis [rad]; None for methods without one.
        notes: the result's notes: guesses among them.
    """

    name: str
    method: str
    side: str
    category: str
    frames: tuple[str, ...]
    time: Float[ndarray, "T"]
    fps: float
    T_cam_hand: Float[ndarray, "T 4 4"]
    T_hand_obj: Float[ndarray, "T 4 4"]
    object: Mesh
    scale: float
    hand_vertices: Float[ndarray, "T V 3"]
    hand_faces: Int[ndarray, "F 3"]
    joints: Float[ndarray, "T 21 3"] | None
    K: Float[ndarray, "T 3 3"]
    size: tuple[int, int]
    iou: Float[ndarray, "T"]
    frame_kind: tuple[FrameKind, ...]
    angle: Float[ndarray, "T"] | None
    notes: tuple[str, ...]

    @staticmethod
    def of(result: Reconstruction, clip: Clip) -> Scene:
        """Of a result and the clip that it was made from. Raises ``InputError`` where the frames are not the clip's."""
        index = clip.index_of(result.frames)
        some = clip.take(index).with_hand_at(result.T_cam_hand)
        return Scene(
            name=clip.name,
            method=result.method,
            side=clip.side,
            category=clip.category,
            frames=result.frames,
            time=index / clip.fps,
            fps=clip.fps,
            T_cam_hand=some.hand.T_cam_hand,
            T_hand_obj=result.T_hand_obj,
            object=Mesh(result.scale * clip.mesh.vertices, clip.mesh.faces),
            scale=result.scale,
            hand_vertices=some.hand.vertices,
            hand_faces=some.hand.faces,
            joints=some.hand.joints,
            K=some.K,
            size=clip.size,
            iou=result.iou,
            frame_kind=result.frame_kind,
            angle=None if result.axis is None else result.axis.angle,
            notes=result.notes,
        )

    @property
    def T_cam_obj(self) -> Float[ndarray, "T 4 4"]:
        """(T, 4, 4) pose of the object, object frame to camera frame."""
        return np.asarray(self.T_cam_hand @ self.T_hand_obj)

    @property
    def hand_in_camera(self) -> Float[ndarray, "T V 3"]:
        """The hand's vertices in the camera frame [m]."""
        return se3.transform(self.T_cam_hand, self.hand_vertices)

    def about(self, files: dict[str, str]) -> dict[str, Any]:
        """What goes beside the files of any format, as ``about.json``."""
        return {
            "clip": self.name,
            "method": self.method,
            "side": self.side,
            "category": self.category,
            "object_scale": self.scale,
            "fps": self.fps,
            "frames": list(self.frames),
            "time_s": self.time,
            "files": files,
            "notes": list(self.notes),
        }
