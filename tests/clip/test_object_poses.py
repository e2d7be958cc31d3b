"""Other systems' poses: whatever file they are in, they are measured as our own would be."""

from __future__ import annotations

import json
import shutil
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.cli.evaluate import Evaluate, pose_jobs
from getagrip.clip import Clip, Masks, read_clip, write_clip
from getagrip.clip.object_poses import ExternalTrack, read_pose_file, read_poses, write_poses_like
from getagrip.errors import UsageError
from getagrip.export import bop
from getagrip.export.scene import Scene
from getagrip.geometry import se3
from getagrip.geometry.rasterize import render_coverage
from getagrip.io import arrays
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.external import diagnose_pose_convention, read_external_poses
from getagrip.metrics.mask import iou_of_poses
from getagrip.result import Reconstruction, write_result
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.results import true_result

Refused = Callable[..., str]
BOP_HEAD = "scene_id,im_id,obj_id,score,R,t\n"


@pytest.fixture(scope="module")
def moved() -> tuple[Clip, Masks, Reconstruction]:
    """A clip, and a result that is near its truth."""
    clip, masks = small_clip(4)
    clip = replace(clip, frames=("000010", "000011", "000012", "000013"))
    rng = np.random.default_rng(0)
    true = true_result(clip, None)
    nudge = se3.rigid(se3.exp_so3(0.05 * rng.normal(size=(4, 3))), 0.004 * rng.normal(size=(4, 3)))
    T = true.T_hand_obj @ nudge
    return clip, masks, replace(true, T_hand_obj=T, candidates=replace(true.candidates, T_hand_obj=T[None]))


def of_file(kind: str, folder: Path, clip: Clip, result: Reconstruction) -> Path:
    """The result's poses in another system's file."""
    T = clip.hand.T_cam_hand @ result.T_hand_obj
    path = folder / f"theirs.{kind}"
    match kind:
        case "npz":
            arrays.write(path, {"T_cam_obj": T[::-1].copy(), "frames": np.array(clip.frames[::-1])})
        case "hand.npz":
            arrays.write(path, {"T_hand_obj": result.T_hand_obj, "scale": np.array(1.0)})
        case "npy":
            np.save(path, T)
        case "txt":
            np.savetxt(path, T.reshape(-1, 4))
        case "json":
            path.write_text(json.dumps(T.tolist()))
        case "by-name.json":
            path.write_text(
                json.dumps({f"frame_{name}": each for name, each in zip(clip.frames, T.tolist(), strict=True)})
            )
        case "3x4.json":
            path.write_text(json.dumps(T[:, :3].tolist()))
        case "folder":
            path.mkdir()
            for name, each in zip(clip.frames, T, strict=True):
                np.savetxt(path / f"{name}.txt", each)
        case "bop.csv" | "scene_gt.json":
            made = bop.write(Scene.of(result, clip), folder)
            wanted = ".csv" if kind == "bop.csv" else "scene_gt.json"
            return folder / next(name for name in made if name.endswith(wanted))
        case "result":
            return write_result(result, path)
    return path


KINDS = (
    "npz", "hand.npz", "npy", "txt", "json", "by-name.json", "3x4.json", "folder", "bop.csv", "scene_gt.json", "result",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.slow
def test_every_file_gives_the_same_metrics(tmp_path: Path, moved: Any, kind: str) -> None:
    clip, masks, result = moved
    found = read_external_poses(of_file(kind, tmp_path, clip, result), "theirs", clip, masks)
    np.testing.assert_allclose(found.T_hand_obj, result.T_hand_obj, atol=1e-7)
    assert found.frame_kind == ("sampled",) * 4
    ours, theirs = (evaluate(each, clip, masks).metrics for each in (result, found))
    assert theirs.keys() == ours.keys()
    for key, value in ours.items():
        assert theirs[key] == pytest.approx(value, abs=1e-3, nan_ok=True), key


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "result"])
def test_what_is_written_like_a_file_is_read_as_it_was(tmp_path: Path, moved: Any, kind: str) -> None:
    clip, _, result = moved
    place = of_file(kind, tmp_path, clip, result)
    poses = read_poses(place, clip)
    turned = poses.T_hand_obj @ se3.rigid(se3.exp_so3(np.array([0.1, 0.2, 0.3])), np.array([0.01, 0.0, 0.02]))
    track = ExternalTrack(poses.names, clip.hand.T_cam_hand @ turned, turned, 1.0, np.ones(4))
    folder = tmp_path / "out"
    folder.mkdir()
    for _ in range(2):  # a call may be repeated
        written = write_poses_like(place, track, folder)
    again = read_poses(written, clip)
    np.testing.assert_allclose(again.T_hand_obj, turned, atol=1e-7)
    assert again.names == poses.names
    assert again.found.all()


def test_frames_without_a_pose_are_held_still_in_the_hand_and_said(tmp_path: Path, moved: Any) -> None:
    clip, masks, result = moved
    T = clip.hand.T_cam_hand @ result.T_hand_obj
    arrays.write(tmp_path / "some.npz", {"T_cam_obj": T[[1, 3]], "frames": np.array([11, 13])})
    found = read_external_poses(tmp_path / "some.npz", "theirs", clip, masks)
    assert found.frame_kind == ("interpolated", "sampled", "interpolated", "sampled")
    np.testing.assert_allclose(found.T_hand_obj, result.T_hand_obj[[1, 1, 1, 3]], atol=1e-12)
    assert any("no pose in 2 of 4 frames" in note for note in found.notes)
    assert evaluate(found, clip, masks).metrics_of_fitted
    free = read_external_poses(tmp_path / "some.npz", "theirs", replace(clip, scale="free"), masks)
    assert any("scale 1 is a guess" in note for note in free.notes)


@pytest.mark.parametrize("kind", ["npz", "npy", "null.json", "by-name.json", "folder", "bop.csv"])
def test_a_matrix_of_nan_is_a_lost_frame(tmp_path: Path, moved: Any, kind: str, refused: Refused) -> None:
    clip, masks, result = moved

    def written(lost: list[int]) -> Path:
        T = clip.hand.T_cam_hand @ result.T_hand_obj
        T[lost] = np.nan
        path, named = tmp_path / f"{len(lost)}.{kind}", dict(zip(clip.frames, T, strict=True))
        texts = {name: None if np.isnan(each).any() else each.tolist() for name, each in named.items()}
        match kind:
            case "npz":
                arrays.write(path, {"T_cam_obj": T})
            case "npy":
                np.save(path, T)
            case "null.json":
                path.write_text(json.dumps([*texts.values()]))
            case "by-name.json":
                path.write_text(json.dumps(texts))
            case "folder":
                path.mkdir()
                for name, each in named.items():
                    np.savetxt(path / f"{name}.txt", each[:3])
            case _:
                rows = [f"1,{n},1,1,{_words(each[:3, :3])},{_words(1e3 * each[:3, 3])}" for n, each in named.items()]
                path.write_text(BOP_HEAD + "\n".join(rows))
        return path

    poses = read_poses(written([1, 3]), clip)
    assert poses.found.tolist() == [True, False, True, False]
    np.testing.assert_allclose(poses.T_hand_obj, result.T_hand_obj[[0, 0, 2, 2]], atol=1e-7)
    refused(lambda: read_external_poses(written([0, 1, 2, 3]), "theirs", clip, masks), "pose")


def _words(values: np.ndarray) -> str:
    return " ".join(f"{x:.9g}" for x in values.ravel())


def test_rounded_rotations_are_made_exact_and_scaled_ones_refused(tmp_path: Path, moved: Any, refused: Refused) -> None:
    clip, masks, result = moved
    T = clip.hand.T_cam_hand @ result.T_hand_obj
    path = tmp_path / "T.txt"
    np.savetxt(path, T[:, :3].reshape(4, 12), fmt="%.2f")  # a line of 12 for each frame
    found = read_poses(path, clip).T_hand_obj
    assert se3.is_rigid(found, 1e-12).all()
    assert np.degrees(se3.angle_between(found[:, :3, :3], result.T_hand_obj[:, :3, :3])).max() < 1.0
    T[:, :3, :3] *= 1.05
    np.save(tmp_path / "T.npy", T)
    refused(lambda: read_external_poses(tmp_path / "T.npy", "theirs", clip, masks), "no rigid motion")


def test_what_is_wrong_is_named(tmp_path: Path, moved: Any, refused: Refused) -> None:
    clip, masks, result = moved
    T = clip.hand.T_cam_hand @ result.T_hand_obj
    far = T.copy()
    far[:, :3, 3] *= 1000.0
    sheared = T.copy()
    sheared[0, 0, 1] += 0.5
    twice = np.array([10, 10, 11, 12])
    bad: dict[str, tuple[Any, str]] = {
        "millimetres": ({"T_cam_obj": far}, "are these millimetres?"),
        "sheared": ({"T_cam_obj": sheared}, "no rigid motion"),
        "short": ({"T_cam_obj": T[:3]}, "3 poses without names"),
        "twice": ({"T_cam_obj": T, "frames": twice}, "one pose for each frame"),
        "others": ({"T_cam_obj": T, "frames": twice + np.arange(4) + 90}, "no pose of the clip's frames"),
        "camera": ({"T_hand_obj": T @ se3.rigid(None, np.array([0.0, 0.0, 0.4]))}, "T_cam_obj"),
        "nothing": ({"poses": T}, "T_cam_obj or T_hand_obj"),
        "scale": ({"T_cam_obj": T, "scale": np.array(-1.0)}, "above 0"),
        "shape": ({"T_cam_obj": T[:, :3, :3]}, "4x4"),
    }
    for name, (content, words) in bad.items():
        path = tmp_path / f"{name}.npz"
        arrays.write(path, content)
        refused(lambda path=path: read_external_poses(path, "theirs", clip, masks), str(path), words)
    texts = {
        "a.txt": ("1 2 3", "3 numbers"),
        "tum.txt": ("0 0 0 1 0 0 0 1\n" * 8, "quaternions"),
        "b.txt": ("1 x", "not a number"),
        "c.json": ('"x"', "a list of matrices"),
        "d.json": ('{"10": [[1]]}', "4x4"),
        "e.csv": ("a,b\n1,2\n", "columns"),
        "f.csv": ("scene_id,im_id,obj_id,score,R,t,time\n1,10,1,1,1 0 0,0 0 500,-1\n", "9 numbers"),
        "g.csv": (
            "scene_id,im_id,obj_id,score,R,t,time\n"
            + "".join(f"1,10,{k},1,1 0 0 0 1 0 0 0 1,0 0 500,-1\n" for k in (1, 2)),
            "a second obj_id",
        ),
        "h.xml": ("", "the suffix"),
        "i.csv": (BOP_HEAD + "1,10,1,1\r,1 0 0,0 0 500\n", "got 4 cells"),
        "j.csv": (BOP_HEAD + f"1,10,1,1,{'1 ' * 100_000},0 0 500,-1\n", "invalid CSV"),
        "k.csv": (BOP_HEAD + '1,10,1,1,"1 0 0,0 0 500,-1\n', "invalid CSV"),
        "l.csv": (BOP_HEAD + "1,10,1,1\n", "4 cells"),
    }
    for name, (text, words) in texts.items():
        (tmp_path / name).write_text(text, newline="")
        refused(
            lambda name=name: read_external_poses(tmp_path / name, "theirs", clip, masks), str(tmp_path / name), words
        )


def test_a_text_of_numbers_is_read_in_bounded_memory(tmp_path: Path, refused: Refused) -> None:
    path = tmp_path / "ones.txt"
    path.write_bytes(b"1 " * (16 * 2**16 + 1))
    tracemalloc.start()
    refused(lambda: read_pose_file(path), str(path), "16 for each frame")
    assert tracemalloc.get_traced_memory()[1] < 12 * path.stat().st_size
    tracemalloc.stop()


def test_the_best_score_of_an_image_counts(tmp_path: Path, moved: Any) -> None:
    clip, masks, result = moved
    path = of_file("bop.csv", tmp_path, clip, result)
    lines = path.read_text().splitlines()
    worse = lines[1].split(",")
    worse[3], worse[5] = "-1", "0 0 900"
    path.write_text("\n".join([*lines, ",".join(worse)]) + "\n")
    np.testing.assert_allclose(read_external_poses(path, "x", clip, masks).T_hand_obj, result.T_hand_obj, atol=1e-7)


@pytest.mark.slow
def test_they_are_rows_beside_ours(tmp_path: Path, moved: Any, run: Run) -> None:
    """One clip by a file, and many by a folder; the frames of our results count where there are any."""
    clip, masks, result = moved
    folder = write_clip(clip, masks, tmp_path / "clips" / clip.name)
    theirs = tmp_path / "foundationpose"
    theirs.mkdir()
    file = of_file("npy", tmp_path, clip, result).rename(theirs / f"{clip.name}.npy")
    status, out, _ = run("evaluate", "--poses", file, "--clips", folder, "--json", tmp_path / "one.json")
    assert status == 0
    status, out, _ = run("evaluate", "--poses", theirs, "--clips", tmp_path / "clips", "--json", tmp_path / "all.json")
    assert (status, "ADD" in out) == (0, True)
    one, many = (json.loads((tmp_path / name).read_text()) for name in ("one.json", "all.json"))
    assert list(many["methods"]) == ["foundationpose"]
    assert many["mean"] == one["mean"]
    ours = write_result(
        result.take(np.array([0, 2])), tmp_path / "results" / clip.name, _checksum(folder), clip_folder=folder
    )
    status, _, err = run(
        "evaluate", ours, "--poses", theirs, "--clips", tmp_path / "clips", "--json", tmp_path / "b.json"
    )
    assert status == 0
    assert "the poses meet the masks by 34 % only" in err
    both = json.loads((tmp_path / "b.json").read_text())["samples"]
    assert [sample["frames"] for sample in both] == [["000010", "000012"]] * 2
    assert both[0]["metrics"]["add_mm"] == pytest.approx(both[1]["metrics"]["add_mm"])
    assert run("evaluate", "--poses", theirs)[0] == 2
    other = Path(shutil.copy(file, tmp_path / "other.npy"))
    for poses in (theirs, other):  # the result names its clip
        for clips in ((), ("--clips", tmp_path / "clips"), ("--clips", folder)):
            assert run("evaluate", ours, "--poses", poses, *clips, "--json", tmp_path / "c.json")[0] == 0
            samples = json.loads((tmp_path / "c.json").read_text())["samples"]
            assert [sample["method"] for sample in samples] == [result.method, poses.stem]
            assert samples[1]["metrics"]["add_mm"] == both[1]["metrics"]["add_mm"]
    status, _, err = run("evaluate", "--poses", other, "--clips", tmp_path / "clips")
    assert (status, f"which clip is {other} of? Name it: --clips CLIP" in err) == (2, True)
    assert run("evaluate", "--poses", tmp_path / "none", "--clips", folder)[0] == 1


def _checksum(folder: Path) -> str:
    from getagrip.clip import input_sha256

    return input_sha256(folder)


def test_poses_that_are_counted_from_another_start_are_asked_for(tmp_path: Path, moved: Any) -> None:
    clip, masks, result = moved
    T, first = clip.hand.T_cam_hand @ result.T_hand_obj, int(clip.frames[0]) - 1
    path = tmp_path / "earlier.npz"
    arrays.write(path, {"T_cam_obj": T, "frames": np.arange(first, first + len(T))})
    with pytest.raises(UsageError, match="missing --first"):
        read_external_poses(path, "theirs", clip, masks)
    found = read_external_poses(path, "theirs", clip, masks, first)
    np.testing.assert_allclose(found.T_hand_obj, result.T_hand_obj, atol=1e-7)


def test_files_of_single_frames_are_of_the_one_result(tmp_path: Path, moved: Any) -> None:
    clip, _, _ = moved
    for name in clip.frames:
        np.savetxt(tmp_path / f"{name}.txt", np.eye(4))
    (job,) = pose_jobs(Evaluate(poses=tmp_path, clips=tmp_path / "clips"), {"mug": clip.frames})
    assert (job.folder, job.clip) == (tmp_path, tmp_path / "clips" / "mug")
    assert len(pose_jobs(Evaluate(poses=tmp_path, clips=tmp_path / "clips"), {})) == len(clip)


CONVENTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "inverse": lambda T, _: se3.inverse(T),
    "OpenGL": lambda T, _: np.diag([1.0, -1.0, -1.0, 1.0]) @ T,
    "moved to its middle": lambda T, mesh: T @ se3.rigid(np.eye(3), mesh.centre),
}


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_the_convention_that_meets_the_masks_is_named(tmp_path: Path, convention: str) -> None:
    """Of an object off its origin, turned half about a tilted axis, so that its inverse pose is before the camera."""
    clip, _ = small_clip(4)
    mesh = replace(clip.mesh, vertices=clip.mesh.vertices + np.array([0.03, 0.02, 0.04]))
    T = clip.truth.T_cam_obj.copy()
    T[:, :3, :3] = se3.exp_so3(np.pi * np.array([0.8, 0.0, 0.6]))
    seen = np.array([render_coverage(se3.transform(M, mesh.vertices), mesh.faces, clip.K[0], clip.size) for M in T])
    masks = Masks(seen, np.zeros_like(seen))
    theirs = CONVENTIONS[convention](T, mesh)
    clip = replace(clip, mesh=mesh)
    iou = iou_of_poses(mesh, 1.0, theirs, clip.K, masks).full
    if convention != "OpenGL" or (theirs[:, 2, 3] > 0).all():
        text = diagnose_pose_convention(clip, masks, theirs, 1.0, iou)
        assert (convention in text) == (iou.mean() < 0.5)
    assert diagnose_pose_convention(clip, masks, T, 1.0, iou_of_poses(mesh, 1.0, T, clip.K, masks).full) == ""


def test_one_of_several_poses_is_followed(tmp_path: Path) -> None:
    """Scores change places from image to image; the masks, or the place before, tell which is the clip's."""
    clip, masks = small_clip(4)
    T, far = clip.truth.T_cam_obj, clip.truth.T_cam_obj.copy()
    far[:, :3, 3] += [0.15, 0.05, 0.1]
    rows = []
    for n in range(4):
        for score, M in ((0.9, T[n]), (0.85 + 0.1 * (n % 2), far[n])):
            words = [" ".join(map(repr, (M[:3, :3]).ravel().tolist())), " ".join(map(repr, (1e3 * M[:3, 3]).tolist()))]
            rows.append(f"1,{n},1,{score},{words[0]},{words[1]}\n")
    (tmp_path / "x.csv").write_text(BOP_HEAD + "".join(rows))
    for folder, some in (("with", masks), ("without", None)):
        whole = read_clip(write_clip(clip, some, tmp_path / folder))
        made = read_poses(tmp_path / "x.csv", whole)
        np.testing.assert_allclose(clip.hand.T_cam_hand @ made.T_hand_obj, T, atol=1e-6)
        assert "several poses in 4 of 4 images" in made.notes[0]
