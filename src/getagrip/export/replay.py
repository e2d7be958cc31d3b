"""Replay in MuJoCo: the hand follows the reconstruction and holds the object by contact and friction alone.

The hand consists of 20 rigid parts, the convex hull of each bone's vertices, pulled along the reconstruction by welds:
mocap bodies have no velocity, and friction with them would hold the object in the world. A reconstructed hand touches
without pressing; contact therefore begins at a distance of ``SKIN_PRESS_DEPTH_M``, as if skin were pressed in. The
object consists of convex pieces, at first welded to the reconstructed pose, then free.

Friction, density, the stiffness of skin and, for a clip without ``world_up``, the direction of gravity are assumed.
The displacement of a released object as a measure of grasps is due to Tzionas et al. (IJCV 2016).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.interpolate import CubicSpline

from getagrip.errors import UsageError
from getagrip.export.mujoco import OBJECT_DENSITY_KG_M3, convex_decomposition
from getagrip.export.scene import Scene, StageFrame, bone_distances
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.io import plugins

if TYPE_CHECKING:
    from mujoco import MjData, MjModel

FRICTION_COEFFICIENT = 1.0
"""Coefficient of friction of skin and object, assumed."""
SKIN_PRESS_DEPTH_M = 0.003
"""Assumed penetration of hand and object where their surfaces just touch [m]."""
CONTACT_TIME_CONSTANT_S = 0.04
"""Time constant of contact [s]; a shorter one expels an object that penetrates the hand."""
MIN_PART_VERTICES = 4
"""Minimum number of vertices of a part of the hand, so that it has a volume."""
BONE_OVERLAP_M = 0.003
"""A vertex belongs to its nearest bone, and to bones that are farther by less than this distance [m]."""
SIMULATION_STEP_S = 0.002
SETTLING_TIME_S = 0.2
"""Time for which the hand is static in the first frame, with the object welded, until contacts are at rest [s]."""
WELD_TIME_S = 0.1
"""Time from the first frame for which the object is welded, at most half the clip [s]; it is released in motion."""
MAX_STABLE_DISPLACEMENT_M = 0.02
"""Mean displacement of the object's vertices up to which the object counts as in the hand [m]."""
WELD_TIME_CONSTANT_S = 0.008
WELD_LAG_S = 2.0 * WELD_TIME_CONSTANT_S
"""Lag of a critically damped weld [s]."""
HAND_PART_MASS_KG = 1.0
"""Mass of a part of the hand [kg], large enough that the object does not move it."""


@dataclass(frozen=True, eq=False)
class Replay:
    """The simulated object over T frames.

    Attributes:
        T_stage_obj: (T, 4, 4) simulated poses, object frame to stage frame [m].
        displacement: (T,) mean distance of the object's vertices from their reconstructed positions [m].
        free: (T,) True in the frames after the object was let go.
        assumed: assumptions about the physics, in words.
    """

    T_stage_obj: Float[ndarray, "T 4 4"]
    displacement: Float[ndarray, "T"]
    free: Bool[ndarray, "T"]
    assumed: str

    @property
    def stays(self) -> float:
        """Fraction of the frames after the release in which the object is in the hand."""
        return float((self.displacement[self.free] < MAX_STABLE_DISPLACEMENT_M).mean())


def simulate_replay(scene: Scene) -> Replay:
    """Simulate a scene. Raises ``UsageError`` without mujoco, joints or a second frame."""
    library = plugins.import_extra("mujoco", "mujoco", "replay")
    if len(scene.frames) < 2:
        raise UsageError(f"replay needs two frames or more (got {len(scene.frames)})")
    stage = StageFrame.of(scene)
    T_stage_obj, T_stage_hand = stage.poses(scene)
    parts, T_hand_part = split_hand_by_bones(scene)
    moved = np.concatenate([T_stage_hand[:, None] @ T_hand_part, T_stage_obj[:, None]], axis=1)
    model, data = _build_model(library, parts, scene.object, moved[0])
    turns = [se3.quaternions_in_time(moved[:, n, :3, :3]) for n in range(moved.shape[1])]
    times = scene.time - scene.time[0]
    path = CubicSpline(times, np.concatenate([moved[..., :3, 3], np.stack(turns, axis=1)], axis=-1))
    released, found = min(WELD_TIME_S, times[-1] / 2.0), []
    for time in times:
        while (now := data.time - SETTLING_TIME_S) < time:
            at = path(np.clip(now + WELD_LAG_S, 0.0, times[-1]))
            data.mocap_pos[:] = at[:, :3]
            data.mocap_quat[:] = at[:, 3:] / np.linalg.norm(at[:, 3:], axis=1, keepdims=True)
            data.eq_active[-1] = now < released
            library.mj_step(model, data)
        found.append(se3.rigid(se3.from_quaternion(data.xquat[-1]), data.xpos[-1]))  # the object is the last body
    T = np.stack(found)
    away = se3.transform(T, scene.object.vertices[None]) - se3.transform(T_stage_obj, scene.object.vertices[None])
    skin = f"skin pressed in by {1e3 * SKIN_PRESS_DEPTH_M:g} mm; {stage.words}"
    assumed = f"friction {FRICTION_COEFFICIENT:g}, density {OBJECT_DENSITY_KG_M3:g} kg/m^3, {skin}"
    return Replay(T, np.linalg.norm(away, axis=-1).mean(axis=1), times > released, assumed)


def split_hand_by_bones(scene: Scene) -> tuple[list[Float[ndarray, "n 3"]], Float[ndarray, "T P 4 4"]]:
    """Split the hand's vertices by bones into rigid parts, with poses fitted to their vertices in each frame.

    Raises ``UsageError`` for a hand without joints.
    """
    if scene.joints is None:
        raise UsageError(f"missing joints in hand.npz of the clip {scene.name}: replay needs 21")
    distance = bone_distances(scene)
    near = distance < distance.min(axis=1, keepdims=True) + BONE_OVERLAP_M
    near = near[:, near.sum(axis=0) >= MIN_PART_VERTICES]
    parts, poses = [], []
    for own in near.T if near.size else np.ones((1, len(near)), dtype=bool):  # a coarse mesh is one part
        points = scene.hand_vertices[:, own]
        middle = points.mean(axis=1)
        parts.append(points[0] - middle[0])
        R = se3.nearest_rotation(np.einsum("tni,nj->tij", points - middle[:, None], parts[-1]))
        poses.append(se3.rigid(R, middle))
    return parts, np.stack(poses, axis=1)


def _build_model(
    library: ModuleType, parts: list[Float[ndarray, "n 3"]], object_: Mesh, T: Float[ndarray, "N 4 4"]
) -> tuple[MjModel, MjData]:
    """Make the model: convex hulls of the hand's parts, then of the object's pieces, at their first poses ``T``."""
    spec = library.MjSpec()
    spec.option.timestep, spec.option.impratio = SIMULATION_STEP_S, 10.0
    spec.option.cone = library.mjtCone.mjCONE_ELLIPTIC
    spec.option.integrator = library.mjtIntegrator.mjINT_IMPLICITFAST
    pieces = [piece.vertices for piece in convex_decomposition(object_)]
    for n, meshes in enumerate([*([part] for part in parts), pieces]):
        is_object = n == len(parts)
        place = {"pos": T[n, :3, 3], "quat": se3.quaternion(T[n, :3, :3])}
        spec.worldbody.add_body(name=f"target_{n}", mocap=True, **place)
        body = spec.worldbody.add_body(name=f"body_{n}", gravcomp=0.0 if is_object else 1.0, **place)
        body.add_freejoint()
        of_object = {"density": OBJECT_DENSITY_KG_M3, "margin": SKIN_PRESS_DEPTH_M, "contype": 1, "conaffinity": 2}
        kind = of_object if is_object else {"mass": HAND_PART_MASS_KG, "contype": 2, "conaffinity": 1}
        for k, points in enumerate(meshes):
            name = f"mesh_{n}_{k}"
            spec.add_mesh(name=name, uservert=points.ravel())
            contact = {"solref": [CONTACT_TIME_CONSTANT_S, 1.0], "friction": [FRICTION_COEFFICIENT, 0.005, 1e-4]}
            body.add_geom(type=library.mjtGeom.mjGEOM_MESH, meshname=name, condim=4, **contact, **kind)
        weld = spec.add_equality(
            type=library.mjtEq.mjEQ_WELD, objtype=library.mjtObj.mjOBJ_BODY, name1=f"target_{n}", name2=f"body_{n}",
            solref=[WELD_TIME_CONSTANT_S, 1.0],
        )  # fmt: skip
        weld.data[:] = np.isin(np.arange(len(weld.data)), [6, 10])  # the identity as relative pose
    try:
        model = spec.compile()
    except ValueError as error:
        raise UsageError(f"replay: MuJoCo refuses the hand or the object: {error}") from error
    data = library.MjData(model)
    library.mj_forward(model, data)
    return model, data
