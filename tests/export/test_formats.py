"""Exports: what is read back, by other libraries, is the scene that was written."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from numpy import ndarray
from pygltflib import GLTF2
from scipy.spatial.transform import Rotation

from getagrip.cli import main
from getagrip.clip import World, input_sha256, read_clip
from getagrip.errors import UsageError
from getagrip.export import EXPORT_FORMATS, Scene, export
from getagrip.export.bop import image_ids
from getagrip.export.scene import StageFrame
from getagrip.geometry import se3
from getagrip.geometry.mesh_files.colours import parse_colours
from getagrip.result import write_result
from getagrip.result.findings import Finding, Probability
from helpers.environment import Run
from helpers.results import result_and_clip

LIBRARIES = {"usd": "pxr", "mujoco": "mujoco", "lerobot": "pyarrow", "mcap": "mcap"}
"""Formats that need an extra, and a module of it."""


def need(to: str) -> None:
    """Skip where the library of a format is absent."""
    if to in LIBRARIES:
        pytest.importorskip(LIBRARIES[to], reason=f"{LIBRARIES[to]} is not installed: pip install -e '.[{to}]'")


def rows_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def object_in_camera(scene: Scene) -> ndarray:
    return se3.transform(scene.T_cam_obj, scene.object.vertices[None])


def test_the_scene_is_that_of_the_result(scene: Scene) -> None:
    result, clip = result_and_clip()
    np.testing.assert_allclose(scene.T_cam_obj, clip.hand.T_cam_hand[2:] @ result.T_hand_obj)
    np.testing.assert_allclose(scene.object.vertices, 1.25 * clip.mesh.vertices)
    np.testing.assert_allclose(scene.time, clip.times[2:])
    np.testing.assert_allclose(scene.T_world_obj, clip.world.T_world_cam[2:] @ scene.T_cam_obj)
    np.testing.assert_array_equal(scene.hand_vertices, clip.hand.vertices[2:])


@pytest.mark.parametrize("to", EXPORT_FORMATS)
@pytest.mark.slow
def test_every_format_says_what_its_files_hold(scene: Scene, tmp_path: Path, to: str) -> None:
    need(to)
    folder = export(scene, tmp_path / "out", to)
    about = json.loads((folder / "about.json").read_text())
    assert about["format"] == to
    assert about["notes"] == ["the scale is a guess"]
    assert len(about["time_s"]) == len(about["frames"]) == 3
    written = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} - {"about.json"}
    images = [f"{image:06d}" for image in image_ids(scene.frames)]
    pairs = [*zip(scene.frames, images, strict=True)]
    named = {name.replace("<frame>", a).replace("<image>", b) for name in about["files"] for a, b in pairs}
    assert written == named
    assert all("mm" in words or "metres" in words or "intrinsics" in words or "same" in words
               for words in about["files"].values())  # fmt: skip
    with pytest.raises(UsageError, match="exists already"):
        export(scene, folder, to)
    assert export(scene, folder, to, overwrite=True) == folder


def test_csv_rows_are_the_poses(scene: Scene, tmp_path: Path) -> None:
    rows = rows_of(export(scene, tmp_path / "out", "csv") / "poses.csv")
    for name, T in (("T_cam_obj", scene.T_cam_obj), ("T_hand_obj", scene.T_hand_obj)):
        place = np.array([[float(row[f"{name}_{axis}_m"]) for axis in "xyz"] for row in rows])
        q = np.array([[float(row[f"{name}_q{axis}"]) for axis in "xyzw"] for row in rows])
        np.testing.assert_allclose(place, T[:, :3, 3], atol=1e-8)
        np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), T[:, :3, :3], atol=1e-7)
    assert [row["frame"] for row in rows] == list(scene.frames)
    assert [float(row["angle_deg"]) for row in rows] == pytest.approx(np.degrees([0.0, 0.1, 0.2]))
    free = export(replace(scene, angle=None), tmp_path / "free", "csv") / "poses.csv"
    assert [row["angle_deg"] for row in rows_of(free)] == ["", "", ""]


def test_npz_arrays_are_the_scene(scene: Scene, tmp_path: Path) -> None:
    with np.load(export(scene, tmp_path / "out", "npz") / "scene.npz") as file:
        np.testing.assert_array_equal(file["T_cam_obj"], scene.T_cam_obj)
        np.testing.assert_array_equal(file["hand_vertices_cam"], scene.hand_in_camera)
        np.testing.assert_array_equal(file["object_vertices"], scene.object.vertices)


def test_obj_meshes_are_posed(scene: Scene, tmp_path: Path) -> None:
    folder = export(scene, str(tmp_path / "out"), "obj")
    for n, frame in enumerate(scene.frames):
        found = trimesh.load(folder / "object" / f"{frame}.obj", process=False)
        np.testing.assert_allclose(found.vertices, object_in_camera(scene)[n], atol=1e-6)
        hand = trimesh.load(folder / "hand" / f"{frame}.obj", process=False)
        np.testing.assert_allclose(hand.vertices, scene.hand_in_camera[n], atol=1e-6)


def test_bop_poses_bring_the_model_into_the_camera(scene: Scene, tmp_path: Path) -> None:
    folder = export(replace(scene, name="a_b-c"), tmp_path / "out", "bop")
    model = trimesh.load(folder / "models" / "obj_000001.ply", process=False)
    (file,) = folder.glob("*.csv")
    method, rest = file.stem.split("_")  # METHOD_DATASET-SPLIT: the toolkit parts names at underscores, then hyphens
    assert (method, rest.split("-")) == ("getagrip-soft-hinge", ["abc", "test"])
    given = json.loads((folder / "scene_gt.json").read_text())
    for n, row in enumerate(rows_of(file)):
        R, t = (np.array(row[key].split(), dtype=float) for key in ("R", "t"))
        posed = model.vertices @ R.reshape(3, 3).T + t
        np.testing.assert_allclose(posed, 1e3 * object_in_camera(scene)[n], atol=1e-3)
        (entry,) = given[row["im_id"]]
        np.testing.assert_allclose(entry["cam_R_m2c"], R, atol=1e-8)
        np.testing.assert_allclose(entry["cam_t_m2c"], t, atol=1e-6)
        camera = json.loads((folder / "scene_camera.json").read_text())[row["im_id"]]
        T_cam_world = se3.rigid(np.reshape(camera["cam_R_w2c"], (3, 3)), np.array(camera["cam_t_w2c"]) / 1e3)
        np.testing.assert_allclose(T_cam_world @ scene.T_world_obj[n], scene.T_cam_obj[n], atol=1e-12)
    info = json.loads((folder / "models" / "models_info.json").read_text())["1"]
    assert info["size_x"] == pytest.approx(1.25 * 50.0)
    assert info["diameter"] == pytest.approx(1e3 * scene.object.diameter)
    assert image_ids(("000007", "000012")) == [7, 12]
    assert image_ids(("7", "007")) == image_ids(("a", "b")) == [0, 1]


def test_bop_folders_have_all_files_of_a_scene_as_bop_describes_them(scene: Scene, tmp_path: Path) -> None:
    """Read by the names and keys of BOP's description of its format, images of eight bits."""
    width, height = scene.size
    K = scene.K.copy()
    K[1, 0, 2] -= 0.5 * width  # the object is partly beside the second image
    picture = tmp_path / "picture.png"
    cv2.imwrite(str(picture), np.full((height, width, 3), 7, np.uint8))
    folder = export(replace(scene, K=K, image_files=(picture,) * 3), tmp_path / "out", "bop")
    (poses, information, cameras, camera, models) = (
        json.loads((folder / name).read_text())
        for name in (
            "scene_gt.json",
            "scene_gt_info.json",
            "scene_camera.json",
            "camera.json",
            "models/models_info.json",
        )
    )
    assert camera.keys() == {"cx", "cy", "depth_scale", "fx", "fy", "height", "width"}
    assert (camera["width"], camera["height"]) == scene.size
    assert poses.keys() == information.keys() == cameras.keys()
    for n, image in enumerate(poses):
        (about,) = information[image]
        whole, seen = (
            cv2.imread(str(folder / kind / f"{int(image):06d}_000000.png"), cv2.IMREAD_UNCHANGED)
            for kind in ("mask", "mask_visib")
        )
        assert whole.shape == seen.shape == cv2.imread(str(folder / "rgb" / f"{int(image):06d}.png")).shape[:2]
        assert {*np.unique(whole), *np.unique(seen)} <= {0, 255}
        assert not (seen > whole).any()
        assert about.keys() == {
            "bbox_obj", "bbox_visib", "px_count_all", "px_count_valid", "px_count_visib", "visib_fract"
        }  # fmt: skip
        assert about["px_count_visib"] == np.count_nonzero(seen)
        assert about["visib_fract"] == about["px_count_visib"] / about["px_count_all"]
        assert (about["px_count_all"] > np.count_nonzero(whole)) == (n == 1)
        (_, _, w, h), (left, top, seen_w, seen_h) = about["bbox_obj"], about["bbox_visib"]
        assert w >= seen_w
        assert h >= seen_h
        assert (left, top, seen_w, seen_h) == cv2.boundingRect(seen)
        corners = object_in_camera(scene)[n] @ K[n].T
        uv = corners[:, :2] / corners[:, 2:]
        np.testing.assert_allclose(about["bbox_obj"][:2], uv.min(axis=0), atol=1.0)
        np.testing.assert_allclose((w, h), np.ptp(uv, axis=0), atol=2.0)
    mesh = trimesh.load(folder / "models" / "obj_000001.ply", process=False)
    np.testing.assert_allclose(
        [models["1"][f"size_{axis}"] for axis in "xyz"], np.ptp(mesh.vertices, axis=0), rtol=1e-5
    )


@pytest.mark.parametrize(
    ("split", "camera", "ground_truth"),
    [("test-aria", "rgb", "scene_gt_rgb.json"), ("test-quest3", "gray1", "scene_gt_gray1.json")],
)
def test_clips_of_hot3d_have_the_names_of_bop(
    scene: Scene, tmp_path: Path, split: str, camera: str, ground_truth: str
) -> None:
    scene = replace(scene, bop={"dataset": "hot3d", "split": split, "camera": camera})
    folder = export(scene, tmp_path / "out", "bop")
    assert (folder / f"getagrip-soft-hinge_hot3d-{split}.csv").is_file()
    assert (folder / ground_truth).is_file()


@pytest.mark.parametrize("to", EXPORT_FORMATS)
def test_no_name_leads_out_of_the_folder(scene: Scene, tmp_path: Path, to: str) -> None:
    """Names come from files of strangers, or from anybody's Python."""
    need(to)
    hostile = replace(scene, name='../../a"<b>&/c\n', method="../m", frames=("../1", "/2", "a\0"), category='<&>"')
    folder = export(hostile, tmp_path / "in" / to, to)
    assert (folder / "about.json").is_file()
    assert {path.name for path in tmp_path.iterdir()} == {"in"}
    assert {path.name for path in (tmp_path / "in").iterdir()} == {to}


def test_what_is_known_stands_beside_every_format(scene: Scene, tmp_path: Path) -> None:
    about = json.loads((export(scene, tmp_path / "out", "obj") / "about.json").read_text())
    assert about["frame_kind"] == ["sampled", "fitted", "interpolated"]
    np.testing.assert_allclose(about["time_s"], [7.2, 7.3, 7.5])
    assert {*about["poses"]} == {"T_cam_obj", "T_hand_obj", "T_cam_hand", "T_world_cam", "T_world_obj", "T_world_hand"}
    for name, T in scene.poses.items():
        np.testing.assert_allclose(about["poses"][name], T)
    np.testing.assert_allclose(about["joints_cam"], scene.joints_in_camera)
    alone = replace(scene, world=None, joints=None)
    about = json.loads((export(alone, tmp_path / "alone", "csv") / "about.json").read_text())
    assert {*about["poses"]} == {"T_cam_obj", "T_hand_obj", "T_cam_hand"}
    assert (about["joints_cam"], about["world_up"]) == (None, None)
    assert {path.name for path in (tmp_path / "alone").iterdir()} == {"about.json", "poses.csv"}


def test_a_stage_is_the_world_turned_up(scene: Scene) -> None:
    assert scene.world is not None
    stage = StageFrame.of(scene)
    turn = stage.T_stage_cam @ se3.inverse(scene.world.T_world_cam)
    np.testing.assert_allclose(turn, turn[:1].repeat(3, axis=0), atol=1e-12)  # one rotation for all frames
    np.testing.assert_allclose(turn[0, :3, :3] @ scene.world.up, [0.0, 0.0, 1.0], atol=1e-12)
    assert "guess" not in stage.words
    T_stage_obj, T_stage_hand = stage.poses(scene)
    np.testing.assert_allclose(se3.inverse(T_stage_hand) @ T_stage_obj, scene.T_hand_obj, atol=1e-12)
    for up in ([0.0, 0.0, 1.0], [0.0, 0.0, -1.0]):
        other = StageFrame.of(replace(scene, world=World(scene.world.T_world_cam, np.array(up))))
        back = other.T_stage_cam[0] @ se3.inverse(scene.world.T_world_cam[0])
        assert se3.is_rigid(back)
        np.testing.assert_allclose(back[:3, :3] @ up, [0.0, 0.0, 1.0], atol=1e-12)


def test_what_is_not_known_of_a_stage_is_a_guess(scene: Scene) -> None:
    still = StageFrame.of(replace(scene, world=None))
    assert "guess" in still.words
    np.testing.assert_allclose(still.T_stage_cam[:, :3, :3] @ [0.0, -1.0, 0.0], [[0.0, 0.0, 1.0]] * 3, atol=1e-12)
    assert scene.world is not None
    level = StageFrame.of(replace(scene, world=World(scene.world.T_world_cam)))
    assert "guess" in level.words
    np.testing.assert_allclose(level.T_stage_cam[0, :3, :3] @ [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], atol=1e-12)


def accessor(gltf: GLTF2, which: int) -> ndarray:
    it = gltf.accessors[which]
    view = gltf.bufferViews[it.bufferView]
    kind = {5126: np.float32, 5125: np.uint32}[it.componentType]
    content = gltf.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    return np.frombuffer(content, kind).reshape(it.count, {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[it.type])


def test_the_other_hand_stands_in_its_own_frames(both: Scene, tmp_path: Path) -> None:
    other = both.hands[1]
    for to in ("csv", "npz", "obj", "glb"):
        about = json.loads((export(both, tmp_path / to, to) / "about.json").read_text())
        assert about["other_hand"]["known"] == [True, False, True]
    rows = rows_of(tmp_path / "csv" / "poses.csv")
    assert [row["T_cam_other_hand_x_m"] for row in rows][1] == ""
    assert float(rows[2]["T_cam_other_hand_x_m"]) == pytest.approx(other.T_cam_hand[2, 0, 3])
    assert [row["frame"] for row in rows_of(tmp_path / "csv" / "other_joints.csv")] == [both.frames[0], both.frames[2]]
    with np.load(tmp_path / "npz" / "scene.npz") as file:
        np.testing.assert_array_equal(file["other_hand_vertices_cam"], other.in_camera)
    meshes = sorted((tmp_path / "obj" / "other_hand").iterdir())
    assert [path.stem for path in meshes] == [both.frames[0], both.frames[2]]
    found = trimesh.load(meshes[1], process=False)
    np.testing.assert_allclose(found.vertices, other.in_camera[2], atol=1e-6)
    gltf = GLTF2().load(tmp_path / "glb" / "scene.glb")
    assert [node.name for node in gltf.nodes] == ["camera frame", "object", "hand", "other_hand"]
    (scale,) = (it.sampler for it in gltf.animations[0].channels if it.target.path == "scale")
    assert gltf.animations[0].samplers[scale].interpolation == "STEP"
    np.testing.assert_array_equal(accessor(gltf, gltf.animations[0].samplers[scale].output)[:, 0], [1.0, 0.0, 1.0])


def test_an_object_keeps_its_own_colours(scene: Scene, tmp_path: Path) -> None:
    """In glTF they are intensities of light, of which sRGB's 188 is half."""
    colours = np.tile(np.array([255, 188, 0], np.uint8), (len(scene.object.vertices), 1))
    painted = replace(scene, object=replace(scene.object, colours=colours))
    gltf = GLTF2().load(export(painted, tmp_path / "glb", "glb") / "scene.glb")
    own, hand = (gltf.meshes[n].primitives[0] for n in (0, 1))
    linear = np.tile([1.0, 0.5, 0.0], (len(colours), 1))
    np.testing.assert_allclose(accessor(gltf, own.attributes.COLOR_0), linear, atol=5e-3)
    assert gltf.materials[own.material].pbrMetallicRoughness.baseColorFactor == [1.0, 1.0, 1.0, 1.0]
    assert hand.attributes.COLOR_0 is None
    model = parse_colours(next((export(painted, tmp_path / "bop", "bop") / "models").glob("*.ply")))
    assert model is not None
    np.testing.assert_array_equal(model.colours, colours)


def test_times_of_the_animation_rise_where_single_precision_does_not(both: Scene, tmp_path: Path) -> None:
    scene = replace(both, time=np.array([0.0, 86_000.0, 86_000.001]))
    gltf = GLTF2().load(export(scene, tmp_path / "out", "glb") / "scene.glb")
    time = accessor(gltf, gltf.animations[0].samplers[0].input)[:, 0]
    assert (np.diff(time) > 0.0).all()
    np.testing.assert_allclose(time, scene.time, atol=0.01)


@pytest.mark.parametrize("stiff", [False, True])
def test_the_animation_goes_through_every_pose(both: Scene, tmp_path: Path, stiff: bool) -> None:
    if stiff:
        scene = replace(both, hand_vertices=np.repeat(both.hand_vertices[:1], 3, axis=0))
    else:
        scene = replace(both, hand_vertices=both.hand_vertices * np.array([1.0, 1.1, 1.2])[:, None, None])
    file = export(scene, tmp_path / "out", "glb") / "scene.glb"
    gltf = GLTF2().load(file)
    channels = {(it.target.node, it.target.path): it.sampler for it in gltf.animations[0].channels}

    def values(node: int, path: str) -> ndarray:
        return accessor(gltf, gltf.animations[0].samplers[channels[node, path]].output)

    time = accessor(gltf, gltf.animations[0].samplers[0].input)[:, 0]
    np.testing.assert_allclose(time, scene.time - scene.time[0], atol=1e-6)
    flip = np.diag([1.0, -1.0, -1.0])  # glTF's y is up
    np.testing.assert_allclose(Rotation.from_quat(gltf.nodes[0].rotation).as_matrix(), flip, atol=1e-12)
    moving = (object_in_camera(scene), *(hand.in_camera for hand in scene.hands))
    for node, true in enumerate(moving, start=1):
        part = gltf.meshes[gltf.nodes[node].mesh].primitives[0]
        rest = accessor(gltf, part.attributes.POSITION).astype(float)
        q, t = values(node, "rotation"), values(node, "translation")
        assert (np.sum(q[1:] * q[:-1], axis=1) > 0.0).all()  # the short way from one to the next
        targets = [accessor(gltf, target["POSITION"]) for target in part.targets or []]
        assert len(targets) == (0, 0 if stiff else 3, 3)[node - 1]
        weights = values(node, "weights").reshape(3, 3) if targets else np.zeros((3, 0))
        for n in range(3):
            bent = rest + sum(w * step for w, step in zip(weights[n], targets, strict=True))
            posed = bent @ Rotation.from_quat(q[n]).as_matrix().T + t[n]
            np.testing.assert_allclose(posed, true[n], atol=1e-6)
    assert set(trimesh.load(file).geometry) == {"object", "hand", "other_hand"}


@pytest.mark.slow
def test_the_command_exports_results_and_names_what_it_cannot(clip_folder: Path, tmp_path: Path, run: Run) -> None:
    result, _ = result_and_clip()
    result = replace(result, frames=read_clip(clip_folder).frames)  # three, of the small clip
    write_result(result, tmp_path / "results" / "one", input_sha256(clip_folder), {}, clip_folder)
    status, printed, _ = run("export", tmp_path / "results", "--to", "csv")
    assert (status, printed.strip()) == (0, str(tmp_path / "results" / "one" / "export-csv"))
    status, _, err = run("export", tmp_path / "results", "--to", "csv")
    assert (status, "exists already" in err) == (1, True)
    assert run("export", tmp_path / "results", "--to", "csv", "--overwrite")[0] == 0
    assert run("export", tmp_path / "results", "--to", "npz", "--out", tmp_path / "out")[0] == 0
    assert (tmp_path / "out" / "one" / "scene.npz").is_file()
    assert main(["export", str(tmp_path / "nothing"), "--to", "csv"]) == 1
    status, _, err = run("export", tmp_path / "results", "--to", "pdf")
    assert (status, all(name in err for name in EXPORT_FORMATS)) == (2, True)
    assert all(f"{name}:" in run("export", "--help")[1] for name in EXPORT_FORMATS)


def test_what_does_not_look_right_is_flagged_and_can_be_left_out(clip_folder: Path, tmp_path: Path, run: Run) -> None:
    result, _ = result_and_clip()
    serious = Finding("hand-size", True, 2.0, 1.0, "too large")
    kinds: dict[str, dict[str, Any]] = {
        "right": {"probability_right": Probability(0.95, "")},
        "uncertain": {"probability_right": None},
        "wrong": {"probability_right": Probability(0.95, ""), "findings": (serious,)},
    }
    for name, about in kinds.items():
        one = replace(result, frames=read_clip(clip_folder).frames, **{"findings": (), **about})
        write_result(one, tmp_path / "results" / name, input_sha256(clip_folder), {}, clip_folder)
    every, some = tmp_path / "every", tmp_path / "some"
    status, _, err = run("export", tmp_path / "results", "--to", "csv", "--out", every)
    assert status == 0
    assert "is uncertain" in err
    assert "looks wrong, with 1 serious finding" in err
    for name in kinds:
        assert json.loads((every / name / "about.json").read_text())["verdict"] == name
    assert json.loads((every / "wrong" / "about.json").read_text())["findings_serious"] == 1
    status, _, err = run("export", tmp_path / "results", "--to", "csv", "--out", some, "--only-right")
    assert (status, err.count("left out")) == (0, 2)
    assert [path.name for path in some.iterdir()] == ["right"]
    _, _, err = run("export", tmp_path / "results" / "wrong", "--to", "csv", "--out", every, "--only-right")
    assert f"an earlier export stays in {every / 'wrong'}" in err
    (every / "uncertain" / "about.json").unlink()  # no export: a folder of somebody's
    _, _, err = run("export", tmp_path / "results", "--to", "csv", "--out", every, "--only-right", "--overwrite")
    assert "left out; an earlier export is removed" in err
    assert {path.name for path in every.iterdir()} == {"right", "uncertain"}
    assert (every / "uncertain" / "poses.csv").is_file()


def test_uneven_frames_are_resampled(scene: Scene, capsys: pytest.CaptureFixture[str]) -> None:
    """Poses are on the path between the frames, and no time is lost; even frames stay as they are."""
    even = replace(scene, time=np.array([0.0, 0.101, 0.199]))
    assert even.even(10.0) is even
    assert capsys.readouterr().err == ""
    uneven = replace(scene, time=np.array([0.0, 0.1, 0.5]))
    made = uneven.even(10.0)
    np.testing.assert_allclose(made.time, np.arange(6) / 10.0)
    np.testing.assert_allclose(made.T_cam_hand[[0, 1, 5]], scene.T_cam_hand, atol=1e-9)
    middle = made.T_cam_hand[3, :3, 3]
    np.testing.assert_allclose(middle, scene.T_cam_hand[1:, :3, 3].mean(axis=0), atol=1e-9)
    assert made.frame_kind[2:5] == ("interpolated",) * 3
    assert "up to 300 ms off 10 a second" in capsys.readouterr().err
