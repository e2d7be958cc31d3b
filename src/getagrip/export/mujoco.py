"""MuJoCo: a scene (MJCF) with the object as a free body, the hand and the camera as mocap bodies, a key per frame.

The world is in metres, z up; quaternions are (w, x, y, z). Key n is frame n: with ``mj_resetDataKeyframe`` and
``mj_forward`` the scene is replayed. In a simulation, ``mocap_pos`` and ``mocap_quat`` go from key to key.
The mocap body ``target`` is where the reconstruction has the object; a weld, ``follow``, draws the object there softly.
Without it (``eq_active``), contact and gravity alone move the object.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.export.bones import ENDS, JOINTS, Bones
from getagrip.export.scene import HAND_COLOUR, OBJECT_COLOUR, Scene, word
from getagrip.export.stage import Stage
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io import extras, files

FILE = "scene.xml"
MOST_PIECES = 32
VOXELS = 100_000
"""Number of voxels of the convex decomposition."""
DENSITY = 1000.0
"""Density of the object [kg/m^3], assumed: that of water and of most plastics."""
OBJECT_BITS, HAND_BITS = {"contype": "1", "conaffinity": "2"}, {"contype": "2", "conaffinity": "1"}
"""The object touches the hand; bones do not touch each other."""
FOLLOW = {"solref": "0.01 1", "solimp": "0.98 0.99 0.001"}
"""How stiff the weld is: more than contacts are, so that bones that are drawn too thick do not hold the object off."""
SEEN_ONLY = {"contype": "0", "conaffinity": "0", "group": "2"}
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""From MuJoCo's camera axes (y up, looking along -z) to this package's."""


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``scene.xml`` and its meshes. Raises ``UsageError`` without mujoco, and where MuJoCo refuses the scene."""
    library = extras.load("mujoco", "mujoco")
    on_stage, bones = Stage.of(scene), Bones.of(scene)
    T_stage_obj, T_stage_hand = on_stage.poses(scene)
    (folder / "assets").mkdir()
    pieces = convex_pieces(scene.object)
    for n, part in enumerate(pieces):
        write_mesh(part, folder / "assets" / f"piece_{n:02d}.obj")
    write_mesh(scene.object, folder / "assets" / "object.obj")
    root = Xml.Element("mujoco", model=word(scene.name))
    _add(root, "compiler", angle="radian", meshdir="assets")
    _add(root, "option", timestep="0.002", integrator="implicitfast")
    assets, world = _add(root, "asset"), _add(root, "worldbody")
    _mesh_asset(assets, "object", "shell")
    _add(world, "light", pos="0 0 3", directional="true")
    body = _add(world, "body", name="object", **_pose(T_stage_obj[0]))
    _add(body, "freejoint", name="object")
    _add(body, "geom", type="mesh", mesh="object", mass="0", rgba=_rgba(OBJECT_COLOUR), **SEEN_ONLY)
    for n in range(len(pieces)):
        _mesh_asset(assets, f"piece_{n:02d}", "convex")
        piece = {"mesh": f"piece_{n:02d}", "density": f"{DENSITY:g}", "group": "3", **OBJECT_BITS}
        _add(body, "geom", type="mesh", **piece)
    moved = _hand(world, assets, scene, bones, T_stage_hand, folder)
    moved |= {"target": T_stage_obj, "camera": np.asarray(on_stage.T_stage_cam @ FLIP)}
    _add(world, "body", name="target", mocap="true", **_pose(T_stage_obj[0]))
    camera = _add(world, "body", name="camera", mocap="true", **_pose(moved["camera"][0]))
    tall = 2.0 * np.degrees(np.arctan(scene.size[1] / 2.0 / scene.K[0, 1, 1]))  # degrees, whatever the compiler says
    _add(camera, "camera", name="clip", fovy=f"{tall:.6g}")
    equality = _add(root, "equality")
    _add(equality, "weld", name="follow", body1="target", body2="object", relpose="0 0 0 1 0 0 0", **FOLLOW)
    _keys(root, scene, T_stage_obj, moved)
    Xml.indent(root)
    files.write_bytes(folder / FILE, Xml.tostring(root, encoding="utf-8"))
    try:
        library.MjModel.from_xml_path(str(folder / FILE))
    except ValueError as error:
        raise UsageError(f"--to mujoco: MuJoCo refuses the scene of {scene.name}: {error}") from error
    fit = (
        "capsules about the bones between its joints"
        if bones
        else "its rigid mesh of the first frame, touching nothing"
    )
    about = f"MJCF: {on_stage.words}; key n is frame n; mass by a density of {DENSITY:g} kg/m^3 (a guess)"
    meshes = {f"assets/piece_{n:02d}.obj": "a convex piece of the object; metres" for n in range(len(pieces))}
    shown = {} if bones else {"assets/hand.obj": "the hand in the first frame, hand frame; metres"}
    return {FILE: f"{about}; the hand is {fit}", "assets/object.obj": "the object; metres", **meshes, **shown}


def convex_pieces(mesh: Mesh) -> list[Mesh]:
    """Split a mesh into convex pieces (V-HACD), or return its hull where it has no inside. Raises ``UsageError``."""
    faces = np.column_stack([np.full(len(mesh.faces), 3), mesh.faces]).astype(np.uint32).ravel()
    found = extras.load("vhacdx", "mujoco").compute_vhacd(
        mesh.vertices, faces, maxConvexHulls=MOST_PIECES, resolution=VOXELS, asyncACD=False
    )
    pieces = [Mesh(np.asarray(v, dtype=float), np.asarray(f).reshape(-1, 3).astype(np.int64)) for v, f in found]
    solid = [piece for piece in pieces if abs(piece.volume) > 1e-10]  # a cube of half a millimetre
    if solid:
        return solid
    import trimesh

    hull = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).convex_hull
    return [Mesh(np.asarray(hull.vertices), np.asarray(hull.faces, dtype=np.int64))]


def _hand(
    world: Xml.Element,
    assets: Xml.Element,
    scene: Scene,
    bones: Bones | None,
    T_stage_hand: Float[ndarray, "T 4 4"],
    folder: Path,
) -> dict[str, Float[ndarray, "T 4 4"]]:
    """Add the hand; returns the poses of its mocap bodies by name, in the order in which they are added."""
    colour = _rgba(HAND_COLOUR)
    if bones is None:
        write_mesh(Mesh(scene.hand_vertices[0], scene.hand_faces), folder / "assets" / "hand.obj")
        _mesh_asset(assets, "hand", "shell")
        body = _add(world, "body", name="hand", mocap="true", **_pose(T_stage_hand[0]))
        _add(body, "geom", type="mesh", mesh="hand", rgba=colour, **SEEN_ONLY)
        return {"hand": T_stage_hand}
    moved = {}
    T_stage_bone = T_stage_hand[:, None] @ bones.T_hand_bone
    for n, (_, joint) in enumerate(ENDS):
        name = f"bone_{JOINTS[joint]}"
        body = _add(world, "body", name=name, mocap="true", **_pose(T_stage_bone[0, n]))
        shape = {"fromto": f"0 0 0 0 0 {max(bones.length[n], 1e-4):.6g}", "size": f"{bones.radius[n]:.6g}"}
        _add(body, "geom", type="capsule", rgba=colour, **shape, **HAND_BITS)
        moved[name] = T_stage_bone[:, n]
    return moved


def _keys(
    root: Xml.Element, scene: Scene, T_stage_obj: Float[ndarray, "T 4 4"], moved: dict[str, Float[ndarray, "T 4 4"]]
) -> None:
    """Add a key per frame: its time, the object's position, and the positions of the mocap bodies."""
    keyframe = _add(root, "keyframe")
    places = np.stack([T[:, :3, 3] for T in moved.values()], axis=1)
    turns = np.stack([se3.quaternions_in_time(T[:, :3, :3]) for T in moved.values()], axis=1)
    qpos = np.concatenate([T_stage_obj[:, :3, 3], se3.quaternions_in_time(T_stage_obj[:, :3, :3])], axis=1)
    for n, time in enumerate(scene.time - scene.time[0]):
        arrays = {"qpos": qpos[n], "mpos": places[n], "mquat": turns[n]}
        numbers = {name: _numbers(values) for name, values in arrays.items()}
        _add(keyframe, "key", name=f"frame_{n:06d}", time=f"{time:.9g}", **numbers)


def _add(parent: Xml.Element, tag: str, **attributes: str) -> Xml.Element:
    return Xml.SubElement(parent, tag, attributes)


def _mesh_asset(assets: Xml.Element, name: str, inertia: str) -> None:
    _add(assets, "mesh", name=name, file=f"{name}.obj", inertia=inertia)


def _pose(T: Float[ndarray, "4 4"]) -> dict[str, str]:
    return {"pos": _numbers(T[:3, 3]), "quat": _numbers(se3.quaternion(T[:3, :3]))}


def _rgba(colour: tuple[float, float, float]) -> str:
    return _numbers(np.array([*colour, 1.0]))


def _numbers(values: Float[ndarray, "*n"]) -> str:
    return " ".join(f"{x:.9g}" for x in np.ravel(values))
