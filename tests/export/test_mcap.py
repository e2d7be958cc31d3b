"""MCAP: the reader of the format's own package gives back the scene that was written."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from numpy import ndarray
from scipy.spatial.transform import Rotation

from getagrip.errors import InputError
from getagrip.export import Scene, export
from getagrip.export.scene import StageFrame
from getagrip.geometry import se3
from helpers.environment import needs_library

pytestmark = needs_library("mcap", "mcap")


def messages(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """The time and content of the messages of each topic; each has what its schema asks for."""
    from mcap.reader import make_reader

    found: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            content, asked = json.loads(message.data), json.loads(schema.data)
            assert (schema.encoding, channel.message_encoding, asked["title"]) == ("jsonschema", "json", schema.name)
            assert {*content} == {*asked["required"]}
            found.setdefault(channel.topic, []).append((message.log_time, content))
    return found


def pose(transform: dict[str, Any]) -> ndarray:
    q, t = ([transform[key][axis] for axis in axes] for key, axes in (("rotation", "xyzw"), ("translation", "xyz")))
    return se3.rigid(Rotation.from_quat(q).as_matrix(), np.array(t))


def test_the_tree_of_frames_is_the_scene(both: Scene, tmp_path: Path) -> None:
    found = messages(export(both, tmp_path / "out", "mcap") / "scene.mcap")
    assert [time for time, _ in found["/tf"]] == [round(1e9 * t) for t in both.time]
    stage = StageFrame.of(both)
    T_stage_obj, _ = stage.poses(both)
    for n, (time, content) in enumerate(found["/tf"]):
        tree = {one["child_frame_id"]: (one["parent_frame_id"], pose(one)) for one in content["transforms"]}
        assert content["transforms"][0]["timestamp"] == {"sec": time // 10**9, "nsec": time % 10**9}
        assert {child: parent for child, (parent, _) in tree.items()} == {
            "camera": "stage", "hand": "camera", "object": "hand", **({"other_hand": "camera"} if n != 1 else {}),
        }  # fmt: skip
        T = tree["camera"][1] @ tree["hand"][1] @ tree["object"][1]
        np.testing.assert_allclose(T, T_stage_obj[n], atol=1e-9)
    assert [time for time, _ in found["/other_hand/joints"]] == [round(1e9 * both.time[n]) for n in (0, 2)]
    joints = [[[p["position"][axis] for axis in "xyz"] for p in c["poses"]] for _, c in found["/hand/joints"]]
    np.testing.assert_allclose(joints, both.joints, atol=1e-12)
    for n, (_, content) in enumerate(found["/camera/calibration"]):
        np.testing.assert_array_equal(np.reshape(content["K"], (3, 3)), both.K[n])
        assert (content["width"], content["height"]) == both.size
    mesh = trimesh.load(tmp_path / "out" / "object.glb", force="mesh", process=False)
    np.testing.assert_allclose(mesh.vertices, both.object.vertices, atol=1e-6)


def test_images_are_kept_as_they_are(scene: Scene, tmp_path: Path) -> None:
    width, height = scene.size
    image = np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)
    paths = [tmp_path / "0.png", None, tmp_path / "2.jpg"]
    for path in filter(None, paths):
        cv2.imwrite(str(path), image)
    found = messages(export(replace(scene, image_files=tuple(paths)), tmp_path / "out", "mcap") / "scene.mcap")
    for (time, content), n, kind in zip(found["/camera/image"], (0, 2), ("png", "jpeg"), strict=True):
        assert (time, content["format"]) == (round(1e9 * scene.time[n]), kind)
        assert base64.b64decode(content["data"]) == paths[n].read_bytes()
    (tmp_path / "0.png").write_bytes(b"no image")
    with pytest.raises(InputError):
        export(replace(scene, image_files=tuple(paths)), tmp_path / "bad", "mcap")
