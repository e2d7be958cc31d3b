"""Drafts of images with known poses: a recording is read or refused, runs are kept, one failure stops no other."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from getagrip.bench.pixels.recording import TrueScene, drawn_outline, hand_of_joints
from getagrip.bench.sources.recording import Recording, read_views
from getagrip.cli import main
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import read_mesh
from getagrip.geometry.rasterize import depth_and_face
from getagrip.io.terminal import cache_folder
from getagrip.synthetic.scene import Scene, ground_truth_masks, make_scene, render_pictures
from getagrip.synthetic.scene_options import SceneOptions
from helpers.environment import DATA
from helpers.recordings import write_recording

MODELS = cache_folder() / "models"
NEEDS_DATA = pytest.mark.skipif(not (DATA / "recording").is_dir(), reason="needs the recording of shared/data")
NEEDS_FRAME = pytest.mark.skipif(not (DATA / "ho3d_frame").is_dir(), reason="needs the frame of shared/data")
NEEDS_MODELS = pytest.mark.skipif(not MODELS.is_dir(), reason="needs the hand models: getagrip doctor --fetch hands")
N_FRAMES = 6


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("mug", 2, SceneOptions(frames=N_FRAMES, size=(320, 240), focal=300.0))


@pytest.fixture(scope="module")
def rendered(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rendered recording of one view, whose camera is the world."""
    depths = []
    for n in range(N_FRAMES):
        grasped, hands = scene.surfaces(n)
        z = np.min([depth_and_face(*each, scene.clip.K[n], scene.clip.size)[0] for each in (grasped, *hands)], axis=0)
        depths.append(np.where(np.isfinite(z), z, 0.0))
    return write_recording(tmp_path_factory.mktemp("made") / "rendered", scene.clip, render_pictures(scene), depths)


@pytest.fixture
def copied(rendered: Path, tmp_path: Path) -> Path:
    return shutil.copytree(rendered, tmp_path / "copied")


def bench(root: Path, out: Path, *words: str) -> int:
    return main(["bench", "recording", "--root", str(root), "--out", str(out), "--workers", "1", *words])


def test_truth_and_inputs_of_a_view_are_those_of_the_scene(rendered: Path, scene: Scene) -> None:
    (view,) = read_views(rendered, None)
    shown = TrueScene(view, read_mesh(view.mesh))
    assert view.name == "rendered-front"
    assert view.has_joints
    truth = ground_truth_masks(scene)
    for n in range(N_FRAMES):  # a finger that touches the surface hides it by less than the limit
        assert (shown.masks[n] & truth.object[n]).sum() >= 0.99 * truth.object[n].sum()
        assert shown.masks[n].sum() < 1.2 * truth.object[n].sum()
    left, top, width, height = shown.box()
    rows, columns = np.nonzero(truth.object[0])
    assert left <= columns.min() < columns.max() < left + width
    assert top <= rows.min() < rows.max() < top + height


def test_outlines_are_a_pixel_or_two_off_and_the_same_again(rendered: Path) -> None:
    (view,) = read_views(rendered, None)
    mask = TrueScene(view, read_mesh(view.mesh)).masks[0]
    one, again, other = (drawn_outline(mask, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert (one == again).all()
    assert (one != other).any()
    assert 0.8 < (one & mask).sum() / (one | mask).sum() < 1.0
    assert not drawn_outline(np.zeros((8, 8), bool), np.random.default_rng(0)).any()


def test_hands_of_joints_of_which_some_are_unknown_are_near_all(rendered: Path) -> None:
    (view,) = read_views(rendered, None)
    some = view.joints.copy()
    some[:, [16, 20]] = np.nan
    some[2:, [13, 15]] = np.nan
    hand = hand_of_joints(some, "right")
    assert hand.joints is not None
    off = np.linalg.norm(se3.transform(hand.T_cam_hand, hand.joints) - view.joints, axis=2)
    assert off.mean() < 0.005
    assert off.max() < 0.03, "a finger bends as the next one where it is unknown"


@pytest.mark.long
def test_runs_are_drafts_and_are_kept(rendered: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad, out = tmp_path / "bad", tmp_path / "out"
    bad.mkdir()
    (bad / "rendered-front.npz").write_bytes(b"no archive")
    words = ("--side", "right", "--masks", "true", "--depth", "sensor", "--hands", "joints", f"bad={bad}")
    numbers = tmp_path / "numbers.json"
    assert bench(rendered, out, *words, "--json", str(numbers)) == 1
    assert "failed: rendered-front-bad-true-sensor" in capsys.readouterr().err
    found = json.loads(numbers.read_text())
    done, failed = found["rendered-front-joints-true-sensor"], found["rendered-front-bad-true-sensor"]
    assert "rendered-front.npz" in failed["failure"]
    assert done["failure"] is None
    assert done["mask_iou"] > 0.9
    assert done["object"]["right"]
    assert done["object"]["add_mm"] < 8.0
    assert done["hand_found"]["joints_mm"] < 5.0
    assert len(done["candidates"]) >= 1
    page = (out / "recording.md").read_text()
    assert "| rendered-front | joints | true | sensor | 6 |" in page
    assert str(tmp_path) not in page.replace(failed["failure"], "")
    record = out / "results" / "rendered-front-joints-true-sensor.json"
    assert record.with_suffix(".png").is_file()
    before = record.stat().st_mtime_ns
    assert bench(rendered, out, *words[:-1]) == 0
    assert record.stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("cameras.json", "neither cameras.json nor truth.json"),
        ("truth.npz", "no such file"),
        ("object.obj", "no mesh"),
        ("front/depth/000003.png", r"000003\.png: no such file; must be depth of each image"),
    ],
)
def test_a_missing_file_is_named(copied: Path, file: str, message: str) -> None:
    (copied / file).unlink()
    with pytest.raises(InputError, match=message):
        read_views(copied, None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"T_world_obj": np.tile(2.0 * np.eye(4), (N_FRAMES, 1, 1))}, "no rigid motion"),
        ({"T_world_obj": np.full((N_FRAMES, 4, 4), np.nan)}, "NaN or infinite"),
        ({"T_world_obj": np.tile(np.eye(4), (3, 1, 1))}, "shape"),
        ({"joints_world": np.zeros((N_FRAMES, 20, 3))}, "joints_world"),
        ({"frames": np.array([f"{n + 1:06d}" for n in range(N_FRAMES)])}, r"no pose of '000000\.png'"),
        ({"frames": np.array([{}] * N_FRAMES, dtype=object)}, "Python objects"),
        ({"frames": np.array([f"{n}" for n in range(1001)])}, "1 to 1000 frames"),
    ],
)
def test_a_truth_that_cannot_be_is_refused(copied: Path, change: dict[str, np.ndarray], message: str) -> None:
    with np.load(copied / "truth.npz") as stored:
        np.savez(copied / "truth.npz", **{**stored, **change}, allow_pickle=True)
    with pytest.raises(InputError, match=message):
        read_views(copied, None)


@pytest.mark.parametrize(
    "cameras", [{"../x": {}}, {}, {str(n): {} for n in range(65)}, {"front": {"fx": "1"}}, {"front": 3}]
)
def test_cameras_that_cannot_be_are_refused(copied: Path, cameras: dict[str, object]) -> None:
    (copied / "cameras.json").write_text(json.dumps(cameras))
    with pytest.raises(InputError, match=r"cameras\.json"):
        read_views(copied, None)


def test_a_link_out_of_the_folder_is_refused(copied: Path, tmp_path: Path) -> None:
    image = copied / "front" / "color" / "000001.png"
    image.rename(tmp_path / "elsewhere.png")
    image.symlink_to(tmp_path / "elsewhere.png")
    with pytest.raises(InputError, match="leads out"):
        read_views(copied, None)


def test_options_that_do_not_fit_are_refused(
    rendered: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UsageError, match="missing --side: rendered-front has joints"):
        Recording(root=(rendered,)).samples(tmp_path, False)
    with pytest.raises(UsageError, match="must be found, joints or NAME=DIR"):
        Recording(root=(rendered,), hands=("mine",)).samples(tmp_path, False)
    with pytest.raises(UsageError, match="different names"):
        Recording(root=(rendered, rendered), side="right").samples(tmp_path, False)
    with pytest.raises(UsageError, match="no splits"):
        Recording(root=(rendered,), split="train")
    with pytest.raises(InputError, match="hand file of each view"):
        Recording(root=(rendered,), hands=(f"mine={tmp_path}",)).samples(tmp_path, False)
    assert bench(rendered, tmp_path / "out", "--inits", "3") == 2
    assert "takes no options of the search" in capsys.readouterr().err


def test_more_views_than_a_recording_has_are_refused(copied: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--views 3 leaves no draft"):
        Recording(root=(copied,), side="right", views=(3,)).samples(tmp_path, debug=False)


def test_the_grid_is_of_what_the_folder_has(copied: Path, tmp_path: Path) -> None:
    names = [run.name for run in Recording(root=(copied,), side="right").samples(tmp_path, False)[0]]
    assert len(names) == 2 * 3 * 2
    assert names[0] == "copied-front-found-box-none"
    shutil.rmtree(copied / "front" / "depth")
    assert len(Recording(root=(copied,), side="right").samples(tmp_path, False)[0]) == 2 * 3
    with np.load(copied / "truth.npz") as stored:
        np.savez(copied / "truth.npz", **{key: stored[key] for key in ("frames", "T_world_obj")})
    assert len(Recording(root=(copied,)).samples(tmp_path, False)[0]) == 3


@NEEDS_DATA
def test_the_recording_of_real_images_is_read(tmp_path: Path) -> None:
    views = read_views(DATA / "recording", None)
    assert [len(view.frames) for view in views] == [29, 29, 29]
    shown = TrueScene(views[0], read_mesh(views[0].mesh))
    assert shown.box() == (150.0, 260.0, 75.0, 67.0)
    assert 1000 < np.median([mask.sum() for mask in shown.masks]) < 3000
    assert len(Recording(root=(DATA / "recording",), side="right").samples(tmp_path, False)[0]) == 36


@pytest.mark.long
@NEEDS_FRAME
@NEEDS_MODELS
def test_a_real_frame_is_drafted(tmp_path: Path) -> None:
    words = ("--meshes", str(DATA / "ycb"), "--masks", "outlines", "--depth", "sensor")
    assert bench(DATA / "ho3d_frame", tmp_path, *words, "--json", str(tmp_path / "numbers.json")) == 0
    (found,) = json.loads((tmp_path / "numbers.json").read_text()).values()
    assert found["frames"] == 2
    assert found["object"]["across_mm"] < 30.0
