"""MCAP (https://mcap.dev): a log for Foxglove and ROS tools, in JSON by the schemas of foxglove-sdk (``jsonschema``).

Frames are a tree: ``stage`` (stands still, z up), ``camera`` (x right, y down, z forward), the hands in it, and
``object`` in the clip's own hand. Quaternions are (x, y, z, w); times are the clip's. Meshes are beside it.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.export.scene import Scene
from getagrip.export.stage import Stage
from getagrip.geometry import se3
from getagrip.io import extras, files
from getagrip.io.images import read_image

FILE = "scene.mcap"
MAGIC = {b"\xff\xd8\xff": "jpeg", b"\x89PNG": "png"}
"""How image files begin that are kept as they are."""


def _object(title: str, **properties: object) -> dict[str, object]:
    return {"title": title, "type": "object", "properties": properties, "required": list(properties)}


def _list(of: Mapping[str, object], count: int = 0) -> dict[str, object]:
    return {"type": "array", "items": of} | ({"minItems": count, "maxItems": count} if count else {})


TEXT, NUMBER, INTEGER = {"type": "string"}, {"type": "number"}, {"type": "integer", "minimum": 0}
TIME = _object("time", sec=INTEGER, nsec=INTEGER)
VECTOR = _object("foxglove.Vector3", x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _object("foxglove.Quaternion", x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
TRANSFORM = _object(
    "foxglove.FrameTransform", timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=VECTOR,
    rotation=QUATERNION,
)  # fmt: skip
POSE = _object("foxglove.Pose", position=VECTOR, orientation=QUATERNION)
TRANSFORMS = _object("foxglove.FrameTransforms", transforms=_list(TRANSFORM))
POSES = _object("foxglove.PosesInFrame", timestamp=TIME, frame_id=TEXT, poses=_list(POSE))
IMAGE = _object(
    "foxglove.CompressedImage", timestamp=TIME, frame_id=TEXT, data=TEXT | {"contentEncoding": "base64"}, format=TEXT
)
CALIBRATION = _object(
    "foxglove.CameraCalibration", timestamp=TIME, frame_id=TEXT, width=INTEGER, height=INTEGER, distortion_model=TEXT,
    D=_list(NUMBER), K=_list(NUMBER, 9), R=_list(NUMBER, 9), P=_list(NUMBER, 12),
)  # fmt: skip


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``scene.mcap`` and meshes. Raises ``UsageError`` without mcap, ``InputError`` for unreadable images."""
    writing = extras.load("mcap.writer", "mcap")
    stage, channels = Stage.of(scene), dict[str, int]()
    with files.new_file(folder / FILE) as path, path.open("wb") as stream:
        writer = writing.Writer(stream)
        writer.start(profile="", library="getagrip")
        writer.add_metadata("about", {"clip": scene.name, "method": scene.method, "notes": "\n".join(scene.notes)})
        for n, time in enumerate(scene.time):
            nanoseconds = max(0, round(1e9 * float(time)))
            for topic, schema, message in _messages(scene, stage, n, nanoseconds):
                if topic not in channels:
                    known = writer.register_schema(str(schema["title"]), "jsonschema", json.dumps(schema).encode())
                    channels[topic] = writer.register_channel(topic, "json", known)
                writer.add_message(channels[topic], nanoseconds, json.dumps(message).encode(), nanoseconds, n)
        writer.finish()
    meshes = {"object.glb": (scene.object.vertices, scene.object.faces)}
    meshes |= {f"{hand.name}.glb": (hand.vertices[0], hand.faces) for hand in scene.hands}
    for name, (vertices, faces) in meshes.items():
        import trimesh

        scene_file: Any = trimesh.Trimesh(vertices, faces, process=False).export(file_type="glb")
        files.write_bytes(folder / name, scene_file)
    about = {name: f"the mesh in the frame {name[:-4]}, axes as they are; metres" for name in meshes}
    hands = {name: f"{words}; as it is bent in the first frame" for name, words in about.items() if "hand" in name}
    return {FILE: f"JSON by Foxglove's schemas; {stage.words}; quaternions (x, y, z, w)", **about, **hands}


def _messages(scene: Scene, stage: Stage, n: int, nanoseconds: int) -> Iterator[tuple[str, dict[str, object], object]]:
    """Yield the topic, the schema and the content of each message of frame ``n``."""
    sec, nsec = divmod(nanoseconds, 10**9)
    now = {"timestamp": {"sec": sec, "nsec": nsec}}
    seen = now | {"frame_id": "camera"}
    hands = [hand for hand in scene.hands if hand.known[n]]
    tree = [("stage", "camera", stage.T_stage_cam[n]), ("hand", "object", scene.T_hand_obj[n])]
    tree += [("camera", hand.name, hand.T_cam_hand[n]) for hand in hands]
    transforms = [
        now | {"parent_frame_id": parent, "child_frame_id": child, "translation": t, "rotation": q}
        for parent, child, T in tree
        for t, q in [_pose(T)]
    ]
    yield "/tf", TRANSFORMS, {"transforms": transforms}
    K, (width, height) = scene.K[n], scene.size
    size = {"width": width, "height": height, "distortion_model": "", "D": []}
    matrices = {"K": K, "R": np.eye(3), "P": np.column_stack([K, np.zeros(3)])}
    numbers = {name: M.ravel().tolist() for name, M in matrices.items()}
    yield "/camera/calibration", CALIBRATION, seen | size | numbers
    for hand in hands:
        if hand.joints is not None:
            poses = [_pose(se3.rigid(np.eye(3), joint)) for joint in hand.joints[n]]
            joints = {"poses": [{"position": t, "orientation": q} for t, q in poses]}
            yield f"/{hand.name}/joints", POSES, now | {"frame_id": hand.name} | joints
    if scene.image_files and (source := scene.image_files[n]) is not None:
        content, kind = _picture(source, scene.size)
        yield "/camera/image", IMAGE, seen | {"data": base64.b64encode(content).decode(), "format": kind}


def _pose(T: Float[ndarray, "4 4"]) -> tuple[dict[str, float], dict[str, float]]:
    """Write a pose as a translation and a quaternion."""
    w, x, y, z = se3.quaternion(T[:3, :3]).tolist()
    return dict(zip("xyz", T[:3, 3].tolist(), strict=True)), {"x": x, "y": y, "z": z, "w": w}


def _picture(path: Path, size: tuple[int, int]) -> tuple[bytes, str]:
    """Return an image as a file's content, and its format: as it is, or as PNG. Raises ``InputError``."""
    import cv2

    image, content = read_image(path, size), files.read_bytes(path)
    for begins, kind in MAGIC.items():
        if content.startswith(begins):
            return content, kind
    return cv2.imencode(".png", image[..., ::-1])[1].tobytes(), "png"
