"""MuJoCo: a scene (MJCF) with the object as a free body, the hand and the camera as mocap bodies, a key per frame.

The world is in metres, z up; quaternions are (w, x, y, z). Key n is frame n: ``mj_resetDataKeyframe`` and
``mj_forward`` replay the scene; a simulation sets ``mocap_pos`` and ``mocap_quat`` from key to key. The mocap body
``target`` has the reconstructed pose of the object; a soft weld, ``follow``, pulls the object to it. Without the weld
(``eq_active``), contact and gravity alone move the object.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.export.scene import (
    BONE_END_JOINTS,
    HAND_COLOUR,
    HAND_JOINT_NAMES,
    OBJECT_COLOUR,
    Bones,
    Scene,
    StageFrame,
    format_vector,
    safe_file_name,
)
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io import files, plugins

MJCF_FILE = "scene.xml"
MAX_CONVEX_PIECES, N_DECOMPOSITION_VOXELS = 32, 100_000
OBJECT_DENSITY_KG_M3 = 1000.0
"""Density of the object [kg/m^3], assumed: that of water and of most plastics."""
OBJECT_CONTACT_BITS, HAND_CONTACT_BITS = {"contype": "1", "conaffinity": "2"}, {"contype": "2", "conaffinity": "1"}
"""Masks by which the object collides with the hand, and bones not with each other."""
WELD_STIFFNESS = {"solref": "0.01 1", "solimp": "0.98 0.99 0.001"}
"""Stiffness of the weld, above that of contacts, so that bones of too large a radius do not push the object away."""
VISUAL_GEOM_ATTRIBUTES = {"contype": "0", "conaffinity": "0", "group": "2"}
MUJOCO_CAMERA_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
"""From MuJoCo's camera axes (y up, looking along -z) to this package's."""


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``scene.xml`` and its meshes. Raises ``UsageError`` without mujoco, and where MuJoCo refuses the scene."""
    library = plugins.import_extra("mujoco", "mujoco")
    on_stage, bones = StageFrame.of(scene), Bones.of(scene)
    T_stage_obj, T_stage_hand = on_stage.poses(scene)
    (folder / "assets").mkdir()
    pieces = convex_decomposition(scene.object)
    for n, part in enumerate(pieces):
        write_mesh(part, folder / "assets" / f"piece_{n:02d}.obj")
    write_mesh(scene.object, folder / "assets" / "object.obj")
    root = Xml.Element("mujoco", model=safe_file_name(scene.name))
    _add_element(root, "compiler", angle="radian", meshdir="assets")
    _add_element(root, "option", timestep="0.002", integrator="implicitfast")
    assets, world = _add_element(root, "asset"), _add_element(root, "worldbody")
    _mesh_asset(assets, "object", "shell")
    _add_element(world, "light", pos="0 0 3", directional="true")
    body = _add_element(world, "body", name="object", **_pose_attributes(T_stage_obj[0]))
    _add_element(body, "freejoint", name="object")
    colour = _rgba(OBJECT_COLOUR)
    _add_element(body, "geom", type="mesh", mesh="object", mass="0", rgba=colour, **VISUAL_GEOM_ATTRIBUTES)
    for n in range(len(pieces)):
        _mesh_asset(assets, f"piece_{n:02d}", "convex")
        piece = {"mesh": f"piece_{n:02d}", "density": f"{OBJECT_DENSITY_KG_M3:g}", "group": "3", **OBJECT_CONTACT_BITS}
        _add_element(body, "geom", type="mesh", **piece)
    moved = _add_mjcf_hand(world, assets, scene, bones, T_stage_hand, folder)
    moved |= {"target": T_stage_obj}
    _add_element(world, "body", name="target", mocap="true", **_pose_attributes(T_stage_obj[0]))
    for of in scene.cameras:
        moves, name = ("camera", "clip") if of.name == "camera" else (f"camera_{of.name}", of.name)
        moved[moves] = np.asarray(on_stage.T_stage_cam @ of.T_cam_view @ MUJOCO_CAMERA_AXES)
        camera = _add_element(world, "body", name=moves, mocap="true", **_pose_attributes(moved[moves][0]))
        tall = 2.0 * np.degrees(np.arctan(of.size[1] / 2.0 / of.K[0, 1, 1]))  # degrees, whatever the compiler says
        _add_element(camera, "camera", name=name, fovy=f"{tall:.6g}")
    weld = {"name": "follow", "body1": "target", "body2": "object", "relpose": "0 0 0 1 0 0 0"}
    _add_element(_add_element(root, "equality"), "weld", **weld, **WELD_STIFFNESS)
    _add_keyframes(root, scene, T_stage_obj, moved)
    Xml.indent(root)
    files.write_bytes(folder / MJCF_FILE, Xml.tostring(root, encoding="utf-8"))
    try:
        library.MjModel.from_xml_path(str(folder / MJCF_FILE))
    except ValueError as error:
        raise UsageError(f"--to mujoco: MuJoCo refuses the scene of {scene.name}: {error}") from error
    fit = "capsules about the bones between its joints" if bones else "its rigid mesh of the first frame, no contact"
    about = f"MJCF: {on_stage.words}; key n is frame n; mass by a density of {OBJECT_DENSITY_KG_M3:g} kg/m^3 (a guess)"
    meshes = {f"assets/piece_{n:02d}.obj": "a convex piece of the object; metres" for n in range(len(pieces))}
    shown = {} if bones else {"assets/hand.obj": "the hand in the first frame, hand frame; metres"}
    return {MJCF_FILE: f"{about}; the hand is {fit}", "assets/object.obj": "the object; metres", **meshes, **shown}


def convex_decomposition(mesh: Mesh) -> list[Mesh]:
    """Split a mesh into convex pieces (V-HACD), or return its hull if the pieces have no volume.

    Raises ``UsageError`` without vhacdx.
    """
    faces = np.column_stack([np.full(len(mesh.faces), 3), mesh.faces]).astype(np.uint32).ravel()
    found = plugins.import_extra("vhacdx", "mujoco").compute_vhacd(
        mesh.vertices, faces, maxConvexHulls=MAX_CONVEX_PIECES, resolution=N_DECOMPOSITION_VOXELS, asyncACD=False
    )
    pieces = [Mesh(np.asarray(v, dtype=float), np.asarray(f).reshape(-1, 3).astype(np.int64)) for v, f in found]
    if solid := [piece for piece in pieces if abs(piece.volume) > 1e-10]:  # a cube of half a millimetre
        return solid
    import trimesh

    hull = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).convex_hull
    return [Mesh(np.asarray(hull.vertices), np.asarray(hull.faces, dtype=np.int64))]


def _add_mjcf_hand(
    world: Xml.Element,
    assets: Xml.Element,
    scene: Scene,
    bones: Bones | None,
    T_stage_hand: Float[ndarray, "T 4 4"],
    folder: Path,
) -> dict[str, Float[ndarray, "T 4 4"]]:
    """Add the hand; return the poses of its mocap bodies by name, in their order."""
    colour = _rgba(HAND_COLOUR)
    if bones is None:
        write_mesh(Mesh(scene.hand_vertices[0], scene.hand_faces), folder / "assets" / "hand.obj")
        _mesh_asset(assets, "hand", "shell")
        body = _add_element(world, "body", name="hand", mocap="true", **_pose_attributes(T_stage_hand[0]))
        _add_element(body, "geom", type="mesh", mesh="hand", rgba=colour, **VISUAL_GEOM_ATTRIBUTES)
        return {"hand": T_stage_hand}
    moved = {}
    T_stage_bone = T_stage_hand[:, None] @ bones.T_hand_bone
    for n, (_, joint) in enumerate(BONE_END_JOINTS):
        name = f"bone_{HAND_JOINT_NAMES[joint]}"
        body = _add_element(world, "body", name=name, mocap="true", **_pose_attributes(T_stage_bone[0, n]))
        shape = {"fromto": f"0 0 0 0 0 {max(bones.length[n], 1e-4):.6g}", "size": f"{bones.radius[n]:.6g}"}
        _add_element(body, "geom", type="capsule", rgba=colour, **shape, **HAND_CONTACT_BITS)
        moved[name] = T_stage_bone[:, n]
    return moved


def _add_keyframes(
    root: Xml.Element, scene: Scene, T_stage_obj: Float[ndarray, "T 4 4"], moved: dict[str, Float[ndarray, "T 4 4"]]
) -> None:
    """Add a key per frame: its time, the object's position, and the positions of the mocap bodies."""
    keyframe = _add_element(root, "keyframe")
    places = np.stack([T[:, :3, 3] for T in moved.values()], axis=1)
    turns = np.stack([se3.quaternions_in_time(T[:, :3, :3]) for T in moved.values()], axis=1)
    qpos = np.concatenate([T_stage_obj[:, :3, 3], se3.quaternions_in_time(T_stage_obj[:, :3, :3])], axis=1)
    for n, time in enumerate(scene.time - scene.time[0]):
        arrays = {"qpos": qpos[n], "mpos": places[n], "mquat": turns[n]}
        numbers = {name: format_vector(values) for name, values in arrays.items()}
        _add_element(keyframe, "key", name=f"frame_{n:06d}", time=f"{time:.9g}", **numbers)


def _add_element(parent: Xml.Element, tag: str, **attributes: str) -> Xml.Element:
    return Xml.SubElement(parent, tag, attributes)


def _mesh_asset(assets: Xml.Element, name: str, inertia: str) -> None:
    _add_element(assets, "mesh", name=name, file=f"{name}.obj", inertia=inertia)


def _pose_attributes(T: Float[ndarray, "4 4"]) -> dict[str, str]:
    return {"pos": format_vector(T[:3, 3]), "quat": format_vector(se3.quaternion(T[:3, :3]))}


def _rgba(colour: tuple[float, float, float]) -> str:
    return format_vector(np.array([*colour, 1.0]))
