"""Exports of clips with views: every camera sees the object where its own images show it."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from getagrip.export import EXPORT_FORMATS, Scene, export
from getagrip.export.scene import StageFrame, _unique_names
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.io.images import read_mask
from helpers.views import GREY, LACKED, NAMES, write_viewed_clip

LIBRARIES = {"usd": "pxr", "mujoco": "mujoco", "lerobot": "pyarrow", "mcap": "mcap"}
"""Formats that need an extra, and a module of it."""


@pytest.fixture(scope="module")
def viewed(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    result, clip, _ = write_viewed_clip(tmp_path_factory.mktemp("views") / "clip")
    return Scene.of(result, clip)


def object_in_view(scene: Scene, name: str, n: int) -> np.ndarray:
    camera = next(one for one in scene.cameras if one.name == name)
    return se3.transform(se3.inverse(camera.T_cam_view[n]) @ scene.T_cam_obj[n], scene.object.vertices)


def test_cameras_are_those_of_the_clips_views_at_the_results_frames(tmp_path: Path) -> None:
    result, clip, _ = write_viewed_clip(tmp_path / "clip")
    some = Scene.of(result.take(np.array([LACKED, 2])), clip)
    assert [camera.name for camera in some.cameras] == ["camera", *NAMES]
    assert [path is None for path in some.views[-1].image_files] == [True, False]
    for view in some.views:
        shown = read_mask(tmp_path / "clip" / "views" / view.name / "masks" / "object" / "000002.png", view.size)
        rows, columns = np.nonzero(shown.unpacked)
        uv = project(view.K[1], object_in_view(some, view.name, 1))
        assert uv[:, 0].min() - 1.0 < columns.min() < columns.max() < uv[:, 0].max() + 1.0
        assert uv[:, 1].min() - 1.0 < rows.min() < rows.max() < uv[:, 1].max() + 1.0
    alone = Scene.of(result, replace(clip, folder=None))
    assert alone.views == ()
    assert "views" not in alone.about({})


def test_a_scene_in_a_view_is_the_same_scene(viewed: Scene) -> None:
    for view in viewed.views:
        seen = viewed.in_view(view)
        np.testing.assert_allclose(view.T_cam_view @ seen.T_cam_obj, viewed.T_cam_obj, atol=1e-12)
        np.testing.assert_allclose(np.array(seen.T_world_obj), np.array(viewed.T_world_obj), atol=1e-12)


def test_uneven_clips_are_resampled_with_their_cameras(viewed: Scene) -> None:
    moving = [view._replace(T_cam_view=view.T_cam_view @ viewed.T_cam_hand) for view in viewed.views]
    late = replace(viewed, views=tuple(moving), time=np.array([0.0, 0.1, 0.4]))
    even = late.even(10.0)
    assert len(even.frames) == 5
    for view, before in zip(even.views, moving, strict=True):
        np.testing.assert_allclose(view.T_cam_view[[0, 1, 4]], before.T_cam_view, atol=1e-9)
        assert view.image_files[-1] == before.image_files[-1]
        assert len(view.K) == len(view.image_files) == 5


def test_no_two_cameras_have_one_name() -> None:
    found = _unique_names(["camera", "si de", "si-de", "hand"], {"camera", "hand"})
    assert found == ["camera-view", "si-de", "si-de-view", "hand-view"]


@pytest.mark.parametrize("to", EXPORT_FORMATS)
@pytest.mark.slow
def test_every_format_says_what_its_files_hold(viewed: Scene, tmp_path: Path, to: str) -> None:
    if to in LIBRARIES:
        pytest.importorskip(LIBRARIES[to])
    folder = export(viewed, tmp_path / "out", to)
    about = json.loads((folder / "about.json").read_text())
    assert [*about["views"]] == [*NAMES]
    np.testing.assert_allclose(about["views"]["view3"]["T_cam_view"], viewed.views[1].T_cam_view)
    written = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} - {"about.json"}
    pairs = [(frame, f"{n:06d}") for n, frame in enumerate(viewed.frames)]
    named = {name.replace("<frame>", a).replace("<image>", b) for name in about["files"] for a, b in pairs}
    lacked = {f"rgb_view3/{LACKED:06d}.png"} if to == "bop" else set()
    suffixes = {name.removesuffix(".png").removesuffix(".jpg") for name in named - lacked}
    assert {name.removesuffix(".png").removesuffix(".jpg") for name in written} == suffixes


@pytest.mark.parametrize("with_world", [True, False])
def test_bop_has_a_scene_of_all_cameras(viewed: Scene, tmp_path: Path, with_world: bool) -> None:
    """Model to camera to world is the same by every camera, and masks are those of each."""
    folder = export(replace(viewed, world=viewed.world if with_world else None), tmp_path / "out", "bop")
    model = trimesh.load(folder / "models" / "obj_000001.ply", process=False)
    placed = []
    for suffix, name in (("", "camera"), *((f"_{name}", name) for name in NAMES)):
        poses, cameras, about = (
            json.loads((folder / f"{kind}{suffix}.json").read_text())
            for kind in ("scene_gt", "scene_camera", "scene_gt_info")
        )
        (pose,), camera = poses["2"], cameras["2"]
        posed = model.vertices @ np.reshape(pose["cam_R_m2c"], (3, 3)).T + pose["cam_t_m2c"]
        np.testing.assert_allclose(posed, 1e3 * object_in_view(viewed, name, 2), atol=1e-3)
        placed.append((posed - camera["cam_t_w2c"]) @ np.reshape(camera["cam_R_w2c"], (3, 3)))
        mask = cv2.imread(str(folder / f"mask_visib{suffix}" / "000002_000000.png"), cv2.IMREAD_UNCHANGED)
        assert np.count_nonzero(mask) == about["2"][0]["px_count_visib"] > 100
        shown = next((folder / f"rgb{suffix}").glob("000002.*"))
        assert cv2.imread(str(shown)).mean() == pytest.approx(GREY[name], abs=1.0)
    for one in placed[1:]:
        np.testing.assert_allclose(one, placed[0], atol=1e-3)
    assert len([*(folder / "rgb_view3").iterdir()]) == len(viewed.frames) - 1
    assert {path.name for path in folder.glob("camera*.json")} == {
        "camera.json",
        "camera_view2.json",
        "camera_view3.json",
    }


def test_views_of_bops_own_datasets_have_its_names(viewed: Scene, tmp_path: Path) -> None:
    named = replace(viewed, bop={"dataset": "hot3d", "split": "test-aria", "camera": "rgb"})
    folder = export(named, tmp_path / "out", "bop")
    names = {path.name for path in folder.iterdir()}
    assert {"scene_gt_rgb.json", "scene_gt_view2.json", "rgb", "view2", "mask_visib_view2", "camera.json"} <= names


def test_npz_has_the_cameras(viewed: Scene, tmp_path: Path) -> None:
    with np.load(export(viewed, tmp_path / "out", "npz") / "scene.npz") as file:
        assert file["views"].tolist() == [*NAMES]
        for k, view in enumerate(viewed.views):
            np.testing.assert_array_equal(file["T_cam_views"][k], view.T_cam_view)
            np.testing.assert_array_equal(file["K_views"][k], view.K)
            assert tuple(file["image_size_views"][k]) == view.size


def test_mcap_has_a_camera_for_each_view(viewed: Scene, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    topics: dict[str, list[dict[str, object]]] = {}
    with (export(viewed, tmp_path / "out", "mcap") / "scene.mcap").open("rb") as stream:
        for _, channel, message in reader.make_reader(stream).iter_messages():
            topics.setdefault(channel.topic, []).append(json.loads(message.data))
    for camera in viewed.cameras:
        images = topics[f"/{camera.name}/image"]
        assert len(images) == sum(path is not None for path in camera.image_files)
        assert base64.b64decode(str(images[0]["data"])) == Path(str(camera.image_files[0])).read_bytes()
        assert {one["frame_id"] for one in (*images, *topics[f"/{camera.name}/calibration"])} == {camera.name}
        assert topics[f"/{camera.name}/calibration"][0]["K"] == camera.K[0].ravel().tolist()
    tree = {one["child_frame_id"]: one for one in topics["/tf"][0]["transforms"]}  # type: ignore[attr-defined]
    for view in viewed.views:
        assert tree[view.name]["parent_frame_id"] == "camera"
        assert [*tree[view.name]["translation"].values()] == pytest.approx(view.T_cam_view[0, :3, 3].tolist())


def test_lerobot_has_a_video_for_each_camera_with_all_images(viewed: Scene, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    folder = export(viewed, tmp_path / "out", "lerobot")
    features = json.loads((folder / "meta" / "info.json").read_text())["features"]
    videos = [name for name, feature in features.items() if feature["dtype"] == "video"]
    assert videos == ["observation.images.camera", "observation.images.view2"]  # view3 lacks one
    for name in videos:
        assert (folder / "videos" / name / "chunk-000" / "file-000.mp4").is_file()
    rows = parquet.read_table(folder / "data" / "chunk-000" / "file-000.parquet")
    for camera in viewed.cameras:
        found = np.array(rows[f"K_{camera.name}"].to_pylist()).reshape(-1, 3, 3)
        np.testing.assert_allclose(found, camera.K, rtol=1e-6)
    for view in viewed.views:
        found = np.array(rows[f"T_cam_{view.name}"].to_pylist()).reshape(-1, 4, 4)
        np.testing.assert_allclose(found, view.T_cam_view, atol=1e-6)


def test_usd_cameras_see_the_object_where_the_views_do(viewed: Scene, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    odd = replace(viewed, views=tuple(viewed.views[0]._replace(name=name) for name in ("2nd-view", "2nd.view")))
    stage = Usd.Stage.Open(str(export(odd, tmp_path / "out", "usd") / "scene.usdc"))
    prim, _ = stage.GetPrimAtPath("/clip/views").GetChildren()
    frustum = UsdGeom.Camera(prim).GetCamera(stage.GetStartTimeCode()).frustum
    on_stage = se3.transform(StageFrame.of(odd).poses(odd)[0][0], odd.object.vertices)
    seen = np.c_[on_stage, np.ones(len(on_stage))] @ np.array(
        frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    )
    (width, height), ndc = odd.views[0].size, seen[:, :2] / seen[:, 3:]
    uv = np.stack([(ndc[:, 0] + 1.0) / 2.0 * width, (1.0 - ndc[:, 1]) / 2.0 * height], axis=1)
    np.testing.assert_allclose(uv, project(odd.views[0].K[0], object_in_view(viewed, "view2", 0)), atol=1e-3)


@pytest.mark.slow
def test_mujoco_has_a_camera_for_each_view(viewed: Scene, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(export(viewed, tmp_path / "out", "mujoco") / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 2)
    mujoco.mj_forward(model, data)
    for view in viewed.views:
        T = StageFrame.of(viewed).T_stage_cam[2] @ view.T_cam_view[2]
        camera = data.camera(view.name)
        np.testing.assert_allclose(camera.xpos, T[:3, 3], atol=1e-6)
        np.testing.assert_allclose(camera.xmat.reshape(3, 3), T[:3, :3] @ np.diag([1.0, -1.0, -1.0]), atol=1e-6)
