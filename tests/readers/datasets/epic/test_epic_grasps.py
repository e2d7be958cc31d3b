"""Clips of EPIC-Grasps and timelines of EPIC-HIT, from small files of EPIC's and VISOR's layouts."""

from __future__ import annotations

import json
import pickle
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import Float
from numpy import ndarray

from getagrip.cli.datasets import ImportEpic
from getagrip.clip import Clip, read_clip, read_masks
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io import arrays
from getagrip.readers.datasets.epic import epic_clips, epic_grasps, epic_images, epic_tables
from getagrip.readers.datasets.epic.epic_grasps import EpicGrasps
from getagrip.readers.datasets.epic.epic_images import Frames
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES
from helpers.environment import DATA, Run, needs
from helpers.epic_files import NAME, V, hand_arrays, import_epic, row, write_epic, write_table, write_timeline
from helpers.folders import FullDisk


@pytest.mark.slow
def test_a_clip_without_hands_has_all_else_and_gets_them_later(run: Run, epic_folder: Path) -> None:
    status, out, err = import_epic(run, epic_folder)
    assert status == 0, err
    folder = epic_folder / "out" / NAME
    assert str(folder) in out
    assert "lacks its hand.npz" in err
    assert "guess" in err
    with pytest.raises(InputError, match=r"hand\.npz"):
        read_clip(folder)
    content = json.loads((folder / "clip.json").read_text())
    assert content["scale"] == "free"
    assert content["fps"] == 50.0
    assert content["provenance"]["subject"] == "P01"
    assert "missing" in content["provenance"]["hands"]
    assert len(content["frames"]) == 30
    numbers = [int(name) for name in content["frames"]]
    assert (numbers[0], numbers[-1]) == (1000, 1080)  # EPIC's numbers
    np.testing.assert_allclose(content["times"], np.array(numbers) / 50.0)
    assert not {*range(1020, 1040), 1050} & {*numbers}  # valid ones only
    assert np.diff([n - 20 * (n > 1020) for n in numbers]).max() <= 4  # evenly

    status, out, _ = import_epic(run, epic_folder)
    assert status == 0
    assert "already there" in out

    (epic_folder / "hands").mkdir()
    arrays.write(epic_folder / "hands" / f"{NAME}.npz", hand_arrays(30))
    status, _, err = import_epic(run, epic_folder, "--hands", epic_folder / "hands", "--focal", 500)
    assert status == 0, err
    assert "lack" not in err
    clip = read_clip(folder)
    assert clip.frames == tuple(content["frames"])
    assert clip.K[0, 0, 0] == 500.0


@pytest.mark.slow
def test_clips_that_the_disk_has_no_room_for_are_reported_and_made_the_next_time(
    run: Run, epic_folder: Path, full_disk: FullDisk
) -> None:
    rng = np.random.default_rng(0)
    for image in (epic_folder / "images").rglob("*.jpg"):
        cv2.imwrite(str(image), rng.integers(0, 256, (256, 456, 3), np.uint8))
    with full_disk(100_000):
        status, out, err = import_epic(run, epic_folder)
    assert status == 1
    assert "0 clips, 0 already there, 1 of 1 videos failed" in out
    assert str(epic_folder / "out" / NAME / "frames" / "0000001000.jpg") in err
    assert [path.name for path in (epic_folder / "out").iterdir()] == ["ledger.sqlite"]
    status, out, _ = import_epic(run, epic_folder)
    assert status == 0
    assert "1 clip, 0 already there" in out
    assert all(cv2.imread(str(image)) is not None for image in (epic_folder / "out" / NAME / "frames").iterdir())


def test_videos_can_be_sent_to_other_processes(epic_folder: Path) -> None:
    dataset = ImportEpic(csv=epic_folder / "grasps.csv", visor=epic_folder / "visor", frames=epic_folder / "images")
    parts = dataset.parts(print)
    assert pickle.loads(pickle.dumps(parts)) == parts
    assert [part.name for part in parts] == [V]


@pytest.mark.slow
def test_masks_are_the_polygons_and_hands_and_things_in_front_are_ignored(run: Run, epic_folder: Path) -> None:
    (epic_folder / "hands").mkdir()
    arrays.write(epic_folder / "hands" / f"{NAME}.npz", hand_arrays(30))
    status, _, err = import_epic(run, epic_folder, "--hands", epic_folder / "hands")
    assert status == 0, err
    clip = read_clip(epic_folder / "out" / NAME)
    masks = read_masks(clip)
    assert clip.size == (854, 480)
    expected = np.zeros((480, 854), bool)
    expected[200:350, 400:500] = True
    assert all((mask == expected).all() for mask in masks.object[:-1])  # drawn in their own pixels
    ignored = np.zeros((480, 854), bool)
    ignored[240:301, 360:421] = ignored[210:261, 520:561] = ignored[330:401, 440:521] = True  # both hands, the spoon
    assert all((mask == ignored & ~expected).all() for mask in masks.ignore[:-1])  # and not the hob behind
    assert masks.hand is not None
    one = np.zeros((480, 854), bool)
    one[240:301, 360:421] = True
    assert all((mask == one & ~expected).all() for mask in masks.hand[:-1])
    border = np.count_nonzero(masks.object[-1] ^ expected)  # people's own, 1920 x 1080
    assert 0 < border < 600
    images = sorted((clip.folder / "frames").glob("*.jpg"))
    assert [path.stem for path in images] == list(clip.frames)
    image = cv2.imread(str(images[3]))
    assert image.shape == (480, 854, 3)
    assert abs(image.mean() - int(images[3].stem) % 256) < 2
    assert "1 frames annotated by people, 29 interpolated" in clip.provenance["masks"]


@pytest.mark.slow
def test_hand_files_may_say_which_frames_and_camera_they_have(run: Run, epic_folder: Path) -> None:
    (epic_folder / "hands").mkdir()
    known = np.arange(1001, 1061, 2)
    content = hand_arrays(len(known))
    content["T_cam_hand"][:, 0, 3] = known / 1e5  # so that the frames differ
    K = np.array([[600.0, 0, 427], [0, 600, 240], [0, 0, 1]])
    arrays.write(epic_folder / "hands" / f"{NAME}.npz", content | {"frames": known, "K": K})
    status, _, err = import_epic(run, epic_folder, "--hands", epic_folder / "hands")
    assert status == 0, err
    clip = read_clip(epic_folder / "out" / NAME)
    numbers = np.array([int(name) for name in clip.frames])
    assert {*numbers.tolist()} == {*known.tolist()} - {*range(1020, 1040), 1050}
    content = json.loads((clip.folder / "clip.json").read_text())
    assert len(content["frames"]) == 30  # the others may get a hand later
    assert {*clip.frames} < {*content["frames"]}
    assert all((clip.folder / "frames" / f"{name}.jpg").is_file() for name in content["frames"])
    assert content["provenance"]["frames_without_hand"].count(",") == 29 - len(clip.frames)
    assert read_masks(clip).observed.all()
    np.testing.assert_allclose(clip.hand.T_cam_hand[:, 0, 3], numbers / 1e5)
    np.testing.assert_array_equal(clip.K[0], K)


@pytest.mark.slow
def test_meshes_and_cameras_are_brought_along(run: Run, epic_folder: Path, refused: Callable[..., str]) -> None:
    from getagrip.geometry.mesh_files import write_mesh

    (epic_folder / "cad").mkdir()
    write_mesh(SYNTHETIC_CATEGORIES["can"](), epic_folder / "cad" / "bottle.obj")
    (epic_folder / "cameras").mkdir()
    camera = {"id": 1, "model": "OPENCV", "width": 456, "height": 256, "params": [240, 250, 228, 128, 0.1, 0, 0, 0]}
    (epic_folder / "cameras" / f"{V}.json").write_text(json.dumps({"images": {}, "camera": camera, "points": []}))
    status, _, err = import_epic(run, epic_folder, "--cad", epic_folder / "cad", "--cameras", epic_folder / "cameras")
    assert status == 0, err
    assert "guess" not in err
    content = json.loads((epic_folder / "out" / NAME / "clip.json").read_text())
    np.testing.assert_allclose(
        content["camera"]["K"], [[240 * 854 / 456, 0, 427], [0, 250 * 480 / 256, 240], [0, 0, 1]]
    )
    mesh, _ = epic_clips.category_mesh("bottle", epic_folder / "cad")
    assert len(mesh.vertices) == len(SYNTHETIC_CATEGORIES["can"]().vertices)
    refused(lambda: epic_clips.category_mesh("pan", epic_folder / "cad"), "no pan.obj")
    (epic_folder / "cameras" / f"{V}.json").write_text('{"camera": {"model": "FISHEYE"}}')
    refused(lambda: epic_clips.read_epic_camera(epic_folder / "cameras" / f"{V}.json"), "camera")


@needs(DATA / "epic")
@pytest.mark.parametrize("category", epic_tables.EPIC_CATEGORIES)
def test_the_authors_meshes_are_read_and_ours_stand_for_them(category: str) -> None:
    theirs, _ = epic_clips.category_mesh(category, DATA / "epic" / "cad")
    ours, _ = epic_clips.category_mesh(category, None)
    assert theirs.is_closed
    assert ours.is_closed
    assert 0.5 < ours.diameter / theirs.diameter < 2.0


@pytest.mark.slow
def test_what_is_missing_is_reported_and_the_rest_is_done(run: Run, epic_folder: Path) -> None:
    write_table(
        epic_folder / "grasps.csv",
        row(),
        row(example=1, st=2000, ed=2099, fmt=f"bottle/{V}_left_hand_2000_2099"),
        row(example=2, vid="P02_01", fmt="bottle/P02_01_left_hand_1000_1099"),
    )
    (epic_folder / "visor" / "frame_mapping.json").unlink()
    (epic_folder / "images" / "P01" / "rgb_frames" / V / "frame_0000001004.jpg").write_bytes(b"\xff\xd8 no image")
    status, _, err = import_epic(run, epic_folder)
    assert status == 1
    assert "0 of its 100 frames have a mask of 'olive oil bottle'" in err
    assert "VISOR's files of 1 video are missing" in err
    assert "no frame_mapping.json" in err
    assert "frame_0000001004.jpg" in err
    assert not (epic_folder / "out" / NAME).exists()


@pytest.mark.slow
def test_calls_that_make_no_sense_are_refused(run: Run, epic_folder: Path) -> None:
    table, visor_folder, out = epic_folder / "grasps.csv", epic_folder / "visor", epic_folder / "out"
    call = ("import", "epic", table, "--visor", visor_folder, "--out", out)
    assert run(*call)[0] == 2
    assert run(*call, "--frames", "a", "--videos", "b")[0] == 2
    assert run(*call, "--frames", "a", "--focal", "1")[0] == 2
    assert run(*call, "--frames", "a", "--focal", "500", "--cameras", "b")[0] == 2
    assert not out.exists()


def test_a_hand_file_that_does_not_fit_is_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    path = tmp_path / "h.npz"
    for key, value in [
        ("frames", np.zeros(3)),
        ("frames", np.array([1, 1, 2])),
        ("frames", np.zeros((0,), int)),
        ("K", np.full((3, 3), np.nan)),
        ("K", np.eye(3)),
    ]:
        arrays.write(path, hand_arrays(3) | {key: value})
        refused(lambda: epic_clips.read_epic_hand_file(path), str(path), key)
    arrays.write(path, hand_arrays(3))
    refused(lambda: epic_clips.read_epic_hand_file(path).track([1, 2]), str(path), "vertices", "(2, any, 3)")


@given(content=st.binary(max_size=64), header=st.booleans())
def test_any_bytes_for_images_cameras_and_hands_are_refused_in_words(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, header: bool
) -> None:
    folder = tmp_path_factory.mktemp("bytes")
    (folder / V).mkdir()
    path = folder / V / "frame_0000000001.jpg"
    path.write_bytes(b"\xff\xd8\xff" * header + content)
    reads: list[tuple[Path, Callable[[], object]]] = [
        (path, lambda: Frames(folder, V)([1])),
        (path, lambda: epic_clips.read_epic_camera(path)),
        (path, lambda: epic_clips.read_epic_hand_file(path)),
    ]
    for file, read in reads:
        with pytest.raises(InputError) as caught:
            read()
        assert str(file) in str(caught.value)


EPIC = DATA / "epic"


@needs(EPIC)
def test_the_real_list() -> None:
    notes: list[str] = []
    found = epic_grasps.read_timelines(
        EPIC / "epic_hit.json", epic_tables.read_grasps(EPIC / "epicgrasps_2431.csv"), notes.append
    )
    assert len(found) == 93
    assert notes == ["epic_hit.json: 3 of 96 timelines are listed twice or empty: skipped"]
    states = Counter(segment.state for timeline in found for segment in timeline.segments)
    assert states == {"static": 135 - 5, "contact": 28, "grasp": 106 - 3}


@pytest.fixture
def T_world_cam() -> Float[ndarray, "90 4 4"]:
    rng = np.random.default_rng(0)
    return se3.rigid(se3.exp_so3(rng.normal(size=(90, 3))), rng.normal(size=(90, 3)))


@pytest.fixture
def root(tmp_path: Path, T_world_cam: ndarray) -> Path:
    write_timeline(write_epic(tmp_path), T_world_cam)
    return tmp_path


def clip_of(root: Path, note: Callable[[str], None] = lambda _: None) -> Clip | None:
    dataset = EpicGrasps(
        csv=root / "grasps.csv", visor=root / "visor", frames=root / "images", timelines=root / "hit.json",
        cameras=root / "cameras", metric=root / "metric",
    )  # fmt: skip
    made = [draft.make() for part in dataset.parts(note) for draft in part.drafts(lambda *_, **__: True, note)]
    return made[0][0] if made and made[0] else None


def test_a_timeline_has_segments_and_the_camera_in_a_metric_world(root: Path, T_world_cam: ndarray) -> None:
    clip = clip_of(root)
    assert clip is not None
    assert clip.world is not None
    numbers = np.array([int(name) for name in clip.frames])
    assert numbers.max() == 1080  # EPIC-Fields has 1000 to 1089, VISOR annotates up to 1080
    np.testing.assert_allclose(clip.world.T_world_cam, T_world_cam[numbers - 1000], atol=1e-9)
    np.testing.assert_array_equal(clip.world.up, [0.0, 0.0, 1.0])
    spans = [(s.state, numbers[s.first], numbers[s.last], s.side) for s in clip.segments]
    assert spans == [("static", 1000, 1019, None), ("contact", 1040, 1060, None), ("grasp", 1062, 1080, "left")]


@pytest.mark.parametrize(
    ("name", "change", "named"),
    [
        ("hit.json", lambda c: c[0].update(mp4_name="P01_101_x"), "mp4_name"),
        ("hit.json", lambda c: c[0].update(cat="cup"), "cat"),
        ("hit.json", lambda c: c[0].update(main_side="both"), "main_side"),
        ("hit.json", lambda c: c[0]["segments"][0].update(st=-1), "st"),
        (f"metric/{V}.json", lambda c: c["T"][0].__setitem__(0, 9.0), "T"),
        (f"metric/{V}.json", lambda c: c.update(T=[[1, 2], [3]]), "T"),
        (f"cameras/{V}.json", lambda c: c["images"].update({"frame_0000001003.jpg": [1, 1, 0, 0, 0, 0, 0]}), "images"),
        (f"cameras/{V}.json", lambda c: c["images"].update({"frame_0000001003.jpg": [1, 0, 0, 0, 1e9, 0, 0]}), "away"),
        (f"cameras/{V}.json", lambda c: c["images"].update({"one": []}), "frame"),
    ],
)
def test_broken_files_are_named(
    root: Path, name: str, change: Callable[[Any], None], named: str, refused: Callable[..., str]
) -> None:
    content = json.loads((root / name).read_text())
    change(content)
    (root / name).write_text(json.dumps(content))
    assert named in refused(lambda: clip_of(root), Path(name).name)


def test_videos_without_a_metric_world_are_skipped(root: Path) -> None:
    (root / "metric" / f"{V}.json").unlink()
    notes: list[str] = []
    assert clip_of(root, notes.append) is None
    assert any("1 timelines skipped" in note for note in notes)


def test_a_similarity_is_scale_and_motion(root: Path) -> None:
    scale, T = epic_images.read_metric_similarity(root / "metric" / f"{V}.json")
    assert scale == pytest.approx(0.4)
    assert se3.is_rigid(T[None]).all()
