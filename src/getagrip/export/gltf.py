"""glTF: one binary file with the object's node and the hands' animated, for Blender and browsers.

glTF's axes are x right, y up, z towards the viewer; a root node turns the camera frame to them. The nodes of object and
hands have a translation [m] and a rotation (x, y, z, w) at each time [s]; a hand's articulation is a chain of morph
targets, one per frame, with weight 1 in its frame. In frames without a hand the scale of its node is 0.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Float32, Int, Shaped
from numpy import ndarray

from getagrip.export.scene import HAND_COLOUR, OBJECT_COLOUR, ExportedHand, Scene, linear_colours
from getagrip.geometry import se3
from getagrip.geometry.mesh import vertex_normals
from getagrip.io import files

if TYPE_CHECKING:
    import pygltflib

GLB_FILE, WHITE = "scene.glb", (1.0, 1.0, 1.0)


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``scene.glb``."""
    from pygltflib import GLTF2, Animation, Asset, Material, Node, PbrMetallicRoughness
    from pygltflib import Scene as Root

    gltf, buffers, colours = GLTF2(), _Buffers(), linear_colours(scene.object)
    gltf.asset = Asset(generator="getagrip", extras=_extras(scene))
    for colour in (OBJECT_COLOUR if colours is None else WHITE, HAND_COLOUR):  # a factor of the vertices' colours
        pbr = PbrMetallicRoughness(baseColorFactor=[*colour, 1.0], metallicFactor=0.0, roughnessFactor=0.8)
        gltf.materials.append(Material(pbrMetallicRoughness=pbr, doubleSided=True))
    hands = scene.hands
    gltf.meshes = [_gltf_mesh(buffers, "object", scene.object.vertices, scene.object.faces, 0, colours=colours)]
    gltf.meshes += [
        _gltf_mesh(buffers, hand.name, hand.vertices[0], hand.faces, 1, _morph_displacements(hand)) for hand in hands
    ]
    flip = [1.0, 0.0, 0.0, 0.0]  # half a turn about x: y down, z forward becomes y up, z back
    names = ["object", *(hand.name for hand in hands)]
    gltf.nodes = [Node(name="camera frame", rotation=flip, children=[n + 1 for n in range(len(names))])]
    gltf.nodes += [Node(name=name, mesh=n) for n, name in enumerate(names)]
    gltf.scenes, gltf.scene = [Root(name=scene.name, nodes=[0])], 0
    time = buffers.add(_strictly_rising_seconds(scene.time), bounds=True)
    animation = Animation(name="grasp")
    for node, T in enumerate((scene.T_cam_obj, *(hand.T_cam_hand for hand in hands)), start=1):
        _add_channel(animation, time, buffers.add(T[:, :3, 3].astype(np.float32)), node, "translation")
        _add_channel(animation, time, buffers.add(_quaternions_xyzw(T)), node, "rotation")
    for node, hand in enumerate(hands, start=2):
        if steps := len(_morph_displacements(hand)):
            _add_channel(animation, time, buffers.add(np.eye(steps, dtype=np.float32).ravel()), node, "weights")
        if not hand.known.all():
            shown = np.repeat(hand.known[:, None].astype(np.float32), 3, axis=1)
            _add_channel(animation, time, buffers.add(shown), node, "scale", "STEP")
    gltf.animations = [animation]
    buffers.into(gltf)
    files.write_bytes(folder / GLB_FILE, b"".join(gltf.save_to_bytes()))
    return {GLB_FILE: f"glTF 2.0: y up, z towards the viewer; metres; an animation of the nodes {', '.join(names)}"}


def _morph_displacements(hand: ExportedHand) -> Float[ndarray, "S V 3"]:
    """Return the vertices' displacements from the first frame; empty for a rigid hand."""
    bent = hand.vertices - hand.vertices[0]
    return bent if np.abs(bent).max() > 1e-7 else bent[:0]


def _extras(scene: Scene) -> dict[str, object]:
    about = {"frames": list(scene.frames), "time_s": scene.time.tolist(), "frame_kind": list(scene.frame_kind)}
    return {"units": "metres", **about, "notes": list(scene.notes)}


def _quaternions_xyzw(T: Float[ndarray, "T 4 4"]) -> Shaped[ndarray, "T 4"]:
    return np.roll(se3.quaternions_in_time(T[:, :3, :3]), -1, axis=1).astype(np.float32)


def _gltf_mesh(
    buffers: _Buffers,
    name: str,
    vertices: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    material: int,
    moved: Float[ndarray, "S V 3"] | None = None,
    colours: Float[ndarray, "V 3"] | None = None,
) -> pygltflib.Mesh:
    from pygltflib import Attributes, Mesh, Primitive

    value = Attributes(
        POSITION=buffers.add(vertices.astype(np.float32), bounds=True),
        NORMAL=buffers.add(vertex_normals(vertices, faces).astype(np.float32)),
    )
    if colours is not None:
        value.COLOR_0 = buffers.add(colours.astype(np.float32))
    steps = () if moved is None else moved.astype(np.float32)
    targets = [{"POSITION": buffers.add(step, bounds=True)} for step in steps]
    corners = buffers.add(faces.astype(np.uint32).ravel(), corners=True)
    part = Primitive(attributes=value, indices=corners, material=material, targets=targets)
    return Mesh(name=name, primitives=[part], weights=[0.0] * len(targets))


def _strictly_rising_seconds(time: Float[ndarray, "T"]) -> Float32[ndarray, "T"]:
    """Return seconds since the first frame, strictly rising in single precision, as glTF demands."""
    out = (time - time[0]).astype(np.float32)
    for n in range(1, len(out)):
        out[n] = max(out[n], np.nextafter(out[n - 1], np.float32(np.inf)))
    return out


def _add_channel(
    animation: pygltflib.Animation, time: int, values: int, node: int, path: str, between: str = "LINEAR"
) -> None:
    from pygltflib import AnimationChannel, AnimationChannelTarget, AnimationSampler

    sampler = AnimationSampler(input=time, output=values, interpolation=between)
    target = AnimationChannelTarget(node=node, path=path)
    animation.channels.append(AnimationChannel(sampler=len(animation.samplers), target=target))
    animation.samplers.append(sampler)


class _Buffers:
    """The file's binary part: arrays one after another."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._views: list[pygltflib.BufferView] = []
        self._accessors: list[pygltflib.Accessor] = []
        self._size = 0

    def add(self, values: Shaped[ndarray, "..."], bounds: bool = False, corners: bool = False) -> int:
        """Add an array of float32, or of uint32 (``corners``), and return the index of its accessor."""
        import pygltflib as gltf

        content = np.ascontiguousarray(values).tobytes()
        target = gltf.ELEMENT_ARRAY_BUFFER if corners else None
        self._views.append(gltf.BufferView(buffer=0, byteOffset=self._size, byteLength=len(content), target=target))
        rows = values.reshape(len(values), -1)
        accessor = gltf.Accessor(
            bufferView=len(self._views) - 1,
            componentType=gltf.UNSIGNED_INT if corners else gltf.FLOAT,
            count=len(rows),
            type={1: gltf.SCALAR, 3: gltf.VEC3, 4: gltf.VEC4}[rows.shape[1]],
        )
        if bounds:
            accessor.min, accessor.max = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        self._accessors.append(accessor)
        self._parts.append(content)  # a multiple of four bytes, as glTF demands
        self._size += len(content)
        return len(self._accessors) - 1

    def into(self, gltf: pygltflib.GLTF2) -> None:
        """Put all arrays into a file."""
        from pygltflib import Buffer

        gltf.buffers = [Buffer(byteLength=self._size)]
        gltf.bufferViews, gltf.accessors = self._views, self._accessors
        gltf.set_binary_blob(b"".join(self._parts))
