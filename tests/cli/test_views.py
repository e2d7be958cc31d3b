"""Further views of a clip: made of other cameras' footage and a calibration, and what is imported into them."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.clip import read_clip
from getagrip.clip.views import View, read_views
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.readers.matched_footage import match_footage
from getagrip.readers.video import FootageInterval, footage_interval
from helpers.environment import Run
from helpers.results import FRAMES, SIZE, bars, everything, new

OWN_K = [[60.0, 0.0, 32.0], [0.0, 60.0, 24.0], [0.0, 0.0, 1.0]]
T_WORLD = {
    "front": se3.rigid(None, np.array([0.0, 0.0, 1.0])),
    "side": se3.rigid(se3.exp_so3(np.array([0.0, -1.2, 0.0])), np.array([0.4, 0.0, 1.3])),
    "top": se3.rigid(se3.exp_so3(np.array([0.8, 0.0, 0.0])), np.array([0.0, -0.3, 1.2])),
}


def write_bars(path: Path, numbers: range, rate: Fraction = Fraction(25)) -> Path:
    """A video each of whose frames has as many bars as its number."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for number in numbers:
            image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
            for bar in range(number):
                image[:, 4 * bar + 1 : 4 * bar + 4] = 255
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return path


def calibration(folder: Path, names: tuple[str, ...] = ("front", "side", "top"), **more: object) -> Path:
    of = {name: {"T_world_cam": T_WORLD[name].tolist(), "K": OWN_K, "size": SIZE, **more} for name in names}
    files.write_json(folder / "rig.json", of)
    return folder / "rig.json"


def with_views(made: Path, *more: str, rig: Path | None = None) -> list[str]:
    """The command that makes a clip of two cameras."""
    write_bars(made / "side.mp4", range(1, FRAMES + 1))
    own = everything(made)[: -len(("--K", "", "", "", ""))]
    views = ["--view", f"side={made / 'side.mp4'}", "--cameras", str(rig or calibration(made, ("front", "side")))]
    return new(made, *own, "--hands", str(made / "six.npz"), *views, *more)


def only_view(clip: Path) -> View:
    views = read_views(read_clip(clip))
    assert views is not None
    (view,) = views.each
    return view


def test_a_clip_of_two_cameras(made: Path, run: Run) -> None:
    status, out, err = run(*with_views(made))
    assert (status, "view side: 6 of 6 frames, frames matched by number" in err + out) == (3, True), err
    assert "missing: masks of view side" in err
    assert "import masks PATH" in err
    clip, view = read_clip(made / "cup"), only_view(made / "cup")
    np.testing.assert_allclose(clip.K[0], OWN_K)
    np.testing.assert_allclose(view.T_cam_view[0], se3.inverse(T_WORLD["front"]) @ T_WORLD["side"], atol=1e-12)
    assert (view.size, view.time_offset) == (SIZE, 0.0)
    for name in clip.frames:
        assert bars(cv2.imread(str(made / "cup" / "views" / "side" / "frames" / f"{name}.jpg"))) == int(name)


def test_without_views_nothing_is_needed_or_taken(made: Path, run: Run) -> None:
    for used in (("--cameras", str(calibration(made))), ("--camera", "front"), ("--view-start", "a=1")):
        assert "missing --view" in run(*new(made, *everything(made), *used))[2]


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--K", "60", "60", "32", "24"], "cannot be used with --cameras"),
        (["--distortion", "0", "0", "0", "0"], "--distortion cannot be used with --cameras"),
        (["--view-start", "top=1"], "must be of a --view (got top)"),
        (["--view", "side=x.mp4"], "must name each view once (got side twice)"),
        (["--camera", "side"], "another camera than the views'"),
        (["--camera", "none"], "unknown --camera 'none'"),
        (["--metres", "1000"], "are these millimetres? --metres 0.001"),
    ],
)
def test_options_that_do_not_fit_are_named(made: Path, run: Run, more: list[str], says: str) -> None:
    status, _, err = run(*with_views(made, *more))
    assert status in (1, 2)
    assert says in err
    assert not (made / "cup").exists()


def test_the_own_camera_is_asked_for_among_several(made: Path, run: Run) -> None:
    rig = calibration(made)
    assert "missing --camera: the clip's own camera" in run(*with_views(made, rig=rig))[2]
    assert run(*with_views(made, "--camera", "front", rig=rig))[0] == 3


def test_views_are_undistorted_as_the_clips_own_camera(made: Path, run: Run) -> None:
    """Straight bars that a lens has bent are straight in a clip, and both cameras say so."""
    run(*with_views(made))
    plain = cv2.imread(str(made / "cup" / "views" / "side" / "frames" / "000005.jpg"))
    rig = calibration(made, ("front", "side"), distortion=[-0.3, 0.0, 0.0, 0.0])
    assert run(*with_views(made, "--overwrite", rig=rig))[0] == 3
    for place in ("frames", "views/side/frames"):
        bent = cv2.imread(str(made / "cup" / place / "000005.jpg"))
        assert np.abs(bent.astype(float) - plain).mean() > 2.0
    for about in (read_clip(made / "cup").provenance, only_view(made / "cup").provenance):
        assert "lens distortion removed" in str(about["camera"])
    rig = calibration(made, ("front", "side"), distortion=[900.0, 0.0, 0.0, 0.0])
    assert "front.distortion" in run(*with_views(made, "--overwrite", rig=rig))[2]


def clip_footage(tmp_path: Path) -> FootageInterval:
    return footage_interval(write_bars(tmp_path / "a.mp4", range(1, 13)), np.arange(3, 9), SIZE, 25.0, False)


def test_a_video_of_another_rate_is_matched_in_time(tmp_path: Path) -> None:
    clip = clip_footage(tmp_path)
    half = match_footage(clip, write_bars(tmp_path / "half.mp4", range(1, 7), Fraction(25, 2)))
    assert (half.by, half.known.tolist(), half.at.tolist()) == ("time", [0, 2, 4], [1, 2, 3])
    late = match_footage(clip, tmp_path / "a.mp4", 0.08 - 0.01)
    assert (late.at.tolist(), round(late.time_offset, 4)) == ([4, 5, 6, 7, 8, 9], 0.01)
    assert "up to 10 ms apart (0.25 of a frame)" in late.words
    with pytest.raises(InputError, match=r"some at the clip's times, 5\.08 to 5\.28 s .*--view-start"):
        match_footage(clip, tmp_path / "a.mp4", 5.0)


def test_a_dropped_frame_is_no_frame_of_another_moment(tmp_path: Path) -> None:
    """A folder whose images are numbered: those of the same numbers, however many are missing."""
    for folder, numbers in (("a", range(1, 13)), ("b", (1, 2, 4, 5, 6, 8))):
        (tmp_path / folder).mkdir()
        for number in numbers:
            cv2.imwrite(str(tmp_path / folder / f"{number:04d}.png"), np.zeros((48, 64, 3), np.uint8))
    clip = footage_interval(tmp_path / "a", np.arange(3, 9), SIZE, 30.0, False)
    match = match_footage(clip, tmp_path / "b")
    assert [int(clip.names[row]) for row in match.known] == [4, 5, 6, 8]
    assert [match.footage.number(n) for n in match.at] == [4, 5, 6, 8]


@given(st.floats(-0.5, 0.5), st.sampled_from([12.5, 24.0, 30.0, 60.0]))
def test_no_image_is_more_than_half_a_frame_off(start: float, rate: float) -> None:
    class Counted:
        frames, fps, size = 40, rate, SIZE

        def time(self, n: int) -> float:
            return n / rate

    clip = FootageInterval(Path("x"), 1, tuple(map(str, range(20))), np.arange(20) / 25.0, 25.0, SIZE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("getagrip.readers.matched_footage.VideoFootage", lambda _: Counted())
        match = match_footage(clip, Path("y"), start)
    assert (np.abs(match.off) <= 0.51 * 0.04).all()
    np.testing.assert_allclose(match.at / rate - start - clip.times[match.known], match.off, atol=1e-12)
    assert len({*match.known.tolist()}) == len(match.known)


def test_masks_depth_and_joints_of_a_view(made: Path, run: Run) -> None:
    run(*with_views(made))
    to = ("--clip", str(made / "cup"), "--view", "side")
    status, out, err = run("import", "masks", str(made / "masks"), "--object", "1", "--ignore", "2", *to)
    assert (status, "visible in 6 of 6 frames" in out) == (0, True), err
    (made / "depth").mkdir()
    for n in range(3, 9):
        cv2.imwrite(str(made / "depth" / f"{n:06d}.png"), np.full((48, 64), 900, np.uint16))
    assert run("import", "depth", str(made / "depth"), "--from", "realsense", *to)[0] in (0, 3)
    points = hand_points()
    np.savez(made / "j.npz", joints_2d=np.tile(points, (5, 1, 1)), frames=np.arange(3, 8))
    status, out, err = run("import", "hands", str(made / "j.npz"), "--from", "landmarks", *to)
    assert (status, "joints in 5 of 6 frames" in out) == (0, True), err
    view = only_view(made / "cup")
    assert view.masks.known.all()
    assert view.depth is not None
    assert view.joints_2d is not None
    assert view.joints_2d_confidence is not None
    np.testing.assert_allclose(view.joints_2d[0], points, atol=1e-4)
    assert view.joints_2d_confidence.any(axis=1).tolist() == [True] * 5 + [False]
    assert str(view.provenance["masks"]).startswith("from masks")
    assert run("import", "masks", str(made / "masks"), "--object", "1", *to)[0] == 2
    assert "unknown --view" in run("import", "masks", str(made / "masks"), *to[:2], "--view", "back")[2]


def hand_points() -> ndarray:
    """A flat hand, as a camera sees it."""
    fingers = np.array([[4.0, -4.0], [2.0, -8.0], [0.0, -9.0], [-2.0, -8.0], [-4.0, -7.0]])
    along = np.array([0.9, 1.3, 1.6, 1.9])[:, None]
    return np.concatenate([np.zeros((1, 2)), *[along * one for one in fingers]]) + np.array([32.0, 34.0])


def test_a_new_calibration_of_all_views(made: Path, run: Run) -> None:
    run(*with_views(made))
    T_WORLD_NEW = se3.rigid(None, np.array([0.0, 0.02, 0.0])) @ T_WORLD["side"]
    rig = calibration(made, ("front", "side"))
    content = json.loads(rig.read_text())
    content["side"]["T_world_cam"] = T_WORLD_NEW.tolist()
    rig.write_text(json.dumps(content))
    to = ("import", "cameras", str(rig), "--clip", str(made / "cup"))
    status, _, err = run(*to)
    assert (status, "moved by 20.0 mm and turned by 0.00°" in err) == (0, True), err
    np.testing.assert_allclose(only_view(made / "cup").T_cam_view[0], se3.inverse(T_WORLD["front"]) @ T_WORLD_NEW)
    for one in content.values():
        one["distortion"] = [-0.1, 0.0, 0.0, 0.0]
    rig.write_text(json.dumps(content))
    assert "--undistorted states" in run(*to)[2]
    assert run(*to, "--undistorted")[0] == 0
    content["front"]["K"][0][0] = 70.0
    rig.write_text(json.dumps(content))
    status, _, err = run(*to, "--undistorted")
    assert (status, "--intrinsics takes it" in err) == (3, True)
    assert run(*to, "--undistorted", "--intrinsics")[0] == 0
    assert read_clip(made / "cup").K[0, 0, 0] == 70.0
    assert "--start cannot be used" in run(*to, "--start", "1")[2]


def test_a_calibration_for_a_clip_without_views(made: Path, run: Run) -> None:
    assert run(*new(made, *everything(made), "--hands", str(made / "six.npz")))[0] == 0
    to = ("import", "cameras", str(calibration(made)), "--clip", str(made / "cup"))
    assert "it has no views; clip new --view makes them" in run(*to)[2]
