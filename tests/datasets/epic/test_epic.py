"""EPIC-Grasps: the traps of its table, clips from small files of EPIC's and VISOR's layouts, candidates."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from conftest import FullDisk, Run
from hypothesis import given
from hypothesis import strategies as st
from visor_files import box, dense, hand, sparse, thing, write, write_mapping

from getagrip.clip import read_clip, read_masks
from getagrip.datasets.epic import candidates as epic_candidates
from getagrip.datasets.epic import clips as epic
from getagrip.datasets.epic import files as epic_files
from getagrip.datasets.epic import visor
from getagrip.datasets.epic.images import Frames, Video
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.model import hand_track
from getagrip.io import arrays

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "epic"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="no real data beside the checkout")
TABLE, ERRATA = DATA / "epicgrasps_2431.csv", DATA / "epicgrasps_2431_errata.csv"
COLUMNS = ("vid", "st_bound", "ed_bound", "st", "ed", "contact", "handside", "cat", "hos_name", "mp4_name", "set_name",
           "round", "duration", "n_unfiltered_masks", "n_filtered_masks", "good_CAD", "example", "fmt",
           "ablate_inithand")  # fmt: skip
V = "P01_101"
"""A video of the extension: 50 frames a second."""


def row(**changed: object) -> dict[str, object]:
    """A row of the table: a bottle in the left hand, frames 1000 to 1099."""
    values = {
        "vid": V, "st_bound": 900, "ed_bound": 1300, "st": 1000, "ed": 1099, "contact": 1010, "handside": "left hand",
        "cat": "bottle", "hos_name": "olive oil bottle", "mp4_name": f"{V}_900_1010_1300_left_bottle.mp4",
        "set_name": "Set001", "round": "round1", "duration": 100, "n_unfiltered_masks": 100, "n_filtered_masks": 90,
        "good_CAD": 1, "example": 0, "fmt": f"bottle/{V}_left_hand_1000_1099", "ablate_inithand": 0,
    }  # fmt: skip
    return values | changed


def write_table(path: Path, *rows: dict[str, object]) -> Path:
    with path.open("w", newline="") as stream:
        table = csv.DictWriter(stream, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    return path


# The table


@needs_data
def test_the_real_table_has_what_is_known_of_it() -> None:
    grasps = epic_files.read_grasps(TABLE)
    assert len(grasps) == 2426
    assert {*range(2431)} - {grasp.example for grasp in grasps} == {48, 149, 190, 229, 560}
    assert Counter(grasp.side for grasp in grasps) == {"left": 1445, "right": 981}
    assert len({grasp.video for grasp in grasps}) == 141
    assert len({epic_files.subject_of(grasp.video) for grasp in grasps}) == 31
    assert len({(grasp.video, grasp.category) for grasp in grasps}) == 390
    assert len({grasp.name for grasp in grasps}) == 2426  # clips' names differ
    assert sum(grasp.contact is None for grasp in grasps) == 405
    assert {grasp.category for grasp in grasps} == {*epic_files.CATEGORIES}
    rates = Counter(epic_files.numbering_rate(grasp.video) for grasp in grasps)
    assert rates == {50.0: 1198, 60.0: 1228}


@needs_data
def test_the_one_clip_whose_bounds_are_wrong_is_mended() -> None:
    (mended,) = [grasp for grasp in epic_files.read_grasps(TABLE) if grasp.note]
    assert (mended.example, mended.video) == (1994, "P28_109")
    assert (mended.start, mended.end, mended.frames) == (9616, 9854, 239)
    with TABLE.open(newline="") as stream:
        durations = {int(cells["example"]): int(cells["duration"]) for cells in csv.DictReader(stream)}
    assert all(grasp.frames == durations[grasp.example] for grasp in epic_files.read_grasps(TABLE))


@needs_data
def test_the_errata_turn_five_hands_and_take_one_clip_away() -> None:
    before = {grasp.example: grasp for grasp in epic_files.read_grasps(TABLE)}
    after = {grasp.example: grasp for grasp in epic_files.read_grasps(TABLE, ERRATA)}
    assert {*before} - {*after} == {1769}
    turned = {n for n, grasp in after.items() if grasp.side != before[n].side}
    assert turned == {54, 1334, 1593, 1831, 2031}
    assert {after[n].side for n in turned} == {"right"}
    assert Counter(grasp.side for grasp in after.values()) == {"left": 1439, "right": 986}
    with ERRATA.open(newline="") as stream:  # names as the errata give them
        for cells in csv.DictReader(stream):
            if cells["ACTION"] == "REMAKE":
                category, _, rest = cells["fmt"].partition("/")
                assert after[int(cells["example"])].name == rest.replace("right_hand", f"right_{category}")
    assert epic_files.errata_beside(TABLE) == ERRATA


@needs_data
def test_frames_are_numbered_at_one_rate_whatever_the_video_has() -> None:
    """EPIC-100's labels have times and frames: frames / seconds is what they were numbered at."""
    with (DATA / "EPIC_100_validation.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    late = [cells for cells in rows if int(cells["stop_frame"]) > 20_000]
    for cells in late:
        hours, minutes, seconds = map(float, cells["stop_timestamp"].split(":"))
        rate = int(cells["stop_frame"]) / (3600 * hours + 60 * minutes + seconds)
        assert rate == pytest.approx(epic_files.numbering_rate(cells["video_id"]), abs=0.01)
    assert len(late) > 1000


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"st": "x"}, ("line 3, st", "got 'x'")),
        ({"st": 0}, ("line 3, st",)),
        ({"ed": 999, "fmt": "other"}, ("line 3, duration", "st 1000 to ed 999")),
        ({"duration": 99, "fmt": "other_0_9"}, ("line 3, duration",)),
        ({"handside": "left"}, ("line 3, handside", "left hand or right hand")),
        ({"cat": "spoon"}, ("line 3, cat", "bottle")),
        ({"vid": "../P01_01"}, ("line 3, vid",)),
        ({"hos_name": ""}, ("line 3, hos_name",)),
        ({"contact": 1.5}, ("line 3, contact",)),
        ({"fmt": f"bottle/{V}_left_hand_1000_1099"}, ("fmt", "twice")),
    ],
)
def test_a_wrong_cell_is_named(
    tmp_path: Path, refused: Callable[..., str], changed: dict[str, object], words: tuple[str, ...]
) -> None:
    path = write_table(tmp_path / "t.csv", row(), row(example=1, fmt="bottle/other_1000_1099") | changed)
    refused(lambda: epic_files.read_grasps(path), str(path), *words)


def test_errata_must_fit_the_table(tmp_path: Path, refused: Callable[..., str]) -> None:
    table = write_table(tmp_path / "t.csv", row())
    for action, fmt, words in [("DELETE", "x", "old_fmt"), ("BURN", row()["fmt"], "ACTION")]:
        wrong = write_table(tmp_path / "e.csv", {"ACTION": action, "old_fmt": fmt, "correct_handside": "right hand"})
        refused(lambda path=wrong: epic_files.read_grasps(table, path), str(wrong), f"line 2, {words}")


@given(cut=st.integers(0, 2000), swap=st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 255)), max_size=4))
def test_damaged_tables_are_told_or_read(
    tmp_path_factory: pytest.TempPathFactory, cut: int, swap: list[tuple[int, int]]
) -> None:
    path = write_table(tmp_path_factory.mktemp("t") / "t.csv", row(), row(example=1, fmt="bottle/other_1000_1099"))
    content = bytearray(path.read_bytes())
    for at, byte in swap:
        content[at % len(content)] = byte
    path.write_bytes(content[: max(len(content) - cut, 0)] if cut % 2 else content)
    for read in (epic_files.read_grasps, lambda p: epic_files.read_actions([p])):
        with suppress(InputError):
            read(path)


# Clips

OFFSET = 2
"""VISOR's numbers are so much higher than EPIC's."""
OBJECT, FRONT, HAND, OTHER_HAND, HOB = (
    box(400, 200, 499, 349), box(400, 200, 449, 229), box(360, 240, 420, 300), box(520, 210, 560, 260),
    box(0, 0, 853, 479),
)  # fmt: skip


def scene(scale: float = 1.0, *, hidden: bool = False) -> list[dict[str, Any]]:
    """A bottle in the left hand before the hob, a spoon in front of its corner, and the right hand beside."""

    def at(polygon: list[list[float]]) -> list[list[float]]:
        return (np.array(polygon) * scale).tolist()

    bottle = [] if hidden else [thing("b", "olive oil bottle", 15, at(OBJECT))]
    return [
        *bottle,
        hand("left", "b", at(HAND)),
        hand("right", "hand-not-in-contact", at(OTHER_HAND)),
        thing("s", "spoon", 1, at(box(440, 330, 520, 400))),
        thing("h", "hob", 24, at(HOB)),
    ]


@pytest.fixture
def epic_folder(tmp_path: Path) -> Path:
    """A table of one grasp, VISOR's dense and sparse annotations of it, and EPIC's images."""
    root = tmp_path / "epic"
    ends = (1000 + OFFSET, 1080 + OFFSET)
    numbers = [n for n in range(1000, 1081) if not 1020 <= n < 1040]  # interpolations are not always good enough
    write(root / "visor" / "dense" / f"{V}_interpolations.json",
          [dense(V, n + OFFSET, ends, *scene(hidden=n == 1050)) for n in [990, *numbers]])  # fmt: skip
    write(root / "visor" / f"{V}.json", [sparse(V, 1080 + OFFSET, *scene(1920 / 854))])
    write_mapping(root / "visor" / "frame_mapping.json", V, {n: n - OFFSET for n in ends})
    write_table(root / "grasps.csv", row())
    images = root / "images" / "P01" / "rgb_frames" / V
    images.mkdir(parents=True)
    for n in range(1000, 1100):
        cv2.imwrite(str(images / f"frame_{n:010d}.jpg"), np.full((256, 456, 3), n % 256, np.uint8))
    return root


def hand_arrays(frames: int) -> dict[str, Any]:
    """A generic left hand half a metre before the camera."""
    T = np.tile(se3.rigid(None, np.array([0.0, 0.0, 0.5])), (frames, 1, 1))
    track = hand_track(generic.load("left").with_shape().with_pose(np.zeros((frames, 45))), T)
    regions = {f"region_{name}": ids for name, ids in track.regions.items()}
    return {"vertices": track.vertices, "faces": track.faces, "T_cam_hand": track.T_cam_hand} | regions


def import_epic(run: Run, root: Path, *more: object) -> tuple[int, str, str]:
    return run("import", "epic", root / "grasps.csv", "--visor", root / "visor", "--frames", root / "images",
               "--out", root / "out", *more)  # fmt: skip


NAME = f"{V}_left_bottle_1000_1099"


def test_a_clip_without_hands_has_all_else_and_gets_them_later(run: Run, epic_folder: Path) -> None:
    status, out, err = import_epic(run, epic_folder)
    assert status == 0, err
    folder = epic_folder / "out" / NAME
    assert str(folder) in out
    assert "lack their hand.npz" in err
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


def test_clips_that_the_disk_has_no_room_for_are_told_and_made_the_next_time(
    run: Run, epic_folder: Path, full_disk: FullDisk
) -> None:
    rng = np.random.default_rng(0)
    for image in (epic_folder / "images").rglob("*.jpg"):
        cv2.imwrite(str(image), rng.integers(0, 256, (256, 456, 3), np.uint8))
    with full_disk(100_000):
        status, out, err = import_epic(run, epic_folder)
    assert status == 1
    assert "0 clips, 0 already there, 1 failed" in out
    assert str(epic_folder / "out" / NAME / "frames" / "0000001000.jpg") in err
    assert list((epic_folder / "out").iterdir()) == []
    status, out, _ = import_epic(run, epic_folder)
    assert status == 0
    assert "1 clips, 0 already there" in out
    assert all(cv2.imread(str(image)) is not None for image in (epic_folder / "out" / NAME / "frames").iterdir())


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
    border = np.count_nonzero(masks.object[-1] ^ expected)  # people's own, 1920 x 1080
    assert 0 < border < 600
    images = sorted((clip.folder / "frames").glob("*.jpg"))
    assert [path.stem for path in images] == list(clip.frames)
    image = cv2.imread(str(images[3]))
    assert image.shape == (480, 854, 3)
    assert abs(image.mean() - int(images[3].stem) % 256) < 2
    assert "1 frames annotated by people, 29 interpolated" in clip.provenance["masks"]


def test_hand_files_may_say_which_frames_and_camera_they_have(run: Run, epic_folder: Path) -> None:
    (epic_folder / "hands").mkdir()
    known = np.arange(1001, 1061, 2)
    content = hand_arrays(len(known))
    content["T_cam_hand"][:, 0, 3] = known / 1e5  # to tell the frames apart
    K = np.array([[600.0, 0, 427], [0, 600, 240], [0, 0, 1]])
    arrays.write(epic_folder / "hands" / f"{NAME}.npz", content | {"frames": known, "K": K})
    status, _, err = import_epic(run, epic_folder, "--hands", epic_folder / "hands")
    assert status == 0, err
    clip = read_clip(epic_folder / "out" / NAME)
    numbers = np.array([int(name) for name in clip.frames])
    assert {*numbers.tolist()} == {*known.tolist()} - {*range(1020, 1040), 1050}
    np.testing.assert_allclose(clip.hand.T_cam_hand[:, 0, 3], numbers / 1e5)
    np.testing.assert_array_equal(clip.K[0], K)


def test_meshes_and_cameras_are_brought_along(run: Run, epic_folder: Path, refused: Callable[..., str]) -> None:
    from getagrip.geometry.mesh import write_mesh

    (epic_folder / "cad").mkdir()
    write_mesh(epic_folder / "cad" / "bottle.obj", CATEGORIES["can"].make())
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
    mesh, _ = epic.category_mesh("bottle", epic_folder / "cad")
    assert len(mesh.vertices) == len(CATEGORIES["can"].make().vertices)
    refused(lambda: epic.category_mesh("pan", epic_folder / "cad"), "no pan.obj")
    (epic_folder / "cameras" / f"{V}.json").write_text('{"camera": {"model": "FISHEYE"}}')
    refused(lambda: epic.read_camera(epic_folder / "cameras" / f"{V}.json"), "camera")


@needs_data
@pytest.mark.parametrize("category", epic_files.CATEGORIES)
def test_the_authors_meshes_are_read_and_ours_stand_for_them(category: str) -> None:
    theirs, _ = epic.category_mesh(category, DATA / "cad")
    ours, _ = epic.category_mesh(category, None)
    assert theirs.is_closed
    assert ours.is_closed
    assert 0.5 < ours.diameter / theirs.diameter < 2.0


def test_what_is_missing_is_told_and_the_rest_is_done(run: Run, epic_folder: Path) -> None:
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
    assert "VISOR's files of 1 videos are not there" in err
    assert "no frame_mapping.json" in err
    assert "frame_0000001004.jpg" in err
    assert not (epic_folder / "out" / NAME).exists()


def test_calls_that_make_no_sense_are_refused(run: Run, epic_folder: Path) -> None:
    table, visor_folder, out = epic_folder / "grasps.csv", epic_folder / "visor", epic_folder / "out"
    call = ("import", "epic", table, "--visor", visor_folder, "--out", out)
    assert run(*call)[0] == 2
    assert run(*call, "--frames", "a", "--videos", "b")[0] == 2
    assert run(*call, "--frames", "a", "--focal", "1")[0] == 2
    assert run(*call, "--frames", "a", "--focal", "500", "--cameras", "b")[0] == 2
    assert not out.exists()


def test_frames_of_a_video_are_those_at_their_times(tmp_path: Path) -> None:
    """59.94 images a second, numbered at 60, as EPIC-55 has them: each number is the image shown at its time."""
    import av

    video, rate, count = "P01_01", 60_000 / 1001, 250
    with av.open(str(tmp_path / f"{video}.MP4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=Fraction(60_000, 1001))
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = 64, 48, "yuv420p", 400_000
        for n in range(count):
            image = np.zeros((48, 64, 3), np.uint8)
            image[:, :32], image[:, 32:] = 16 * (n // 16), 16 * (n % 16)  # its number, in two digits
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    numbers = [1, 2, 150, 151, 249]
    for number, image in zip(numbers, Video(tmp_path, video)(numbers), strict=True):
        assert image.shape == (480, 854, 3)
        digits = np.round(np.array([image[:, :400].mean(), image[:, 450:].mean()]) / 16)
        assert 16 * digits[0] + digits[1] == round((number - 1) / 60 * rate)
    with pytest.raises(InputError, match="no frame 5000"):
        Video(tmp_path, video)([200, 5000])
    with pytest.raises(InputError, match=r"P09_01\.MP4"):
        Video(tmp_path, "P09_01")([1])
    (tmp_path / "P08_01.MP4").write_bytes(b"no video")
    with pytest.raises(InputError, match="does not decode"):
        Video(tmp_path, "P08_01")([1])


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
        refused(lambda: epic.hand_file(path), str(path), key)
    arrays.write(path, hand_arrays(3))
    refused(lambda: epic.hand_file(path).track([1, 2]), str(path), "vertices", "(2, any, 3)")


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
        (path, lambda: epic.read_camera(path)),
        (path, lambda: epic.hand_file(path)),
    ]
    for file, read in reads:
        with pytest.raises(InputError) as caught:
            read()
        assert str(file) in str(caught.value)


def test_a_huge_image_is_refused_by_its_header(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / V).mkdir()
    path = tmp_path / V / "frame_0000000001.jpg"
    content = bytearray(cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    at = content.index(b"\xff\xc0")
    content[at + 5 : at + 9] = b"\xff\xff\xff\xff"
    path.write_bytes(content)
    refused(lambda: Frames(tmp_path, V)([1]), str(path), "65535 x 65535")


# Candidates


def visor_frame(number: int, *annotations: dict[str, Any], tmp: Path) -> visor.Frame:
    return next(visor.read_frames(write(tmp / f"{V}.json", [sparse(V, number, *annotations)])))


def actions(*bounds: tuple[int, int], narration: str = "take cup", noun: str = "cup") -> list[epic_files.Action]:
    return [epic_files.Action(V, a, b, narration, noun) for a, b in bounds]


def test_contacts_are_of_hands_and_of_what_their_gloves_touch(tmp_path: Path) -> None:
    cup, pan = thing("c", "coffee cup", 13, box(0, 0, 9, 9)), thing("p", "pan", 5, box(0, 0, 9, 9))
    glove = thing("g", "right glove", 304, box(0, 0, 9, 9), in_contact_object="p", on_which_hand=["right hand"])
    knife = thing("k", "knife", 4, box(0, 0, 9, 9))
    frame = visor_frame(7, cup, pan, knife, glove, hand("left", "c", box(0, 0, 5, 5)), hand("right", "g"), tmp=tmp_path)
    (found,) = epic_candidates.contacts([frame], visor.Mapping({7: 5}))
    assert {(c.frame, c.side, c.category, c.entity) for c in found} == {
        (5, "left", "cup", "coffee cup"),
        (5, "right", "pan", "pan"),
    }
    nameless = thing("", "cup", 13, box(0, 0, 9, 9))
    idle = visor_frame(8, nameless, hand("left", "hand-not-in-contact"), hand("right", None), tmp=tmp_path)
    assert epic_candidates.contacts([idle], visor.Mapping({})) == [[]]
    free = visor_frame(8, cup, hand("left", "k", box(0, 0, 5, 5)), knife, tmp=tmp_path)
    assert epic_candidates.contacts([free], visor.Mapping({})) == [[]]  # marked, and no category


def test_contacts_that_follow_each_other_are_one_candidate() -> None:
    def touch(frame: int, side: Any = "left", entity: str = "cup") -> epic_candidates.Contact:
        return epic_candidates.Contact(frame, side, entity.rpartition(" ")[2], entity)

    labelled = actions((1, 20), (30, 60), (50, 90), (100, 140), (150, 180), (190, 220))
    touching = [[touch(55)], [touch(70), touch(70, "right", "oil bottle")], [], [touch(160)]]
    found = epic_candidates.candidates(V, touching, labelled)
    assert [(c.side, c.entity, c.contacts, c.start_bound, c.end_bound) for c in found] == [
        ("left", "cup", (55, 70), 1, 180),
        ("right", "oil bottle", (70,), 1, 180),
        ("left", "cup", (160,), 50, 220),
    ]
    assert found[0].name == f"{V}_1_55_70_180_left_cup"
    assert found[0].narrations == ("take cup",) * 5
    assert epic_candidates.candidates(V, touching, []) == []  # nothing bounds them


@pytest.mark.parametrize(
    ("entity", "category"),
    [("olive oil bottle", "bottle"), ("saucepan", "saucepan"), ("Frying Pan", "pan"), ("bottle cap", None),
     ("passata bottle/tomato puree bottle", "bottle"), ("dustpan", None), ("", None)],
)  # fmt: skip
def test_categories_are_the_last_word(entity: str, category: str | None) -> None:
    assert epic_candidates.category_of(entity) == category


@needs_data
def test_the_real_table_follows_the_rules_by_which_candidates_are_made() -> None:
    """Contacts are in the names of EPIC-Grasps' videos, actions in EPIC-100's validation labels."""
    labels = epic_files.read_actions([DATA / "EPIC_100_validation.csv"])
    with TABLE.open(newline="") as stream:
        rows = [cells for cells in csv.DictReader(stream) if cells["vid"] in labels]
    exact, count = 0, 0
    for cells in rows:
        category = epic_candidates.category_of(cells["hos_name"])
        assert category == cells["cat"]
        frames = [int(n) for n in cells["mp4_name"].split("_")[3:-3]]
        if not frames:
            continue
        side = epic_files.SIDES[cells["handside"]]
        touching = [[epic_candidates.Contact(n, side, category, cells["hos_name"])] for n in frames]
        (made,) = epic_candidates.candidates(cells["vid"], touching, labels[cells["vid"]])
        count += 1
        exact += (made.start_bound, made.end_bound) == (int(cells["st_bound"]), int(cells["ed_bound"]))
        if (made.start_bound, made.end_bound) == (int(cells["st_bound"]), int(cells["ed_bound"])):
            assert f"{made.name}.mp4" == cells["mp4_name"]
    assert count > 300
    assert exact >= 0.97 * count


def test_candidates_are_written_as_a_table_and_as_json(run: Run, tmp_path: Path) -> None:
    cup = thing("c", "cup", 13, box(0, 0, 9, 9))
    frames = [sparse(V, n, cup, hand("left", "c", box(0, 0, 5, 5))) for n in (52, 82)]
    write(tmp_path / "visor" / f"{V}.json", [*frames, sparse(V, 300, cup, hand("left", "hand-not-in-contact"))])
    write(tmp_path / "visor" / "P02_01.json", [])
    write_mapping(tmp_path / "visor" / "frame_mapping.json", V, {52: 50, 82: 80, 300: 298})
    label = {"video_id": V, "start_frame": 40, "stop_frame": 90, "narration": "wash cup", "noun": "cup"}
    table = write_table(tmp_path / "labels.csv", label)
    out, found = tmp_path / "made" / "c.csv", tmp_path / "c.json"
    call = ("epic", "candidates", "--visor", tmp_path / "visor", "--actions", table, "--json", found)
    status, said, err = run(*call, "--out", tmp_path / "c.csv")
    assert status == 1, err  # the mapping knows nothing of the other video
    assert "frame_mapping.json: P02_01" in err
    assert "1 candidates" in said
    with (tmp_path / "c.csv").open(newline="") as stream:
        (cells,) = csv.DictReader(stream)
    assert cells == {
        "vid": V, "st_bound": "40", "ed_bound": "90", "contact": "-1", "handside": "left hand", "cat": "cup",
        "hos_name": "cup", "mp4_name": f"{V}_40_50_80_90_left_cup.mp4",
    }  # fmt: skip
    (one,) = json.loads(found.read_text())
    assert one["contacts"] == [50, 80]
    assert one["narrations"] == ["wash cup"]
    assert one["seconds"] == 51 / 50
    assert run(*call, "--categories", "pan", "--out", tmp_path / "p.csv")[0] == 1
    assert len((tmp_path / "p.csv").read_text().splitlines()) == 1
    assert run(*call, "--categories", "spoon", "--out", out)[0] == 2
