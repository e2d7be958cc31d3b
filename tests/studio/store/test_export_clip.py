"""Files made of labels: hands that follow a shaking image, masks, the clip made of both; the footage found again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import av
import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.checks.intrinsics import compute_intrinsics
from getagrip.clip import read_clip, read_masks
from getagrip.errors import UsageError
from getagrip.fitting.hand.refine_hand import refine_hand
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.lens import Lens
from getagrip.geometry.mesh_files import write_mesh
from getagrip.geometry.rasterize import render_coverage
from getagrip.hands import generic
from getagrip.hands.from_2d.clicks import hands_from_clicks
from getagrip.io.files import is_portable_name
from getagrip.readers.footage import VideoFootage
from getagrip.studio.hands.stabilize_hands import stabilize_hands
from getagrip.studio.store import labels
from getagrip.studio.store.export_clip import footage_checksum, tasks_of_labels, write_labelled_clip_files
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.labels import OBJECT_LABEL, OCCLUDER_LABEL, FrameLabels, Labels
from getagrip.studio.store.marks import Grasp, Mark
from getagrip.studio.store.tasks import Task
from getagrip.synthetic.objects import plate
from helpers.clips import box
from helpers.environment import DATA, ROOT, Run, needs
from helpers.folders import contents

SIZE = (320, 240)
FOCAL = 320.0
K = np.array([[FOCAL, 0.0, 160.0], [0.0, FOCAL, 120.0], [0.0, 0.0, 1.0]])
LAST = 8


class Scene(NamedTuple):
    """A hand and a square above it, both in an image that shakes as a whole."""

    image: ndarray
    uv: ndarray
    """The hand's joints."""
    square: ndarray


def scene(n: int) -> Scene:
    rng = np.random.default_rng(0)
    posed = generic.load("right").with_shape().with_pose(np.full(45, 0.1))
    turn = se3.exp_so3(np.array([1.3, 0.0, 0.0])) @ se3.exp_so3(np.array([0.0, 1.2, 0.0]))
    T = se3.rigid(turn, np.array([0.0, 0.04, 0.45]))
    hand = render_coverage(se3.transform(T, posed.vertices), posed.faces, K, SIZE)
    square = np.array([[120.0, 20.0], [190.0, 25.0], [185.0, 85.0], [115.0, 80.0]])
    blots = sum(cv2.resize(rng.random((k, k, 3)), SIZE, interpolation=cv2.INTER_CUBIC) for k in (10, 40, 120))
    image = 40.0 + 40.0 * blots
    image[hand] = 0.5 * image[hand] + [90.0, 60.0, 50.0]
    mask = np.zeros(SIZE[::-1], np.uint8)
    cv2.fillPoly(mask, [square.astype(np.int32)], 1)
    image[mask > 0] = 0.5 * image[mask > 0] + [0.0, 60.0, 110.0]
    shake = np.array([9.0 * np.sin(1.9 * n), 7.0 * np.cos(1.3 * n) - 7.0])
    whole = np.column_stack([np.eye(2), shake])
    moved = cv2.warpAffine(np.clip(image, 0, 255).astype(np.uint8), whole, SIZE, borderMode=cv2.BORDER_REFLECT)
    return Scene(np.asarray(moved, np.uint8), project(K, se3.transform(T, posed.joints)) + shake, square + shake)


def labels_of(*keys: int) -> Labels:
    frames = {n: FrameLabels(scene(n).uv, (scene(n).square,)) for n in keys}
    return Labels("shaken.mp4", SIZE, "right", 25.0, 0, LAST, frames)


def image(n: int) -> ndarray:
    return scene(n).image


@pytest.mark.slow
def test_between_keys_hands_follow_the_footage() -> None:
    clicked = hands_from_clicks(labels_of(0, LAST).clicks, K, "right", 0, LAST)
    followed = stabilize_hands(clicked, 0, K, SIZE, image)
    truth = np.array([scene(n).uv for n in range(LAST + 1)])
    off = []
    for hands in (clicked, followed):
        assert hands.hand.joints is not None
        uv = project(K, se3.transform(hands.hand.T_cam_hand, hands.hand.joints))
        off.append(np.linalg.norm(uv - truth, axis=-1).mean(axis=1))
    assert off[0].max() > 8.0
    assert off[1].max() < 2.0
    np.testing.assert_array_equal(followed.hand.T_cam_hand[[0, LAST]], clicked.hand.T_cam_hand[[0, LAST]])


@pytest.mark.slow
def test_beyond_the_keys_too() -> None:
    clicked = hands_from_clicks({4: scene(4).uv}, K, "right", 0, LAST)
    followed = stabilize_hands(clicked, 0, K, SIZE, image).hand
    assert followed.joints is not None
    uv = project(K, se3.transform(followed.T_cam_hand, followed.joints))
    truth = np.array([scene(n).uv for n in range(LAST + 1)])
    assert np.linalg.norm(uv - truth, axis=-1).mean(axis=1).max() < 3.0


@pytest.mark.slow
def test_a_blank_image_moves_nothing() -> None:
    clicked = hands_from_clicks(labels_of(0, LAST).clicks, K, "right", 0, LAST)
    blank = np.full((*SIZE[::-1], 3), 90, np.uint8)
    followed = stabilize_hands(clicked, 0, K, SIZE, lambda _: blank)
    np.testing.assert_allclose(followed.hand.T_cam_hand, clicked.hand.T_cam_hand, atol=5e-3)


@pytest.mark.slow
def test_labels_become_a_clip(tmp_path: Path, run: Run) -> None:
    video = tmp_path / "shaken.mp4"
    with av.open(str(video), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = *SIZE, "yuv420p", 4_000_000
        for n in range(LAST + 1):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image(n), format="rgb24")))
        container.mux(stream.encode(None))
    done: list[int] = []
    made = write_labelled_clip_files(labels_of(0, LAST), image, Lens(), tmp_path / "made", done=done.append)
    assert done == [*range(1, LAST + 2)]
    assert made.confidence[0] == made.confidence[LAST] == 1.0
    assert sorted(made.confidence) == list(range(LAST + 1))
    write_mesh(box(0.1, 0.08, 0.002), tmp_path / "box.obj")
    words = made.command.split()[1:]
    words[words.index("shaken.mp4")] = str(video)
    words[words.index("MESH")], words[words.index("CLIP")] = str(tmp_path / "box.obj"), str(tmp_path / "shaken")
    status, _, err = run(*words)
    assert status == 0
    assert "a guess: the focal length" in err
    assert "a guess: the generic hand" in err
    clip = read_clip(tmp_path / "shaken")
    assert clip.frames == tuple(f"{n:06d}" for n in range(1, LAST + 2))
    masks = read_masks(clip)
    assert refine_hand(clip, masks)[0] is None  # nobody drew the hand: ignored is where it was fitted
    for n in range(LAST + 1):
        drawn = np.zeros(SIZE[::-1], np.uint8)
        cv2.fillPoly(drawn, [np.round(scene(n).square).astype(np.int32)], 1)
        both, either = (masks.object[n] & (drawn > 0)).sum(), (masks.object[n] | (drawn > 0)).sum()
        assert both / either > 0.9
        hand = render_coverage(
            se3.transform(clip.hand.T_cam_hand[n], clip.hand.vertices[n]), clip.hand.faces, clip.K[n], SIZE
        )
        assert (masks.ignore[n] | masks.object[n])[hand].all()
        assert not (masks.ignore[n] & masks.object[n]).any()


@pytest.mark.slow
def test_what_is_in_front_or_may_be_is_ignored(tmp_path: Path) -> None:
    front = scene(0).square + np.array([20.0, 0.0])
    given = labels_of(0)
    frames = {0: FrameLabels(scene(0).uv, (scene(0).square,), (front,))}
    write_labelled_clip_files(
        Labels(given.video, SIZE, given.side, given.fps, 0, 0, frames), image, Lens(focal=FOCAL), tmp_path / "made"
    )
    mask = cv2.imread(str(tmp_path / "made" / "masks" / "000001.png"), cv2.IMREAD_UNCHANGED)
    assert mask[50, 125] == OBJECT_LABEL
    assert mask[50, 170] == OCCLUDER_LABEL
    assert mask[5, 5] == 0
    u, v = scene(0).uv[9].astype(int)
    assert mask[v, u] == OCCLUDER_LABEL
    with np.load(tmp_path / "made" / "hand.npz") as file:
        assert "guess" not in str(file["provenance_camera"])
        assert "guess" in str(file["provenance_hands_scale"])


@pytest.mark.slow
def test_only_what_was_made_of_labels_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "letter.txt").write_text("dear")
    with pytest.raises(UsageError, match=r"made: exists already without 'hand\.npz' in it"):
        write_labelled_clip_files(labels_of(0), image, Lens(focal=FOCAL), tmp_path / "made", overwrite=True)
    assert contents(tmp_path) == {"made/letter.txt": b"dear"}


def test_too_little_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    for frames, words in (({0: FrameLabels(scene(0).uv)}, "polygons"), ({0: FrameLabels(object=())}, "joints")):
        with pytest.raises(UsageError, match=words):
            write_labelled_clip_files(
                Labels("a.mp4", SIZE, "right", 25.0, 0, 1, frames), image, Lens(), tmp_path / "made"
            )
    assert not list(tmp_path.iterdir())


def test_grasps_of_long_names_that_are_alike_have_files_of_their_own() -> None:
    """What tells them apart stands behind where a name is cut; or is no letter that a file may have."""
    footage: Any = None
    videos = ("v" * 150, "v" * 150 + "w", "a b", "a/b")
    ends = (70, 80)
    grasps = [
        Grasp(
            Task("key", video, None),
            Mark("m", "key", "ann", 10, end, "right", start_number=10, end_number=end),
            footage=footage,
        )
        for video in videos
        for end in ends
    ]
    names = {grasp.name for grasp in grasps}
    assert len(names) == len(videos) * len(ends)
    assert all(is_portable_name(name) and len(name) < 120 for name in names)


@pytest.mark.parametrize("names", [("cover", "picture-01"), ("a-01", "b-01")])
def test_images_without_a_unique_number_are_refused(tmp_path: Path, names: tuple[str, str]) -> None:
    """A clip would not find their hands, or take those of others."""

    def name(n: int) -> str:
        return names[n] if n < len(names) else f"picture-{n:02d}"

    with pytest.raises(UsageError, match=r"needs a unique number .* \(got (cover|a-01)\)"):
        write_labelled_clip_files(labels_of(0, LAST), image, Lens(focal=FOCAL), tmp_path / "made", name=name)
    assert not (tmp_path / "made").exists()


GIVEN = Labels("cup.mp4", (64, 48), "left", 30.0, 0, 2, {1: FrameLabels(object=())})


def task(path: Path, content: bytes | None = None) -> Task:
    if content is not None:
        path.write_bytes(content)
    return Task(path.stem, path.stem, path)


def test_a_checksum_finds_footage_under_another_name(tmp_path: Path) -> None:
    other, renamed = task(tmp_path / "other.mp4", b"another"), task(tmp_path / "take-3.mp4", b"the footage")
    given = replace(GIVEN, sha256=hashlib.sha256(b"the footage").hexdigest())
    assert tasks_of_labels(given, [other, renamed]) == [renamed]
    named = task(tmp_path / "cup.mp4", b"of the same name")
    assert tasks_of_labels(given, [named, other, renamed]) == [renamed]
    with pytest.raises(RefusedError, match="another file than the labelled one"):
        tasks_of_labels(given, [named, other])
    with pytest.raises(RefusedError, match="none has this name or checksum"):
        tasks_of_labels(given, [other])
    assert tasks_of_labels(GIVEN, [other, named]) == [named]
    with pytest.raises(RefusedError, match="no checksum"):
        tasks_of_labels(GIVEN, [other])


def test_the_checksum_of_a_folder_is_of_its_names_and_contents(tmp_path: Path) -> None:
    sums = []
    for name, content in (("a", b"1"), ("a", b"2"), ("b", b"2")):
        folder = tmp_path / str(len(sums))
        folder.mkdir()
        (folder / name).write_bytes(content)
        sums.append(footage_checksum(folder))
    assert len({*sums}) == 3
    assert footage_checksum((tmp_path / "0").rename(tmp_path / "moved")) == sums[0]


def test_labels_of_other_footage_leave_no_database_behind(tmp_path: Path, run: Run) -> None:
    footage = tmp_path / "take-3"
    footage.mkdir()
    for n in range(3):
        cv2.imwrite(str(footage / f"{n:04d}.png"), np.zeros((48, 64, 3), np.uint8))
    file, out = tmp_path / "labels.json", tmp_path / "out"
    labels.write_label_file(GIVEN, file)
    status, _, err = run("annotate", footage, "--out", out, "--import-labels", file)
    assert status == 1
    assert err.startswith(f"getagrip: {file} must be labels of the footage given (got labels of other footage")
    assert not out.exists()
    labels.write_label_file(replace(GIVEN, sha256=footage_checksum(footage)), file)
    assert run("annotate", footage, "--out", out, "--import-labels", file)[0] == 0
    assert run("annotate", footage, "--out", out, "--export")[0] == 1  # labels only: too few for a clip
    (again,) = out.glob("labels-*.json")
    assert labels.read_label_file(again).sha256 == footage_checksum(footage)


LABELS = ROOT / "tests" / "helpers" / "kitchen_plate_labels.json"
VIDEO = DATA / "egocentric" / "kitchen_plate.mp4"


@pytest.mark.slow
def test_the_labels_are_of_one_hand_and_one_plate() -> None:
    given = labels.read_label_file(LABELS)
    K, _ = compute_intrinsics(Lens(guess_focal=True), given.size)
    found = hands_from_clicks(given.clicks, K, given.side, given.first, given.last)
    assert np.sqrt(np.nanmean(found.residuals**2)) < 4.0
    assert not found.outliers.any()
    assert np.abs(found.shape).max() < 0.25
    assert found.hand.joints is not None
    tips = project(K, se3.transform(found.hand.T_cam_hand, found.hand.joints))[:, 4]
    outlines = given.label_maps()
    assert sorted(outlines) == sorted(given.frames)
    for n, drawn in outlines.items():  # the thumb lies on the rim
        v, u = np.nonzero(drawn == OBJECT_LABEL)
        to_plate = np.hypot(u + 0.5 - tips[n - given.first, 0], v + 0.5 - tips[n - given.first, 1]).min()
        assert to_plate < 0.1 * np.ptp(u)


@needs(VIDEO)
@pytest.mark.slow
@pytest.mark.long
def test_from_video_to_reconstruction(tmp_path: Path, run: Run) -> None:
    whole = labels.read_label_file(LABELS)
    first, last = 51, 57  # a part of it, for the sake of time
    frames = {n: frame for n, frame in whole.frames.items() if first <= n <= last}
    given = replace(whole, first=first, last=last, frames=frames)
    video = VideoFootage(VIDEO)
    try:
        made = write_labelled_clip_files(given, video.image, Lens(), tmp_path / "made")
    finally:
        video.close()
    assert min(made.confidence.values()) > 0.85
    write_mesh(plate(), tmp_path / "plate.obj")
    words = made.command.split()[1:]
    words[words.index(given.video)] = str(VIDEO)
    words[words.index("MESH")], words[words.index("CLIP")] = str(tmp_path / "plate.obj"), str(tmp_path / "plate_clip")
    status, _, err = run(*words)
    assert status == 0
    assert err.count("a guess") == 2
    assert run("reconstruct", tmp_path / "plate_clip", "--out", tmp_path / "results", "--inits", 8)[0] == 0
    result = json.loads((tmp_path / "results" / "plate_clip" / "result.json").read_text())
    with np.load(tmp_path / "results" / "plate_clip" / "result.npz") as file:
        assert file["iou"].mean() > 0.93
        assert file["iou"].min() > 0.85
        diameter = 2.0 * 0.11 * float(file["scale"])
    assert 0.17 < diameter < 0.32  # plates are; the hand's size and the camera are guesses
    assert len(result["assumptions"]) >= 3  # camera, hands, size
