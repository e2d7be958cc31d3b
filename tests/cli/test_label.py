"""``getagrip label``: each video is drafted once, trouble with one is reported, and labels become a dataset."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.cli.annotate import DATABASE
from getagrip.cli.export import Export
from getagrip.cli.label import compare_results
from getagrip.clip import input_sha256, write_clip
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.result import write_result
from getagrip.studio import jobs
from getagrip.studio.store import labels
from getagrip.studio.store.labels import FrameLabels, Labels
from getagrip.studio.store.mark_store import Store
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.labelled_scene import HEIGHT, WIDTH, SceneNets, circle, write_scene
from helpers.results import true_result

LABEL = ("label", "videos", "--object", "cup", "--size-mm", "90", "--out", "out", "--no-page")


@pytest.fixture
def videos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two videos and a broken one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("getagrip.studio.hands.load_models", lambda _: SceneNets())
    folder = tmp_path / "videos"
    folder.mkdir()
    write_scene(folder / "a.mp4", 6)
    shutil.copy(folder / "a.mp4", folder / "b.mp4")
    (folder / "c.mp4").write_bytes(b"no video")
    return folder


@pytest.mark.slow
def test_videos_are_drafted_once_and_a_broken_one_ends_nothing(videos: Path, run: Run) -> None:
    status, out, err = run(*LABEL)
    assert status == 1
    assert "c.mp4" in err + out
    assert "b: draft 2 of 2" in out
    made = {path: path.stat().st_mtime_ns for path in (videos.parent / "out" / "drafts").rglob("hand.npz")}
    assert len(made) == 2
    (videos / "c.mp4").unlink()
    status, out, _ = run(*LABEL)
    assert status == 0
    assert made == {path: path.stat().st_mtime_ns for path in made}
    store = Store(videos.parent / "out" / DATABASE)
    assert [(mark.task, mark.interval, mark.side) for mark in store.marks.standing()] == [
        ("a", (0, 5), "left"), ("b", (0, 5), "left"),
    ]  # fmt: skip
    store.close()


@pytest.mark.slow
def test_what_is_labelled_is_solved_once_and_exported(videos: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    (videos / "c.mp4").unlink()
    (videos / "b.mp4").unlink()
    assert run(*LABEL)[0] == 0
    frames = {n: FrameLabels(object=(np.array(circle(n)),)) for n in (0, 5)}
    labels.write_label_file(Labels("a.mp4", (WIDTH, HEIGHT), "left", 30.0, 0, 5, frames), videos.parent / "labels.json")
    taken = run("annotate", "videos/a.mp4", "--out", "out", "--import-labels", "labels.json", "--annotator", "draft")
    assert taken[0] == 0, taken
    solved: list[Any] = []
    exported: list[Any] = []

    def solve(new_clip: jobs.NewClipCall, shape: object, out: Path, name: str, *_: object) -> str:
        solved.append((new_clip.words, shape))
        files.write_json(jobs.result_folder(out, name) / "result.json", {})
        return "it is held"

    monkeypatch.setattr(jobs, "reconstruct_grasp_files", solve)
    monkeypatch.setattr(jobs, "draw_report", lambda *_: "")
    monkeypatch.setattr(Export, "run", lambda self: exported.append((self.results, self.to, self.out)) or 0)
    for _ in range(2):
        status, out, err = run(*LABEL)
        assert status == 0, err
    ((words, shape),) = solved
    assert shape == jobs.RequestedMesh("cup", 90.0)
    assert words[:3] == ["clip", "new", "videos/a.mp4"]
    assert "draft-a-1-6-left: 2 strokes and outlines on 2 frames, 2 changes in 0.0 min" in out
    assert "in all: 2 strokes and outlines on 2 frames, 2 changes in 0.0 min" in out
    head, row = (videos.parent / "out" / "effort.csv").read_text("utf-8").splitlines()
    assert head == "grasp,drawn,frames,changes,active_s"
    assert row.startswith("draft-a-1-6-left,2,2,2,0.")
    assert exported[0] == exported[1] == ((Path("out/results/draft-a-1-6-left"),), "bop", Path("out/bop"))
    written = json.loads((videos.parent / "out" / "labels-draft-a-1-6-left.json").read_text("utf-8"))
    assert set(written["frames"]) == {"0", "5"}


def test_poses_of_two_people_are_compared_in_the_frames_of_both(tmp_path: Path) -> None:
    clip, masks = small_clip()
    folder, result = write_clip(clip, masks, tmp_path / "clip"), true_result(clip, None)
    shifted = result.T_hand_obj @ se3.rigid(se3.exp_so3(np.array([0.0, 0.0, np.radians(20.0)])))
    middle = result.scale * clip.mesh.vertices.mean(axis=0)
    shifted[:, :3, 3] += (result.T_hand_obj[:, :3, :3] - shifted[:, :3, :3]) @ middle + np.array([0.0, 0.012, 0.0])
    for name, T in (("ann-a", result.T_hand_obj), ("bob-a", shifted)):
        write_result(replace(result, T_hand_obj=T), tmp_path / name, input_sha256(folder), clip_folder=folder)
    found = compare_results(tmp_path / "ann-a", tmp_path / "bob-a")
    assert found == ("ann-a", "bob-a", len(clip), pytest.approx(12.0, abs=0.1), pytest.approx(20.0, abs=0.1))
    assert str(found).startswith("ann-a and bob-a: 12.0 mm and 20.0 degrees apart, the medians of")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("label", "nowhere"), "VIDEOS must be a folder of videos"),
        (("label", "."), "missing videos in .: files that end in .mp4"),
        (("label", ".", "--to", "blender"), "unknown --to 'blender'"),
    ],
)
def test_calls_that_are_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run, words: tuple[str, ...], expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, err = run(*words, "--object", "cup", "--out", "out")
    assert status == 2
    assert expected in err
