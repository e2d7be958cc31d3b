"""MCAP (https://mcap.dev): a log for Foxglove and ROS tools, in JSON by the schemas of foxglove-sdk (``jsonschema``).

Frames form a tree: ``stage`` (static, z up), ``camera`` (x right, y down, z forward), the hands and the cameras of
further views, by their names, in the camera frame, and ``object`` in the clip's own hand. Quaternions are (x, y, z, w);
times are the clip's. Meshes are separate files.
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

from getagrip.export.scene import Scene, StageFrame
from getagrip.geometry import se3
from getagrip.io import files, plugins
from getagrip.io.images import read_image

MCAP_FILE = "scene.mcap"
IMAGE_SIGNATURES = {b"\xff\xd8\xff": "jpeg", b"\x89PNG": "png"}
"""First bytes of image files that are copied unchanged."""


def _object_schema(title: str, **properties: object) -> dict[str, object]:
    return {"title": title, "type": "object", "properties": properties, "required": list(properties)}


def _array_schema(of: Mapping[str, object], count: int = 0) -> dict[str, object]:
    return {"type": "array", "items": of} | ({"minItems": count, "maxItems": count} if count else {})


TEXT, NUMBER, COUNT = {"type": "string"}, {"type": "number"}, {"type": "integer", "minimum": 0}
TIME = _object_schema("time", sec=COUNT, nsec=COUNT)
VECTOR = _object_schema("foxglove.Vector3", x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _object_schema("foxglove.Quaternion", x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
POSE = _object_schema("foxglove.Pose", position=VECTOR, orientation=QUATERNION)
TRANSFORM = _object_schema(
    "foxglove.FrameTransform", timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=VECTOR,
    rotation=QUATERNION,
)  # fmt: skip
TRANSFORMS = _object_schema("foxglove.FrameTransforms", transforms=_array_schema(TRANSFORM))
POSES = _object_schema("foxglove.PosesInFrame", timestamp=TIME, frame_id=TEXT, poses=_array_schema(POSE))
IMAGE = _object_schema(
    "foxglove.CompressedImage", timestamp=TIME, frame_id=TEXT, data=TEXT | {"contentEncoding": "base64"}, format=TEXT
)
CALIBRATION = _object_schema(
    "foxglove.CameraCalibration", timestamp=TIME, frame_id=TEXT, width=COUNT, height=COUNT, distortion_model=TEXT,
    D=_array_schema(NUMBER), K=_array_schema(NUMBER, 9), R=_array_schema(NUMBER, 9), P=_array_schema(NUMBER, 12),
)  # fmt: skip


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``scene.mcap`` and meshes. Raises ``UsageError`` without mcap, ``InputError`` for unreadable images."""
    writing = plugins.import_extra("mcap.writer", "mcap")
    stage, channels = StageFrame.of(scene), dict[str, int]()
    with files.new_file(folder / MCAP_FILE) as path, path.open("wb") as stream:
        writer = writing.Writer(stream)
        writer.start(profile="", library="getagrip")
        writer.add_metadata("about", {"clip": scene.name, "method": scene.method, "notes": "\n".join(scene.notes)})
        for n, time in enumerate(scene.time):
            nanoseconds = max(0, round(1e9 * float(time)))
            for topic, schema, message in _frame_messages(scene, stage, n, nanoseconds):
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
    about = {name: f"the mesh in the frame {name[:-4]}, axes unchanged; metres" for name in meshes}
    hands = {name: f"{words}; in the first frame's articulation" for name, words in about.items() if "hand" in name}
    return {MCAP_FILE: f"JSON by Foxglove's schemas; {stage.words}; quaternions (x, y, z, w)", **about, **hands}


def _frame_messages(
    scene: Scene, stage: StageFrame, n: int, nanoseconds: int
) -> Iterator[tuple[str, dict[str, object], object]]:
    """Yield the topic, the schema and the content of each message of frame ``n``."""
    sec, nsec = divmod(nanoseconds, 10**9)
    now = {"timestamp": {"sec": sec, "nsec": nsec}}
    hands = [hand for hand in scene.hands if hand.known[n]]
    tree = [("stage", "camera", stage.T_stage_cam[n]), ("hand", "object", scene.T_hand_obj[n])]
    tree += [("camera", hand.name, hand.T_cam_hand[n]) for hand in hands]
    tree += [("camera", view.name, view.T_cam_view[n]) for view in scene.views]
    transforms = [
        now | {"parent_frame_id": parent, "child_frame_id": child, "translation": t, "rotation": q}
        for parent, child, T in tree
        for t, q in [_pose_message(T)]
    ]
    yield "/tf", TRANSFORMS, {"transforms": transforms}
    for camera in scene.cameras:
        (width, height), K = camera.size, camera.K[n]
        size = {"width": width, "height": height, "distortion_model": "", "D": []}
        matrices = {"K": K, "R": np.eye(3), "P": np.column_stack([K, np.zeros(3)])}
        numbers = {key: M.ravel().tolist() for key, M in matrices.items()}
        yield f"/{camera.name}/calibration", CALIBRATION, now | {"frame_id": camera.name} | size | numbers
    for hand in hands:
        if hand.joints is not None:
            poses = [_pose_message(se3.rigid(np.eye(3), joint)) for joint in hand.joints[n]]
            joints = {"poses": [{"position": t, "orientation": q} for t, q in poses]}
            yield f"/{hand.name}/joints", POSES, now | {"frame_id": hand.name} | joints
    for camera in scene.cameras:
        if (source := camera.image_files[n]) is not None:
            content, kind = _read_encoded_image(source, camera.size)
            encoded = {"data": base64.b64encode(content).decode(), "format": kind}
            yield f"/{camera.name}/image", IMAGE, now | {"frame_id": camera.name} | encoded


def _pose_message(T: Float[ndarray, "4 4"]) -> tuple[dict[str, float], dict[str, float]]:
    """Convert a pose to the fields of a translation and a quaternion."""
    w, x, y, z = se3.quaternion(T[:3, :3]).tolist()
    return dict(zip("xyz", T[:3, 3].tolist(), strict=True)), {"x": x, "y": y, "z": z, "w": w}


def _read_encoded_image(path: Path, size: tuple[int, int]) -> tuple[bytes, str]:
    """Return an image file's content and format: JPEG and PNG unchanged, others as PNG. Raises ``InputError``."""
    import cv2

    image, content = read_image(path, size), files.read_bytes(path)
    for begins, kind in IMAGE_SIGNATURES.items():
        if content.startswith(begins):
            return content, kind
    return cv2.imencode(".png", image[..., ::-1])[1].tobytes(), "png"
