"""A draft finds the hand, or says why not; what it writes is what the page and ``clip new`` take."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from getagrip.cli import calls
from getagrip.cli.annotate import DATABASE
from getagrip.cli.calls import command_of_call
from getagrip.cli.command import Command
from getagrip.cli.import_hands import HandFile
from getagrip.cli.reconstruct import Reconstruct
from getagrip.clip import read_clip, with_evidence
from getagrip.clip.depth import DEPTH_KEY
from getagrip.clip.read_arrays import read_hand
from getagrip.fitting.options import Options
from getagrip.io.images import read_mask
from getagrip.studio.hands.detect_hands import find_jumps, find_landmarks, is_cut
from getagrip.studio.hands.hand_selection import HandLandmarks
from getagrip.studio.jobs import CommandCall
from getagrip.studio.store.mark_store import Store
from helpers.environment import Run
from helpers.labelled_scene import HEIGHT, POINTS, RADIUS, WIDTH, SceneNets, middle, write_scene

DRAFT = ("draft", "scene.mp4", "--object", "cup", "--out", "out", "--no-page")


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("getagrip.studio.hands.load_models", lambda _: SceneNets())
    return write_scene(tmp_path / "scene.mp4", 8)


def quick_command(call: CommandCall) -> Command:
    """The command of a call, with few initial poses and frames."""
    command = command_of_call(call)
    return replace(command, options=Options(inits=8, frames=4)) if isinstance(command, Reconstruct) else command


@pytest.mark.slow
def test_hands_masks_and_marks_are_there(scene: Path, run: Run) -> None:
    status, out, err = run(*DRAFT, "--size-mm", "90")
    assert status == 0, err
    assert "the left hand in 8 of 8 frames" in out
    for words in (
        "hands_side: left: it looks like a left hand in 8 of 8 frames",
        "the generic hand has the size",
        "a guess: the focal length",
    ):
        assert words in err
    found = HandFile.of(scene.parent / "out" / "found" / "hand.npz")
    assert found.numbers == tuple(range(1, 9))
    assert found.side == "left"
    assert "MediaPipe" in str(found.provenance["hands"])
    hand = read_hand(found.path, 8)
    assert hand.joints_2d is not None
    np.testing.assert_allclose(hand.joints_2d, np.tile(POINTS, (8, 1, 1)))
    names = sorted(path.name for path in (found.path.parent / "masks").iterdir())
    assert names == [f"{n:06d}.png" for n in range(1, 9)]
    store = Store(scene.parent / "out" / DATABASE)
    (mark,) = store.marks.standing()
    store.close()
    assert (mark.interval, mark.side) == ((0, 7), "left")
    made = {path: path.stat().st_mtime_ns for path in found.path.parent.rglob("*")}
    status, out, _ = run(*DRAFT, "--size-mm", "95")
    assert status == 0
    assert "found before by the same options" in out
    assert made == {path: path.stat().st_mtime_ns for path in found.path.parent.rglob("*")}
    store = Store(scene.parent / "out" / DATABASE)
    assert {"mesh": "cup", "size_mm": 95.0}.items() <= store.settings.of(mark.mark).items()
    store.close()
    assert run(*DRAFT, "--interval", "1", "4")[0] == 0  # again, over it
    assert len(HandFile.of(found.path).numbers or ()) == 4


@pytest.mark.slow
def test_a_box_on_the_object_is_enough_for_masks_of_all_frames(
    scene: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    no_hand = np.zeros((HEIGHT, WIDTH), bool)  # the scene shows none
    monkeypatch.setattr("getagrip.studio.hands.detect_hands.hand_mask", lambda *_, **__: no_hand)
    x, y = (middle(1) - RADIUS - 3.0).tolist()
    box = ("--object-box", f"{x},{y},{2 * RADIUS + 6},{2 * RADIUS + 6}", "--interval", "2", "8")
    for n in range(8):
        assert cv2.imwrite(str(scene.parent / f"depth_{n}.png"), np.full((HEIGHT, WIDTH), 600 + n, np.uint16))
    depth = ("--depth", ".", "--depth-from", "realsense")
    status, _, err = run(*DRAFT, *box, *depth)
    assert status == 2
    assert "missing --depth-first: the number of the depth image of frame 000002" in err
    (scene.parent / "narrow").mkdir()
    assert cv2.imwrite(str(scene.parent / "narrow" / "2.png"), np.full((HEIGHT, WIDTH // 2), 600, np.uint16))
    status, _, err = run(*DRAFT, *box, "--depth", "narrow", *depth[2:])
    assert status == 1
    assert f"{WIDTH // 2} x {HEIGHT}" in err
    assert not (scene.parent / "out" / "found").exists(), "before any work"
    monkeypatch.setattr(calls, "command_of_call", quick_command)
    status, out, err = run(*DRAFT, *box, *depth, "--depth-first", "1")
    assert status == 0, err
    made = scene.parent / "out"
    (masks,) = made.glob("draft-*/masks")
    name = masks.parent.name
    assert f"{name}: IOU" in out
    assert [(out + err).count(f"{guess}: ") for guess in ("hands_focal", "hands_scale", "camera")] == [1, 1, 1]
    assert f"{Path('out/results') / name / 'report.html'}: the report" in out
    assert (made / "results" / name / "report.html").is_file()
    clip = with_evidence(read_clip(made / "clips" / name))
    assert clip.category == "cup"
    assert [clip.evidence[DEPTH_KEY].image(row).max() for row in range(7)] == pytest.approx(
        0.6 + 0.001 * np.arange(1, 8)
    )
    commands: list[list[str]] = []
    monkeypatch.setattr(calls, "run_call", lambda call: commands.append(call.words) or "")  # it has run above
    wide = ("--object-box", f"{x},{y},{3 * RADIUS},{2 * RADIUS + 6}", *box[2:])
    again, out, err = run(*DRAFT, *wide)  # over it
    assert again == 0, err
    assert [words[0] for words in commands if "--overwrite" in words] == ["clip", "reconstruct"]
    assert "--object-box: 31 % of it is empty at the right: is a part of the object missing?" in err
    assert f"depth images of the earlier {made / 'clips' / name} are left out" in out.replace("out/", f"{made}/")
    for n in range(1, 8):
        mask = read_mask(masks / f"{n + 1:06d}.png", (WIDTH, HEIGHT)).unpacked
        x, y = middle(n).astype(int)
        assert mask[y, x] == 1
        assert mask[5, 5] == 0


@pytest.mark.parametrize("box", ["2000,2000,5,5", "300,100,30,30", "-9,100,30,30", "nan,1,9,9", "9,9,0.4,30"])
def test_a_box_beside_the_image_is_refused_before_hands_are_looked_for(scene: Path, run: Run, box: str) -> None:
    assert scene.is_file()
    status, _, err = run(*DRAFT, "--object-box", box)
    assert status == 2
    assert f"320 x 240, 4 pixels or more on either side (got {box})" in err


def test_no_hand_and_no_models_are_said(scene: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("getagrip.studio.hands.load_models", lambda _: SceneNets(hands=False))
    status, _, err = run(*DRAFT)
    assert status == 2
    assert "no hand: palms were looked for in 8 frames" in err
    monkeypatch.undo()
    monkeypatch.chdir(scene.parent)
    status, _, err = run(*DRAFT, "--models", "nowhere")
    assert status == 1
    assert "getagrip doctor --fetch hands" in err


def test_a_hand_in_a_single_frame_is_no_grasp(scene: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = find_landmarks

    def in_one_frame(*asked: Any) -> HandLandmarks:
        landmarks = whole(*asked)
        gone = np.arange(len(landmarks.points)) != 3
        return replace(
            landmarks,
            points=np.where(gone[:, None, None], np.nan, landmarks.points),
            confidence=np.where(gone[:, None], 0.0, landmarks.confidence),
        )

    monkeypatch.setattr("getagrip.studio.hands.detect_hands.find_landmarks", in_one_frame)
    status, _, err = run(*DRAFT)
    assert status == 2
    assert "the left hand is found in 000004 only, of 8 frames: a grasp has two or more" in err
    assert "--interval must" not in err
    assert not list((scene.parent / "out").glob("draft-*"))


@pytest.mark.parametrize("box", ["1,2,3", "a,b,c,d", "1,2,3,-4"])
def test_a_box_is_four_numbers(scene: Path, run: Run, box: str) -> None:
    assert scene.is_file()
    assert run(*DRAFT, "--object-box", box)[0] == 2


def test_intervals_are_checked(scene: Path, run: Run) -> None:
    assert scene.is_file()
    status, _, err = run(*DRAFT, "--interval", "3", "90")
    assert status == 2
    assert "--interval must be two frames from 1 to 8" in err


def shots(path: Path) -> Path:
    """A video of two shots, four frames each."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 30)
        for n in range(8):
            image = np.full((HEIGHT, WIDTH, 3), 40 if n < 4 else 200, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    return path


def test_a_cut_is_said(scene: Path, run: Run) -> None:
    shots(scene)
    status, _, err = run(*DRAFT)
    assert status == 2
    assert "000005: the video is cut before this frame: choose --interval 1 4 or --interval 5 LAST" in err


def test_motion_is_no_cut() -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (24, 24, 3)).astype(np.uint8)
    assert not is_cut(image, np.roll(image, 5, axis=1))
    assert not is_cut(image, np.clip(image.astype(int) + 20, 0, 255).astype(np.uint8))
    assert is_cut(np.full_like(image, 30), image)


def test_a_jump_within_a_scene_is_found_and_motion_is_none() -> None:
    steady = [2.0 + np.sin(0.3 * n) for n in range(40)]
    assert find_jumps(steady) == []
    assert find_jumps([*steady[:20], 30.0, *steady[20:]]) == [21]
    assert find_jumps([0.0] * 10 + [0.5] + [0.0] * 10) == []  # a still scene flickers
    assert find_jumps([]) == find_jumps([9.0]) == []


def test_one_frame_is_no_video(scene: Path, run: Run) -> None:
    write_scene(scene, 1)
    status, _, err = run(*DRAFT)
    assert status == 2
    assert "VIDEO must have two frames or more (got 1)" in err


@pytest.mark.parametrize("footage", ["shot.jpg", "shots"])
def test_a_single_image_is_taken(scene: Path, run: Run, footage: str) -> None:
    (scene.parent / "shots").mkdir()
    with av.open(str(scene)) as container:
        image = next(container.decode(video=0)).to_ndarray(format="bgr24")
    assert cv2.imwrite(str(scene.parent / "shot.jpg"), image)
    assert cv2.imwrite(str(scene.parent / "shots" / "shot.jpg"), image)
    status, out, err = run("draft", footage, *DRAFT[2:])
    assert status == 0, err
    assert "a single image: it is taken twice" in err
    assert "the left hand in 2 of 2 frames" in out
    assert "nothing is reconstructed: give --object-box or --masks" in err


def test_a_mask_that_hardly_fills_its_box_is_refused(scene: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[100:106, 120:140] = 1
    monkeypatch.setattr("getagrip.studio.masks.box_prompt.segment_box_by_motion", lambda *_: labels)
    status, _, err = run(*DRAFT, "--object-box", "90,70,80,80", "--interval", "1", "3")
    assert status == 2
    assert scene.is_file()
    assert "what stands out in the box in 000001 fills 1.9 % of it: that is not the object" in err
