"""``segment``, ``--from-masks`` and ``--find-grasps``: known contact sets, files, and errors of bad clips."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from getagrip.bench.figures.contact_matrix import write_matrix
from getagrip.clip import Clip, HandTrack, Truth, read_clip, write_clip
from getagrip.clip.timeline import read_segments
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.io.images import write_image
from getagrip.metrics.contact import contact_distances
from getagrip.metrics.pose import ObjectTrack
from getagrip.report.pictures.panels import RESULT_COLOUR
from getagrip.result import read_result
from getagrip.stable_grasps import grasp_lists
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.find import (
    ARTICULATION_THRESHOLD_RAD,
    assign_fragments,
    contact_iou,
    contact_sets,
    segment,
)
from getagrip.timelines.detect import detect_segments
from getagrip.timelines.detect.detect_segments import DetectedSegments
from helpers.clips import box, small_clip
from helpers.environment import Run
from helpers.pages import pixels_of, read_picture
from helpers.scenes import HOLDING, LYING, from_table

RADIUS = 0.03


def ball(radius: float, subdivisions: int = 3) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))


def held(mesh: Mesh, places: np.ndarray, name: str = "held") -> Clip:
    """A clip whose hand is a ball that stays, the object at ``places`` (T, 3) in its frame; without masks."""
    clip = small_clip(len(places))[0]
    hand = ball(RADIUS)
    T_cam_hand = np.tile(se3.rigid(t=np.array([0.0, 0.0, 0.6])), (len(places), 1, 1))
    track = HandTrack(np.tile(hand.vertices, (len(places), 1, 1)), hand.faces, T_cam_hand, clip.hand.regions)
    truth = Truth(T_cam_hand @ se3.rigid(t=places), 1.0, T_cam_hand, track.vertices)
    return replace(clip, name=name, mesh=mesh, hand=track, truth=truth)


def three_grasps(name: str = "held") -> Clip:
    """12 frames at one side of the hand, 3 away from it, 10 at the other side, the last of which drift off."""
    places = np.zeros((25, 3))
    places[:, 0] = 0.055
    places[12:15, 0] = 0.2
    places[15:, 0] = -0.055
    return held(ball(RADIUS), places, name)


def write(clip: Clip, folder: Path) -> Path:
    return write_clip(clip, None, folder)


# Contact sets.


def test_contact_is_where_the_formula_says_and_what_the_metrics_count() -> None:
    clip = held(ball(RADIUS), np.array([[0.055, 0.0, 0.0], [0.0, 0.0, 0.2]]))
    assert clip.truth is not None
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    (distances,) = contact_distances(clip.mesh, [ObjectTrack(T, 1.0)], clip.truth.hand_vertices, clip.hand.faces)
    for threshold in (0.0, 0.005):
        found = contact_sets(clip, threshold)
        exact = np.linalg.norm(clip.mesh.vertices + np.array([0.055, 0.0, 0.0]), axis=1) - RADIUS
        sure = np.abs(exact - threshold) > 5e-4
        np.testing.assert_array_equal(found[0, sure], (exact <= threshold)[sure])
        assert found[0].any()
        assert not found[1].any()
        np.testing.assert_array_equal(found, distances.contact("object", threshold))
        np.testing.assert_array_equal(contact_sets(clip, threshold, "area"), distances.contact("area", threshold))


def test_an_open_wrist_does_not_let_contact_in() -> None:
    clip = held(ball(0.01), np.array([[0.0, 0.0, 0.015]]))
    centres = clip.hand.vertices[0][clip.hand.faces].mean(axis=1)
    opened = replace(clip, hand=replace(clip.hand, faces=clip.hand.faces[centres[:, 2] < 0.8 * RADIUS]))
    assert contact_sets(clip).all()
    assert contact_sets(opened).mean() > 0.9


def test_area_does_not_depend_on_how_the_mesh_is_cut_into_triangles() -> None:
    places = np.zeros((8, 3))
    places[:, 0] = 0.048
    places[:, 1:] = np.random.default_rng(0).uniform(-0.012, 0.012, (8, 2))
    coarse = box(0.06, 0.08, 0.1)
    assert not contact_sets(held(coarse, places), 0.002).any()  # no vertex where it is held
    cut, faces = coarse.vertices, coarse.faces
    for n in range(6):  # at last finer on one side only
        one_side = np.flatnonzero((cut[faces].mean(axis=1)[:, 1] < 0.0) | (n < 4))
        cut, faces = trimesh.remesh.subdivide(cut, faces, one_side)
    fine = Mesh(np.asarray(cut), np.asarray(faces))
    pairs = np.triu_indices(8, k=1)
    one, other = (contact_iou(contact_sets(held(mesh, places), 0.002, "area"))[pairs] for mesh in (coarse, fine))
    assert one.min() < 0.5 < one.max() < 1.0
    assert np.abs(one - other).mean() < 0.03
    # A fine mesh's own vertices say the same once they are weighted by their area.
    weighted = contact_iou(contact_sets(held(fine, places), 0.002), fine.vertex_areas)[pairs]
    assert np.abs(one - weighted).mean() < 0.03


def test_fragments_are_patches_in_contact_where_one_of_their_vertices_is() -> None:
    mesh = ball(RADIUS, 4)
    patch = assign_fragments(mesh.vertices)
    assert np.unique(patch).tolist() == list(range(len(mesh.vertices) // 100))
    centres = np.stack([mesh.vertices[patch == k].mean(axis=0) for k in range(patch.max() + 1)])
    assert np.linalg.norm(mesh.vertices - centres[patch], axis=1).max() < 0.9 * RADIUS
    clip = held(mesh, np.array([[0.055, 0.0, 0.0]]))
    touched = np.unique(patch[contact_sets(clip)[0]])
    np.testing.assert_array_equal(np.flatnonzero(contact_sets(clip, points="fragments")[0]), touched)
    assert len(np.unique(assign_fragments(box(0.1, 0.1, 0.1).vertices))) == 1


def test_moving_hand_and_object_together_changes_nothing() -> None:
    clip = three_grasps()
    assert clip.truth is not None
    rng = np.random.default_rng(0)
    G = se3.rigid(se3.exp_so3(rng.normal(size=(25, 3))), 0.01 * rng.normal(size=(25, 3)))
    moved = replace(clip.truth, T_cam_hand=G @ clip.truth.T_cam_hand, T_cam_obj=G @ clip.truth.T_cam_obj)
    assert segment(clip, Definition(shortest=5))[1] == [(0, 11), (15, 24)]
    assert segment(replace(clip, truth=moved), Definition(shortest=5))[1] == [(0, 11), (15, 24)]


def test_opening_an_object_ends_a_grasp() -> None:
    clip = three_grasps()
    assert clip.truth is not None
    angle = np.zeros(25)
    angle[15:20], angle[20:] = (
        0.4 * ARTICULATION_THRESHOLD_RAD,
        1.2 * ARTICULATION_THRESHOLD_RAD,
    )  # trembles, then opens
    opened = replace(clip, truth=replace(clip.truth, articulation=angle))
    assert segment(opened, Definition(shortest=3))[1] == [(0, 11), (15, 24)]
    angle[20:] = 1.5 * ARTICULATION_THRESHOLD_RAD
    assert segment(opened, Definition(shortest=3))[1] == [(0, 11), (15, 19), (20, 24)]
    for rule in ("first", "consecutive"):
        assert not any(a <= 19 and b >= 20 for a, b in segment(opened, Definition(shortest=2, rule=rule))[1])


def test_articulation_is_kept_and_checked(tmp_path: Path, refused: Callable[..., str]) -> None:
    clip = three_grasps()
    assert clip.truth is not None
    angle = np.linspace(0.0, 1.0, 25)
    folder = write(replace(clip, truth=replace(clip.truth, articulation=angle)), tmp_path / "a")
    truth = read_clip(folder).truth
    assert truth is not None
    np.testing.assert_array_equal(truth.articulation, angle)
    taken = read_clip(folder).take(np.array([3, 1])).truth
    assert taken is not None
    np.testing.assert_array_equal(taken.articulation, angle[[3, 1]])
    degrees = replace(clip, truth=replace(clip.truth, articulation=90.0 * angle))
    refused(lambda: read_clip(write(degrees, tmp_path / "b")), "articulation", "are these degrees?")
    with np.load(folder / "truth.npz") as stored:
        short = dict(stored) | {"articulation": angle[:3]}
    np.savez(folder / "truth.npz", **short)
    refused(lambda: read_clip(folder), "articulation", "(3,)", "(25)")


def test_wrong_definitions_and_clips_without_truth_are_refused() -> None:
    for wrong in ({"tau": 1.0}, {"contact": -0.001}, {"contact": 5.0}, {"shortest": 0}):
        with pytest.raises(UsageError, match=next(iter(wrong))):
            Definition(**wrong)
    with pytest.raises(InputError, match=r"truth\.npz"):
        segment(replace(three_grasps(), truth=None))


# The command.


@pytest.mark.slow
def test_all_is_written_and_printed(run: Run, tmp_path: Path) -> None:
    write(three_grasps("a"), tmp_path / "clips" / "a")
    write(replace(three_grasps("b"), side="left", fps=10.0, category="[bold]x"), tmp_path / "clips" / "b")
    write(held(ball(RADIUS), np.tile([0.2, 0.0, 0.0], (25, 1)), "none"), tmp_path / "clips" / "none")
    out, file = tmp_path / "out", tmp_path / "grasps.json"
    given = (tmp_path / "clips", "--shortest", 11, "--out", out, "--json", file)
    status, printed, err = run("segment", *given)
    assert (status, err) == (0, "")
    assert "2 stable grasps in 2 of 3 clips" in printed
    assert "[bold]x" in printed
    with (out / "segments.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["sequence", "side", "object", "start", "end", "duration", "first", "last"]
    assert [(row["sequence"], row["side"], row["start"], row["end"]) for row in rows] == [
        ("a", "right", "0", "11"),
        ("b", "left", "0", "11"),
    ]
    assert [float(row["duration"]) for row in rows] == [pytest.approx(12 / 30), pytest.approx(1.2)]
    content = json.loads(file.read_text())
    assert content["cut"] == {"tau": 0.5, "contact": 0.0, "points": "vertices", "rule": "all-pairs", "shortest": 11}
    found = [(one["sequence"], one["first"], one["last"]) for one in content["grasps"]]
    assert found == [("a", "0000", "0011"), ("b", "0000", "0011")]
    assert (out / "grasps.json").read_bytes() == file.read_bytes()
    a, b, none = (read_picture(out / f"{name}.png") for name in ("a", "b", "none"))
    assert (
        min(pixels_of(picture, RESULT_COLOUR) for picture in (a, b)) > 2 * pixels_of(none, RESULT_COLOUR) > 0
    )  # tau, and a framed grasp
    assert all(pixels_of(picture, "#16283a") > 1000 for picture in (a, b))  # pairs of frames with the same contact

    shared = tmp_path / "shared.json"  # without pictures, which take longer than all else
    again = run("segment", tmp_path / "clips", "--shortest", 11, "--json", shared, "--workers", 2)
    assert (again[0], again[2]) == (status, err)
    assert printed.startswith(again[1])
    assert "2 stable grasps" in again[1]
    assert shared.read_bytes() == file.read_bytes()
    status, printed, _ = run("segment", tmp_path / "clips" / "a", "--shortest", 5)
    assert status == 0
    assert "2 stable grasps in 1 of 1 clip, 88.0 % of their frames" in printed
    assert " 0024 " in printed


def test_one_bad_clip_stops_no_other(run: Run, tmp_path: Path) -> None:
    write(three_grasps("good"), tmp_path / "good")
    write(replace(three_grasps("blind"), truth=None), tmp_path / "blind")
    file = tmp_path / "grasps.json"
    status, printed, err = run(
        "segment", tmp_path / "blind", tmp_path / "gone", tmp_path / "good", "--shortest", 5, "--json", file
    )
    assert status == 1
    assert "2 stable grasps" in printed
    lines = err.strip().splitlines()
    assert len(lines) == 2
    assert "gone: no such folder" in lines[0]
    assert "failed: blind: " in lines[1]
    assert "truth.npz: no such file; must be the true poses" in lines[1]
    assert [one["sequence"] for one in json.loads(file.read_text())["grasps"]] == ["good", "good"]
    assert "Traceback" in run("segment", tmp_path / "blind", "--debug")[2]


@pytest.mark.slow
def test_wrong_calls_exit_with_2_and_write_nothing(run: Run, tmp_path: Path) -> None:
    write(three_grasps(), tmp_path / "a")
    write(three_grasps(), tmp_path / "b")
    wrong: list[tuple[object, ...]] = [
        (),
        ("a", "--tau", "1"),
        ("a", "--tau", "much"),
        ("a", "--contact-mm", "-1"),
        ("a", "--contact-mm", "nan"),
        ("a", "--points", "faces"),
        ("a", "--rule", "second"),
        ("a", "--shortest", "0"),
        ("a", "--workers", "0"),
        ("a", "--out", __file__),
        ("a", "--json", f"{__file__}/file.json"),
    ]
    for args in wrong:
        status, _, err = run("segment", *args)
        assert status == 2, args
        assert err
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b"}
    assert run("segment", "--help")[0] == 0


def test_of_clips_that_share_a_name_only_these_fail(run: Run, tmp_path: Path) -> None:
    for folder, name in (("a", "cup"), ("b", "cup"), ("c", "other")):
        write(replace(three_grasps(), name=name), tmp_path / folder)
    for more in ((), (tmp_path / "c",)):
        status, printed, err = run("segment", tmp_path / "a", tmp_path / "b", *more)
        assert (status, err.count("a name of its own")) == (1, 2)
        assert ("other" in printed) == bool(more)


@pytest.mark.slow
def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from getagrip.cli import main\n"
        "try: main(['segment', '--help'])\n"
        "except SystemExit: pass\n"
        "sys.exit(','.join({'numpy', 'scipy', 'igl', 'rich.table', 'matplotlib'} & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


# The picture.


@pytest.mark.parametrize("frames", [1, 3, 40, 2500])
@pytest.mark.slow
def test_a_picture_is_drawn_of_any_length(frames: int, tmp_path: Path) -> None:
    contact = np.tile(np.arange(5) < 3, (frames, 1))
    iou = contact_iou(contact)
    bare = read_picture(write_matrix(tmp_path / "a.png", iou, [], 30.0, 0.5, "a", "b"))
    marked = read_picture(write_matrix(tmp_path / "b.png", iou, [(0, frames - 1)], 30.0, 0.0, "$a$_{", 99 * "b"))
    assert bare.shape == marked.shape
    assert pixels_of(marked, RESULT_COLOUR) > pixels_of(bare, RESULT_COLOUR) + 1000  # the frame, and the strip below
    assert pixels_of(bare, "#16283a") > 0.3 * bare[..., 0].size  # every pair has the same contact


def lying(folder: Path, name: str = "lying") -> Clip:
    """A clip whose object lies still before a camera that does, too, written into a folder."""
    clip, masks = from_table()
    clip = replace(clip.take(np.arange(12)), world=None, truth=None, name=name)
    write_clip(clip, masks.take(np.zeros(12, dtype=int)), folder / name)
    return clip


@pytest.mark.slow
def test_all_segments_are_written_and_the_assumption_is_said(tmp_path: Path, run: Run) -> None:
    clip = lying(tmp_path / "clips")
    status, out, err = run("segment", "--from-masks", tmp_path / "clips", "--out", tmp_path / "out", "--write")
    assert status == 0
    assert "0 stable grasps in 0 of 1 clip" in out
    assert re.search(rf"lying +static +{clip.frames[0]} +{clip.frames[-1]} ", out)
    assert "margin: how much worse" in out
    assert "lying: the camera is taken to stand still: a guess" in err
    written = json.loads((tmp_path / "out" / "segments.json").read_text())["lying"]
    (segment,) = read_segments(tmp_path, written["segments"], clip.frames, has_world=True)
    assert (segment.state, segment.first, segment.last, segment.side) == ("static", 0, 11, None)
    assert written["margins"][0] > 0.0
    whole = read_clip(tmp_path / "clips" / "lying")
    assert whole.segments == (segment,)
    assert "guess" in whole.provenance["camera_pose"]
    status, _, err = run("segment", "--from-masks", tmp_path / "clips", "--write")
    assert (status, "--overwrite" in err) == (1, True)
    with (tmp_path / "out" / "segments.csv").open(newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert (row["sequence"], row["state"], row["start"], row["end"]) == ("lying", "static", "0", "11")
    assert not grasp_lists.read_listed_grasps(tmp_path / "out" / "grasps.json", print).grasps


def test_a_bad_clip_is_named_and_the_rest_is_done(tmp_path: Path, run: Run) -> None:
    lying(tmp_path / "clips")
    bad = lying(tmp_path / "clips", "bad")
    (tmp_path / "clips" / "bad" / "masks" / "object" / f"{bad.frames[3]}.png").write_bytes(b"no image")
    status, out, err = run("segment", "--from-masks", tmp_path / "clips")
    assert status == 1
    assert "bad" in err
    assert "static" in out


def test_a_list_is_refused(tmp_path: Path, run: Run) -> None:
    lying(tmp_path)
    status, _, err = run("segment", "--from-masks", tmp_path / "lying", "--list", tmp_path / "grasps.json")
    assert status == 2
    assert "--list" in err


def test_a_clip_without_a_grasp_has_no_result_and_is_no_failure(tmp_path: Path, run: Run) -> None:
    lying(tmp_path / "clips")
    status, out, _ = run("reconstruct", "--cut-grasps", tmp_path / "clips", "--out", tmp_path / "out")
    assert status == 0
    assert "lying: no stable grasp" in out
    assert not (tmp_path / "out" / "lying--1").exists()


def test_timelines_have_one_method(tmp_path: Path, run: Run) -> None:
    status, _, err = run("reconstruct", "--find-grasps", "--method", "static", tmp_path, "--out", tmp_path / "out")
    assert (status, "--cut-grasps" in err) == (2, True)


@pytest.mark.slow
def test_grasps_and_the_whole_are_reconstructed_and_named(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    known: list[DetectedSegments] = []
    find = detect_segments.find_segments

    def find_once(*args: Any, **kwargs: Any) -> DetectedSegments:  # both commands ask for the same
        known.extend([] if known else [find(*args, **kwargs)])
        return known[0]

    monkeypatch.setattr(detect_segments, "find_segments", find_once)
    clip, masks = from_table()
    folder = write_clip(clip, masks, tmp_path / "clip")
    (folder / "frames").mkdir()
    for name in clip.frames:
        write_image(folder / "frames" / f"{name}.jpg", np.zeros((240, 320, 3), np.uint8))
    out = tmp_path / "out"
    search = ("--inits", 6, "--frames", 8)
    status, printed, _ = run("reconstruct", "--cut-grasps", folder, "--out", out, *search)
    assert status == 0
    cut = read_clip(out / "clips" / "from-table--1")
    assert f"from-table: stable grasps in frames {cut.frames[0]} to {cut.frames[-1]}" in printed
    assert abs(clip.frames.index(cut.frames[0]) - LYING) <= 3
    assert cut.frames[-1] == clip.frames[LYING + HOLDING - 1]
    assert "nats" in cut.provenance["found"]
    assert cut.image_file(0) is not None
    assert (out / "from-table--1" / "result.json").is_file()
    status, printed, _ = run("reconstruct", "--find-grasps", folder, "--out", out, *search)
    assert status == 0
    result, _ = read_result(out / "from-table")
    assert result.frames == clip.frames
    assert [one.state for one in result.segments] == ["static", "grasp"]
    assert result.segments[1].first == cut.frames[0]
    assert (out / "clips" / "from-table" / "frames" / f"{clip.frames[0]}.jpg").is_file()
