"""Drafts between key frames, as polygons, and files made of labels."""

from __future__ import annotations

import json
import shutil
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.cli.annotate import DATABASE
from getagrip.clip import read_clip, read_masks
from getagrip.geometry.lens import Lens
from getagrip.io import files
from getagrip.io.images import write_image
from getagrip.readers.footage import VideoFootage
from getagrip.studio import jobs, labelling
from getagrip.studio.masks import filled_maps, propagate_clip
from getagrip.studio.masks.filled_maps import FilledFrames, FilledMaps
from getagrip.studio.masks.polygon_drafts import trace_polygons
from getagrip.studio.masks.propagate_clip import PropagatedLabels
from getagrip.studio.project import Project
from getagrip.studio.store.export_all import write_labelled_grasps
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.mark_store import Store
from getagrip.studio.store.tasks import Task
from helpers.annotation import FIRST, LAST, TAB, VIDEO, Clicking, disc, filled, iou, new
from helpers.clips import box
from helpers.environment import Run
from helpers.labelled_scene import HEIGHT, WIDTH, circle, joints


def word(basis: dict[str, Any], draft: dict[str, Any]) -> str:
    """What a draft's frame would be made of now."""
    (found,) = (word for first, last, word in basis[draft["kind"]] if first <= draft["frame"] <= last)
    return str(found)


@pytest.mark.slow
def test_frames_between_are_filled_in_and_again_after_a_correction(clicking: Clicking) -> None:
    clicking.label(FIRST)
    clicking.label(LAST)
    assert clicking.work("propagate")["state"] == "done"
    basis, drafts = clicking.state()["basis"], clicking.project.drafts(clicking.about, 0)["drafts"]
    found = {(one["kind"], one["frame"]): one for one in drafts}
    assert found.keys() == {(kind, n) for kind in ("masks", "hand") for n in range(FIRST, LAST + 1)}
    assert all(one["basis"] == word(basis, one) for one in drafts)
    for n in range(FIRST, LAST + 1):
        assert iou(filled(found["masks", n]["content"]["object"]), filled([circle(n)])) > 0.9
        assert found["masks", n]["content"]["number"] == n + 1
        off = np.linalg.norm(np.array(found["hand", n]["content"]["joints"]) - joints(n), axis=1)
        assert np.median(off) < 4.0
    clicking.click(6, outlines=disc(6))
    assert clicking.state()["basis"]["masks"] != basis["masks"]
    assert clicking.state()["basis"]["hand"] == basis["hand"]
    newest = clicking.state()["drafts"]
    assert clicking.work("propagate")["state"] == "done"
    again = clicking.project.drafts(clicking.about, newest)["drafts"]
    assert {one["kind"] for one in again} == {"masks"}  # the hand is as it was
    assert {one["frame"] for one in again} == {*range(FIRST + 1, LAST)}  # the two ends, too
    assert all(one["basis"] == word(clicking.state()["basis"], one) for one in again)
    assert clicking.work("propagate")["state"] == "done"
    assert clicking.state()["drafts"] == again[-1]["seq"]  # nothing to be done
    clicking.click(8, outlines=disc(8))
    assert clicking.work("propagate")["state"] == "done"
    between = clicking.project.drafts(clicking.about, again[-1]["seq"])["drafts"]
    assert {one["frame"] for one in between} == {*range(7, LAST)}  # those before the neighbour are as they were


def test_a_stroke_is_asked_for_where_the_result_of_these_masks_does_not_meet_them(
    clicking: Clicking, monkeypatch: pytest.MonkeyPatch
) -> None:
    less = {f"{n + 1:06d}": 0.7 if 5 <= n <= 7 else 1.0 for n in range(FIRST, LAST + 1)}

    def solve(new_clip: object, shape: object, out: Path, name: str, *_: object) -> str:
        files.write_json(jobs.result_folder(out, name) / "result.json", {})
        return "done"

    monkeypatch.setattr(jobs, "reconstruct_grasp_files", solve)
    monkeypatch.setattr(jobs, "draw_report", lambda *_: "")
    monkeypatch.setattr(jobs, "iou_by_frame", lambda _: less)
    clicking.label(FIRST)
    clicking.label(LAST)
    assert clicking.work("propagate")["state"] == "done"
    assert clicking.state()["wanted"] is None  # the masks themselves are sure
    assert clicking.work("reconstruct", mesh="plate")["state"] == "done"
    assert clicking.state()["wanted"] == 6
    clicking.click(6, outlines=disc(6))
    assert clicking.work("propagate")["state"] == "done"
    assert clicking.state()["wanted"] is None  # nothing is known of these masks yet


def test_files_of_the_same_labels_are_written_once(clicking: Clicking, tmp_path: Path) -> None:
    """Not again for another mesh or after a restart; again for other labels, and where a mask is missing."""
    clicking.label(FIRST)
    assert clicking.work("files")["state"] == "done"
    (hand,) = tmp_path.glob("*/hand.npz")

    def inode() -> int:
        assert clicking.work("files")["state"] == "done"
        return hand.stat().st_ino

    first = hand.stat().st_ino
    clicking.project.set(clicking.about | {"set": {"mesh": "plate", "size_mm": 180}})
    assert inode() == first
    clicking.click(LAST, outlines=disc(LAST))
    second = inode()
    assert second != first
    assert inode() == second
    next(hand.parent.glob("masks/*.png")).unlink()
    assert inode() != second


def test_a_clip_is_as_far_as_the_result_of_its_current_labels(
    clicking: Clicking, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where poses are wanted, marks alone are no end; another interval, or other labels, make a result of old."""

    def solve(new_clip: object, shape: object, out: Path, name: str, *_: object) -> str:
        files.write_json(jobs.result_folder(out, name) / "result.json", {})
        return "done"

    def state() -> str:
        (task,) = clicking.project.overview("ann")["tasks"]  # type: ignore[misc]
        marks = clicking.project.marks(VIDEO, "ann")
        assert task["state"] == clicking.state()["state"] == marks["state"]
        return str(task["state"])

    def move_end(frame: int) -> None:
        about = clicking.about | {"mark": clicking.about["grasp"], "tab": TAB}
        clicking.project.change(about | {"change": new(), "set": {"end": frame}})

    monkeypatch.setattr(jobs, "reconstruct_grasp_files", solve)
    monkeypatch.setattr(jobs, "draw_report", lambda *_: "")
    assert state() == "marked"
    clicking.project.wants_poses = True
    assert state() == "not begun"
    clicking.label(FIRST)
    assert state() == "drawn"
    assert clicking.work("reconstruct", mesh="plate")["state"] == "done"
    assert state() == "uncertain"  # what was written does not read
    move_end(LAST - 1)
    assert state() == "drawn"
    move_end(LAST)
    assert state() == "uncertain"
    clicking.click(LAST, outlines=disc(LAST))
    assert state() == "drawn"


def test_masks_that_were_filled_in_are_not_filled_in_again_for_the_files(
    clicking: Clicking, scene_video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The files are those of a server that was started anew, to the byte; what changed is done again."""
    spans = list[tuple[int, int]]()
    propagate = propagate_clip._propagate_span

    def counted(image: Any, keys: Any, span: Any, *about: Any) -> Any:
        spans.append((span.first, span.last))
        return propagate(image, keys, span, *about)

    def written(one: Clicking) -> dict[str, bytes]:
        assert one.work("files")["state"] == "done"
        return {path.name: path.read_bytes() for path in sorted(tmp_path.glob("*/masks/*.png"))}

    monkeypatch.setattr(propagate_clip, "_propagate_span", counted)
    clicking.label(FIRST)
    clicking.label(LAST)
    assert clicking.work("propagate")["state"] == "done"
    spans.clear()
    kept = written(clicking)
    assert len(kept) == LAST - FIRST + 1
    assert spans == []
    clicking.click(FIRST, hidden=False, outlines={"in-front": {"of": "front", "closed": True, "points": circle(1)}})
    assert written(clicking) != kept  # nothing was filled in since
    assert spans == [(FIRST, FIRST), (FIRST + 1, LAST - 1)]
    clicking.undo()
    for path in tmp_path.glob("*/masks/*.png"):
        path.unlink()
    again = Project([Task(VIDEO, VIDEO, scene_video)], Store(tmp_path / DATABASE))
    first, clicking.project = clicking.project, again
    assert written(clicking) == kept
    first.close()


def test_a_first_result_is_there_before_all_frames_are_filled_in(
    clicking: Clicking, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has masks of a few frames; the clip is drawn until the result of all of them is there."""
    seen = list[tuple[int, int, dict[str, Any] | None, str]]()

    def solve(new_clip: Any, shape: Any, out: Path, name: str, *_: object) -> str:
        state, masks = clicking.state(), len([*new_clip.masks.glob("*.png")])
        filled = len(clicking.project.drafts(clicking.about, 0)["drafts"])  # type: ignore[arg-type]
        seen.append((masks, filled, state["result"], state["state"]))
        folder = out / jobs.RESULTS_FOLDER / name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "result.json").touch()
        return "solved"

    monkeypatch.setattr(jobs, "reconstruct_grasp_files", solve)
    monkeypatch.setattr(jobs, "draw_report", lambda *_: "")
    monkeypatch.setattr(labelling, "FIRST_MASKS", 3)
    clicking.label(FIRST)
    clicking.label(LAST)
    assert clicking.work("reconstruct", mesh="plate")["state"] == "done"
    (few, none, before, _), (every, filled_in, first, state) = seen
    frames = LAST - FIRST + 1
    assert (few, none, before) == (3, 0, None)
    assert (every, filled_in, state) == (frames, 2 * frames, "drawn")
    assert first is not None
    assert (first["current"], first["first"]) == (True, True)
    assert (clicking.state()["result"]["first"], clicking.state()["state"]) == (False, "uncertain")
    assert clicking.work("reconstruct", mesh="plate")["state"] == "done"
    assert len(seen) == 3  # all is filled in


def test_filling_in_that_is_not_wanted_any_more_ends_at_once(
    clicking: Clicking, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also on the way back from the last key frame, on which no frame is done: what is wanted now waits for it."""
    read, image = list[int](), VideoFootage.image

    def counted(footage: VideoFootage, n: int) -> Any:
        read.append(n)
        if len(read) == 4:
            clicking.project.labelling.background.cancel(clicking.about["grasp"])
        return image(footage, n)

    monkeypatch.setattr(VideoFootage, "image", counted)
    clicking.click(FIRST, outlines=disc(FIRST))
    clicking.click(LAST, outlines=disc(LAST))
    assert clicking.work("propagate")["state"] == "cancelled"
    assert len(read) == 4


def test_kept_maps_have_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    maps = FilledMaps()
    made = [PropagatedLabels(n, np.full((20, 30), n, np.uint8), 0.5) for n in range(3)]
    for one in made:
        maps.put("a", "of this", one)
    frames = FilledFrames(maps, "a", {0: "of this", 1: "of that", 2: "of this"})
    assert [n in frames for n in range(4)] == [True, False, True, False]
    found = frames.at(2)
    assert found is not None
    assert (found.confidence, found.labels.tolist()) == (0.5, made[2].labels.tolist())
    monkeypatch.setattr(filled_maps, "MAX_KEPT_BYTES", 40)
    maps.put("a", "of this", made[2])
    assert [n in frames for n in range(4)] == [False, False, True, False]


@pytest.mark.parametrize(
    "wrong",
    [None, {}, {"mesh": 3}, {"size_mm": -1}, {"size_mm": True}, {"frame": -1}, {"tool": "axe"}, {"lens": {}}, {"x": 1}],
)
def test_settings_that_are_wrong_change_nothing(clicking: Clicking, wrong: Any) -> None:
    clicking.project.set(clicking.about | {"set": {"mesh": "mug", "size_mm": 95, "frame": 3, "tool": "on"}})
    known = clicking.state()["settings"]
    with pytest.raises(RefusedError):
        clicking.project.set(clicking.about | {"set": wrong or None})
    assert clicking.state()["settings"] == known == {"mesh": "mug", "size_mm": 95, "frame": 3, "tool": "on"}


@pytest.mark.parametrize(
    "lens",
    [
        Lens(K=(300.0, 310.0, 160.0, 120.0)),
        Lens(K=tuple(np.array([300.0, 310.0, 160.0, 120.0]))),  # as a camera file has them
        Lens(focal=np.float64(300.0)),
        Lens(guess_focal=True),
    ],
)
def test_the_camera_of_a_grasp_comes_back(tmp_path: Path, lens: Lens) -> None:
    with closing(Store(tmp_path / DATABASE)) as store:
        store.settings.put_lens("a", lens)
        assert store.settings.lens("a") == lens
        assert store.settings.lens("b") is None


def test_damaged_settings_are_reported(clicking: Clicking, refused: Any) -> None:
    grasp = clicking.about["grasp"]
    for value in ("{", '{"a": 1}', "[" * 100_000):
        with clicking.project.store.database.transaction() as db:
            db.execute("INSERT INTO settings (grasp, name, value) VALUES (?, 'mesh', ?)", (grasp, value))
        refused(lambda: clicking.project.store.settings.of(grasp), "damaged")


def test_the_camera_of_a_grasp_is_kept(clicking: Clicking, scene_video: Path, tmp_path: Path) -> None:
    """Without one a later call takes that of the earlier, so that no hand is fitted again."""
    clicking.project.labelling.stated_lens = Lens(focal=321.0)
    clicking.label(FIRST)
    assert clicking.work("propagate")["state"] == "done"
    basis = clicking.state()["basis"]
    again = Project([Task(VIDEO, VIDEO, scene_video)], Store(tmp_path / DATABASE))
    assert again.labels(clicking.about)["basis"] == basis
    again.close()


def test_too_few_labels_are_reported(clicking: Clicking) -> None:
    for what in ("propagate", "files"):
        with pytest.raises(RefusedError):
            clicking.project.work(clicking.about | {"work": what})
    clicking.click(4, joints={"0": [10, 20]}, outlines=disc(4))
    with pytest.raises(RefusedError, match="frame 5 has 1 joints"):
        clicking.project.work(clicking.about | {"work": "propagate"})


@pytest.mark.slow
def test_clicks_that_are_no_hand_are_reported_with_the_number_of_their_frame_and_masks_filled_in(
    clicking: Clicking,
) -> None:
    clicking.click(FIRST, joints={str(n): [150.0, 100.0] for n in range(21)}, outlines=disc(FIRST))
    job = clicking.work("propagate")
    assert job["state"] == "failed"
    assert f"frame {FIRST + 1} " in job["message"]
    drafts = clicking.project.drafts(clicking.about, 0)["drafts"]
    assert [(one["kind"], one["frame"]) for one in drafts] == [("masks", n) for n in range(FIRST, LAST + 1)]


@pytest.mark.slow
def test_files_of_images_that_are_numbered_otherwise_make_a_clip(
    scene_video: Path, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the numbers in their names, of which one is missing."""
    monkeypatch.setattr(propagate_clip, "OBJECT_WORKING_SIZE_PX", 50.0)
    images = tmp_path / "images"
    images.mkdir()
    with closing(VideoFootage(scene_video)) as video:
        for n in range(video.frames):
            write_image(images / f"picture-{n + 25 + (n > 5)}.png", video.image(n))
    clicking = Clicking(images, tmp_path)
    try:
        for frame in (FIRST, LAST):
            clicking.label(frame)
        job = clicking.work("files")
    finally:
        clicking.project.close()
    assert job["state"] == "done", job
    words = job["message"].replace("MESH", "plate").replace("CLIP", str(tmp_path / "clip")).split()
    status, _, err = run(*words[1:])
    assert status == 0, err
    clip = read_clip(tmp_path / "clip")
    assert clip.frames == tuple(f"picture-{n + 25 + (n > 5)}" for n in range(FIRST, LAST + 1))
    assert iou(read_masks(clip).object[-1], filled([circle(LAST)])) > 0.9


def test_masks_of_epic_s_videos_are_named_by_place_as_a_clip_s_frames_are(scene_video: Path, tmp_path: Path) -> None:
    """Not by EPIC's numbers, at 60 a second, which the page shows."""
    video = tmp_path / "P01_01.mp4"
    shutil.copy(scene_video, video)
    clicking = Clicking(video, tmp_path)
    try:
        for frame in (FIRST, LAST):
            clicking.label(frame)
        assert clicking.work("files")["state"] == "done"
    finally:
        clicking.project.close()
    names = [f"{n + 1:06d}.png" for n in range(FIRST, LAST + 1)]
    assert sorted(path.name for path in tmp_path.glob("*/masks/*.png")) == names


@pytest.mark.slow
def test_files_make_a_clip_and_labels_are_taken_back(
    clicking: Clicking, scene_video: Path, run: Run, tmp_path: Path
) -> None:
    for frame in (FIRST, LAST):
        clicking.label(frame)
    clicking.click(7, hidden=False, outlines={"in-front": {"of": "front", "closed": True, "points": circle(1)}})
    job = clicking.work("files")
    assert job["state"] == "done", job
    (tmp_path / "mesh.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in box(0.1, 0.1, 0.01).vertices)
        + "".join("f {} {} {}\n".format(*(face + 1)) for face in box(1, 1, 1).faces)
    )
    words = job["message"].replace("MESH", str(tmp_path / "mesh.obj")).replace("CLIP", str(tmp_path / "clip")).split()
    status, _, err = run(*words[1:])
    assert status == 0, err
    clip = read_clip(tmp_path / "clip")
    masks = read_masks(clip)
    assert (len(clip), clip.side) == (LAST - FIRST + 1, "left")
    seen, row = filled([circle(6)]), 6 - FIRST
    assert iou(masks.object[row], seen) > 0.9
    assert masks.ignore[row].any()  # the hand is in front
    (file,) = tmp_path.glob("labels-*.json")
    other = tmp_path / "other"
    assert run("annotate", scene_video, "--out", other, "--import-labels", file, "--annotator", "bob")[0] == 0
    call = ("annotate", scene_video, "--out", other, "--import-labels", file, "--annotator", "bob", "--export")
    status, out, err = run(*call)
    assert status == 0
    assert f"making the hand and the masks of {len(clip)} frames ...\n" in out
    assert f"hand.npz and masks of {len(clip)} frames; a clip is made of them, with the object's mesh, by\n" in out
    assert err == "bob: 1 grasp is not in this list: name the kind of object on the page to have it there, too\n"
    (again,) = other.glob("labels-*.json")
    assert again.read_text() == file.read_text()
    assert len(json.loads((other / "grasps-bob.json").read_text())) <= 1  # the grasp was marked once
    assert run("annotate", scene_video, "--out", other, "--import-labels", scene_video)[0] == 1
    wrong = json.loads(file.read_text()) | {"video": "other.mp4", "sha256": 64 * "0"}
    (tmp_path / "wrong.json").write_text(json.dumps(wrong))
    status, _, err = run("annotate", scene_video, "--out", other, "--import-labels", tmp_path / "wrong.json")
    assert status == 1
    assert "wrong.json" in err


def test_labels_that_do_not_suffice_are_exported_alone(clicking: Clicking, capsys: Any, tmp_path: Path) -> None:
    clicking.click(4, outlines=disc(4))
    assert write_labelled_grasps(clicking.project) == 1
    assert "labels only" in capsys.readouterr().err
    assert len(list(tmp_path.glob("labels-*.json"))) == 1


shapes = st.lists(
    st.tuples(st.integers(40, 280), st.integers(40, 200), st.integers(8, 60), st.integers(8, 60), st.booleans()),
    min_size=1,
    max_size=4,
)


@given(shapes)
def test_traced_polygons_give_the_mask_again(shapes: list[tuple[int, int, int, int, bool]]) -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    mask = np.zeros((HEIGHT, WIDTH), bool)
    for x, y, a, b, adds in shapes:
        inside = ((u - x) / a) ** 2 + ((v - y) / b) ** 2 < 1
        mask = mask | inside if adds else mask & ~inside
    found = trace_polygons(mask)
    if mask.sum() > 400:
        assert iou(filled(found), mask) > 0.93
    assert all(len(one) >= 3 for one in found)


def test_a_ring_has_one_polygon_with_its_hole() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    distance = np.hypot(u - 150, v - 120)
    ring = (distance < 80) & (distance > 40)
    (outline,) = trace_polygons(ring)
    assert iou(filled([outline]), ring) > 0.97
