"""Meshes of another system, one per frame: known answers, unknown metrics, and invalid meshes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.clip import Clip, Masks, input_sha256, write_clip
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import write_mesh
from getagrip.metrics.contact import mesh_distances, pairwise_iou, stable_contact_area
from getagrip.metrics.evaluate import evaluate, evaluate_meshes
from getagrip.metrics.evaluate.external import MeshFrame, read_meshes
from getagrip.result import write_result
from helpers.environment import Run
from helpers.scenes import perfect, same, written

NAME = "egg-and-mug"


def true_meshes(clip: Clip, frame: MeshFrame = "hand") -> list[Mesh | None]:
    T = clip.truth.T_cam_obj if frame == "camera" else se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    return [Mesh(se3.transform(pose, clip.mesh.vertices), clip.mesh.faces) for pose in T]


def anew(meshes: list[Mesh | None]) -> list[Mesh | None]:
    """The same surfaces, each cut into other triangles."""
    out: list[Mesh | None] = []
    for n, mesh in enumerate(meshes):
        chosen = np.arange(n, len(mesh.faces), 7)
        vertices, faces = trimesh.remesh.subdivide(mesh.vertices, mesh.faces, chosen)
        out.append(Mesh(np.asarray(vertices), np.asarray(faces)))
    return out


def write(meshes: list[Mesh | None], clip: Clip, folder: Path, suffix: str = ".obj") -> Path:
    folder.mkdir(parents=True)
    for name, mesh in zip(clip.frames, meshes, strict=True):
        if mesh is not None:
            write_mesh(mesh, folder / f"{name}{suffix}")
    return folder


@pytest.mark.slow
def test_the_true_mesh_in_every_frame_scores_as_the_truth(scene: tuple[Clip, Masks]) -> None:
    clip, masks = scene
    ours = evaluate(perfect(clip), clip, masks)
    theirs = evaluate_meshes(true_meshes(clip), clip, masks, "theirs")
    shared = [key for key in ours.metrics if key in theirs.metrics]
    assert {"iou", "iou_full", "sca_object_0mm", "sca_area_5mm", "sca_iou_80_hand_10mm"} <= {*shared}
    same({key: theirs.metrics[key] for key in shared}, {key: ours.metrics[key] for key in shared})
    for key, value in theirs.metrics.items():
        if key.startswith("truth_"):
            assert theirs.metrics[key.removeprefix("truth_")] == pytest.approx(value, abs=1e-6)
    assert theirs.metrics["frames_without_mesh"] == 0.0
    assert theirs.metrics["closed"] == 1.0
    assert not any("add" in key for key in theirs.metrics)


@pytest.mark.parametrize("frame", ["camera", "hand"])
@pytest.mark.parametrize("suffix", [".obj", ".ply"])
@pytest.mark.slow
def test_files_in_either_frame_say_the_same(
    scene: tuple[Clip, Masks], tmp_path: Path, frame: MeshFrame, suffix: str
) -> None:
    clip, masks = scene
    folder = write(true_meshes(clip, frame), clip, tmp_path / "meshes", suffix)
    meshes, errors = read_meshes(folder, clip, frame)
    assert errors == []
    expected = evaluate_meshes(true_meshes(clip), clip, masks, "").metrics
    same(evaluate_meshes(meshes, clip, masks, "").metrics, expected, 1e-3)


@pytest.mark.slow
def test_new_meshes_in_every_frame_are_compared_by_the_hand_s_points_only(scene: tuple[Clip, Masks]) -> None:
    clip, masks = scene
    metrics = evaluate_meshes(anew(true_meshes(clip)), clip, masks, "").metrics
    for mm in (0, 5, 10):
        assert metrics[f"sca_hand_{mm}mm"] == pytest.approx(metrics[f"truth_sca_hand_{mm}mm"], abs=1e-9)
        assert f"sca_iou_60_hand_{mm}mm" in metrics
    assert not any(key.startswith(("sca_object", "sca_area", "sca_iou_80_object")) for key in metrics)
    assert metrics["penetration_hand_mm"] == pytest.approx(metrics["truth_penetration_hand_mm"], abs=1e-6)
    assert metrics["penetration_object_mm"] >= metrics["truth_penetration_object_mm"] - 1e-6  # it has more vertices
    assert metrics["iou_full"] == 1.0


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_the_order_of_vertices_and_faces_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hand = trimesh.creation.icosphere(subdivisions=2, radius=0.04)
    box = trimesh.creation.box(extents=[0.05, 0.06, 0.07])
    centres = rng.uniform(-0.04, 0.04, (3, 3))
    meshes = [Mesh(np.asarray(box.vertices) + centre, np.asarray(box.faces)) for centre in centres]
    shuffled = []
    for mesh in meshes:
        order = rng.permutation(len(mesh.vertices))
        faces = np.argsort(order)[mesh.faces][rng.permutation(len(mesh.faces))]
        shuffled.append(Mesh(mesh.vertices[order], faces))
    hands = np.tile(np.asarray(hand.vertices), (3, 1, 1))
    one, other = (mesh_distances(given, hands, np.asarray(hand.faces))[0] for given in (meshes, shuffled))
    np.testing.assert_allclose(one.hand, other.hand, atol=1e-9)
    np.testing.assert_allclose(one.depth("object").max(axis=1), other.depth("object").max(axis=1), atol=1e-9)


@pytest.mark.slow
def test_a_frame_without_a_mesh_shows_nothing_and_touches_nothing(scene: tuple[Clip, Masks]) -> None:
    clip, masks = scene
    meshes = true_meshes(clip)
    whole = evaluate_meshes(meshes, clip, masks, "")
    meshes[2] = None
    out = evaluate_meshes(meshes, clip, masks, "")
    assert out.metrics["frames_without_mesh"] == 1.0
    assert out.per_frame["iou_full"] == [1.0, 1.0, 0.0, 1.0, 1.0]
    assert out.metrics["iou_full"] == pytest.approx(0.8)
    distances, _ = mesh_distances(true_meshes(clip), clip.hand.vertices, clip.hand.faces)
    contact = distances.contact("hand", 0.005)
    contact[2] = False
    assert out.metrics["sca_hand_5mm"] == pytest.approx(stable_contact_area(pairwise_iou(contact)))
    depths = np.array(whole.per_frame["penetration_hand_mm"])
    assert np.isnan(out.per_frame["penetration_hand_mm"][2])
    assert out.metrics["penetration_hand_mm"] == pytest.approx(np.delete(depths, 2).mean())
    nothing = evaluate_meshes([None] * len(clip), clip, masks, "").metrics
    assert (nothing["iou"], nothing["sca_hand_10mm"], nothing["frames_without_mesh"]) == (0.0, 0.0, len(clip))
    assert "penetration_hand_mm" not in nothing


@pytest.mark.slow
def test_beside_our_results(scene: tuple[Clip, Masks], tmp_path: Path, run: Run) -> None:
    clip, _ = scene
    folder, result = written(scene, tmp_path)
    write(anew(true_meshes(clip, "camera")), clip, tmp_path / "theirs" / NAME)
    call = ("evaluate", result, "--clips", folder.parent, "--meshes", tmp_path / "theirs", "--mesh-frame", "camera")
    status, out, err = run(*call, "--json", tmp_path / "all.json")
    assert (status, err) == (0, "")
    assert "theirs" in out
    assert "static" in out
    content = json.loads((tmp_path / "all.json").read_text())
    ours, theirs = content["samples"]
    assert (ours["method"], theirs["method"]) == ("static", "theirs")
    assert theirs["metrics"]["sca_hand_5mm"] == pytest.approx(ours["metrics"]["sca_hand_5mm"], abs=1e-3)
    assert content["methods"]["theirs"]["clips"]["iou"] == 1


@pytest.mark.slow
def test_only_the_frames_of_our_result_count_where_there_is_one(
    scene: tuple[Clip, Masks], tmp_path: Path, run: Run
) -> None:
    clip, _ = scene
    folder = write_clip(*scene, tmp_path / "clips" / NAME)
    some = np.array([1, 3])
    result = write_result(perfect(clip.take(some)), tmp_path / "results" / NAME, input_sha256(folder))
    meshes = [mesh if n in some else None for n, mesh in enumerate(true_meshes(clip))]
    write(meshes, clip, tmp_path / "theirs")
    call = ("--clips", folder, "--meshes", tmp_path / "theirs", "--mesh-frame", "hand", "--json", tmp_path / "a.json")
    for results, missing in (((result,), 0.0), ((), 3.0)):
        assert run("evaluate", *results, *call)[0] == 0
        theirs = json.loads((tmp_path / "a.json").read_text())["samples"][-1]
        assert theirs["metrics"]["frames_without_mesh"] == missing


@pytest.mark.slow
def test_bad_meshes_are_named_and_the_rest_is_done(scene: tuple[Clip, Masks], tmp_path: Path, run: Run) -> None:
    clip, _ = scene
    folder = write_clip(*scene, tmp_path / "clips" / NAME)
    theirs = write(true_meshes(clip), clip, tmp_path / "theirs" / NAME, ".ply")
    other = tmp_path / "theirs" / "no-such-clip"
    other.mkdir()
    content = (theirs / "000001.ply").read_bytes()
    (theirs / "000001.ply").write_bytes(content[: len(content) // 2])
    (theirs / "000002.ply").unlink()
    (theirs / "000002.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    call = ("--clips", folder.parent, "--meshes", tmp_path / "theirs", "--mesh-frame", "hand", "--json", tmp_path / "j")
    status, out, err = run("evaluate", *call)
    assert status == 1
    assert NAME in out
    assert len(err.splitlines()) == 4
    assert all(name in err for name in ("000001.ply", "000002.obj", "no-such-clip", "no mesh of 2 of 5 frames"))
    (made,) = json.loads((tmp_path / "j").read_text())["samples"]
    assert made["metrics"]["frames_without_mesh"] == 2.0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "no faces"),
        ("v 0 0 0\nf 1 2 3\n", "000002.obj"),
        ("v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\n", "millimetres"),
        ("v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nf 1 2 3\n", "no faces"),
        ("v 5 0 0\nv 5.1 0 0\nv 5 0.1 0\nf 1 2 3\n", "camera frame"),
        ("v 0 0 0\nv 0.1 0 0\nv 0 1e400 0\nf 1 2 3\n", "000002.obj"),
    ],
)
def test_implausible_meshes_are_reported(scene: tuple[Clip, Masks], tmp_path: Path, content: str, words: str) -> None:
    clip, _ = scene
    folder = write(true_meshes(clip), clip, tmp_path / "meshes")
    (folder / "000002.obj").write_text(content)
    meshes, (error,) = read_meshes(folder, clip, "hand")
    assert words in str(error)
    assert [mesh is None for mesh in meshes] == [False, False, True, False, False]


def test_meshes_that_are_all_in_the_other_frame_are_one_error(
    scene: tuple[Clip, Masks], tmp_path: Path, refused: Callable[..., str]
) -> None:
    clip, _ = scene
    folder = write(true_meshes(clip, "hand"), clip, tmp_path / "hand")
    refused(lambda: read_meshes(folder, clip, "camera"), "000000.obj", "is it in the hand frame?")


def test_faces_without_area_are_passed_over(scene: tuple[Clip, Masks], tmp_path: Path) -> None:
    clip, _ = scene
    folder = write(true_meshes(clip), clip, tmp_path / "meshes")
    with (folder / "000003.obj").open("a") as file:
        file.write("f 1 1 2\n")
    meshes, errors = read_meshes(folder, clip, "hand")
    assert errors == []
    assert meshes[3] is not None
    assert len(meshes[3].faces) == len(clip.mesh.faces)


def test_folders_without_frames_are_reported(
    scene: tuple[Clip, Masks], tmp_path: Path, refused: Callable[..., str]
) -> None:
    clip, _ = scene
    folder = write(true_meshes(clip), clip, tmp_path / "meshes")
    write_mesh(clip.mesh, folder / "frame_2.obj")
    _, errors = read_meshes(folder, clip, "hand")
    assert "another mesh" in str(errors[0])
    (tmp_path / "empty").mkdir()
    write_mesh(clip.mesh, tmp_path / "empty" / "mug.obj")
    refused(lambda: read_meshes(tmp_path / "empty", clip, "hand"), "no mesh named like a frame", "000000.obj")


@pytest.mark.slow
def test_wrong_calls(scene: tuple[Clip, Masks], tmp_path: Path, run: Run) -> None:
    folder = write_clip(*scene, tmp_path / "clips" / NAME)
    (tmp_path / "none").mkdir()
    for call in (("--meshes", tmp_path), ("--meshes", tmp_path, "--clips", folder), ("--mesh-frame", "hand"), ()):
        assert run("evaluate", *call)[0] == 2
    for missing in (tmp_path / "none", tmp_path / "nowhere"):
        status, _, err = run("evaluate", "--meshes", missing, "--clips", folder, "--mesh-frame", "hand")
        assert (status, missing.name in err) == (1, True)
