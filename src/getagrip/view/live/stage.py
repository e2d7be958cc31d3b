"""One column in 3D: hand, object, axis, contact and ground truth, as nodes of viser's scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.colors import to_rgb
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import decimate, vertex_normals
from getagrip.view.gap import FACES
from getagrip.view.live.column import Column
from getagrip.view.live.contact import Surfaces
from getagrip.view.live.standing import T_scene_cam
from getagrip.view.style import AXIS, FOUND, HAND, OBJECT, TRUE

if TYPE_CHECKING:
    from viser import SceneApi

PARTS = ("hand", "object", "axis", "contact", "truth", "camera")
"""What may be shown or not."""
GHOST = 0.35
"""Opacity of the ground truth."""
WITHIN = 1e-3
"""The ground truth is drawn so far within its surface [m]: where a result is as near as that, it hides it."""
AXIS_WIDTH = 0.0025
"""Of the axis' line [m]."""
CAMERA_SIZE = 0.04
"""Of the camera's frustum [m]."""


@dataclass(frozen=True)
class Look:
    """What of the scene is wanted, and from whose frame."""

    parts: frozenset[str] = frozenset(PARTS) - {"camera"}
    still: str = "hand"
    contact: float = 0.005
    """Threshold of contact [m]."""


class Stage:
    """A column's nodes, beside those of the other columns."""

    def __init__(self, scene: SceneApi, name: str, column: Column, surfaces: Surfaces, beside: Float[ndarray, "3"]):
        """Add the nodes below ``/name``, the whole column moved by ``beside`` [m]."""
        self.column, self._surfaces, self._beside = column, surfaces, beside
        self._still, self._T_scene_cam = "", np.empty((0, 4, 4))
        self._truth = column.truth
        self._nodes: dict[str, Any] = {}
        self._root = scene.add_frame(f"/{name}", show_axes=False)

        def mesh(part: str, vertices: ndarray, faces: ndarray, colour: Any, **options: Any) -> None:
            shown = {"color": tuple(round(255 * c) for c in to_rgb(colour)), "side": "double"} | options
            self._nodes[part] = scene.add_mesh_simple(f"/{name}/{part}", vertices, faces, **shown)

        hand_faces, empty = surfaces.hand_faces, (np.zeros((3, 3)), np.array([[0, 1, 2]]))
        mesh("hand", surfaces.hand(0), hand_faces, HAND)
        mesh("contact on hand", *empty, FOUND)
        if (other := column.view.clip.other_hand) is not None:
            mesh("other hand", other.track.vertices[0], other.track.faces, HAND)
        if column.posed:
            mesh("object", surfaces.object.vertices, surfaces.object.faces, OBJECT)
            mesh("contact on object", *empty, FOUND)
        if (ends := column.axis_ends) is not None:
            red, green, blue = (round(255 * c) for c in to_rgb(AXIS))
            self._nodes["axis"] = scene.add_line_segments(
                f"/{name}/axis",
                ends[None].astype(np.float32),
                (red, green, blue),
                thickness=AXIS_WIDTH,
                thickness_units="world",
            )
        if self._truth is not None:
            true = decimate(self._truth.clip.mesh, FACES)
            faint = {"opacity": GHOST, "side": "front"}
            inner = within(self._truth.result.scale * true.vertices, true.faces)
            mesh("true object", inner, true.faces, TRUE, **faint)
            mesh("true hand", self._true_hand(0), hand_faces, TRUE, **faint)
        width, height = column.view.clip.size
        K = column.view.clip.K[0]
        self._nodes["camera"] = scene.add_camera_frustum(
            f"/{name}/camera", fov=2.0 * float(np.arctan(height / 2.0 / K[1, 1])), aspect=width / height,
            scale=CAMERA_SIZE, color=(90, 96, 102), thickness=0.0005,
        )  # fmt: skip

    def show(self, n: int, look: Look) -> None:
        """Bring all nodes to frame ``n``."""
        if self._still != look.still:
            self._still, self._T_scene_cam = look.still, T_scene_cam(self.column, look.still)
        T = se3.rigid(np.eye(3), self._beside) @ self._T_scene_cam[n]
        hand, held = T @ self.column.T_cam_hand[n], T @ self.column.T_cam_obj[n]
        self._place("hand", hand, "hand" in look.parts, self._surfaces.hand(n))
        if (other := self.column.view.clip.other_hand) is not None:
            shown = bool(other.known[n]) and "hand" in look.parts
            self._place("other hand", T @ other.track.T_cam_hand[n], shown, other.track.vertices[n])
        self._place("object", held, "object" in look.parts)
        self._place("axis", hand, "axis" in look.parts)
        self._place("camera", T, "camera" in look.parts)
        marked = "contact" in look.parts and self.column.posed
        if marked:
            self._patch("contact on hand", *self._surfaces.on_hand(n, look.contact))
            self._patch("contact on object", *self._surfaces.on_object(n, look.contact))
        self._place("contact on hand", hand, marked and "hand" in look.parts)
        self._place("contact on object", held, marked and "object" in look.parts)
        if (true := self._truth) is not None:
            ghost = "truth" in look.parts
            T_cam_hand = true.clip.hand.T_cam_hand[n]
            self._place("true object", T @ T_cam_hand @ true.result.T_hand_obj[n], ghost and "object" in look.parts)
            self._place("true hand", T @ T_cam_hand, ghost and "hand" in look.parts, self._true_hand(n))

    def _true_hand(self, n: int) -> Float[ndarray, "V 3"]:
        assert self._truth is not None
        hand = self._truth.clip.hand
        return within(hand.vertices[n], hand.faces)

    def remove(self) -> None:
        """Take the nodes away."""
        self._root.remove()

    def _place(
        self, part: str, T: Float[ndarray, "4 4"], visible: bool, vertices: Float[ndarray, "V 3"] | None = None
    ) -> None:
        """Pose a node, if there is such a one."""
        node = self._nodes.get(part)
        if node is None:
            return
        node.wxyz, node.position = se3.quaternion(T[:3, :3]), T[:3, 3]
        if vertices is not None:
            node.vertices = vertices.astype(np.float32)
        node.visible = visible

    def _patch(self, part: str, vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> None:
        """Another mesh in a node."""
        self._nodes[part].vertices = vertices.astype(np.float32)
        self._nodes[part].faces = faces.astype(np.uint32)


def within(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> Float[ndarray, "V 3"]:
    """A surface moved inwards by ``WITHIN``."""
    return np.asarray(vertices - WITHIN * vertex_normals(vertices, faces))
