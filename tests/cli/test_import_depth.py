"""``import depth``: each format as its program writes it gives the same distances."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip import cli
from getagrip.clip import read_clip, with_evidence, write_clip
from getagrip.clip.depth import DEPTH_KEY
from getagrip.readers.depth_files import HO3D_DEPTH_UNIT_M
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.program_files import exr

NAMES = ("0000", "0001", "0002")
Z = 0.5 + 0.1 * np.random.default_rng(0).random((3, 24, 32))


def realsense(root: Path) -> Path:
    for name, z in zip(NAMES, Z, strict=True):
        cv2.imwrite(str(root / f"aligned_depth_to_color_{name}.png"), np.rint(1000 * z).astype(np.uint16))
        (root / f"color_{name}.jpg").write_bytes(b"")
    return root


def dexycb(root: Path) -> Path:
    for name in NAMES:
        np.savez_compressed(
            root / f"labels_{name}.npz", seg=np.zeros((24, 32), np.uint8), joint_2d=np.zeros((1, 21, 2))
        )
    return realsense(root)


def sensor_arrays(root: Path, dtype: type) -> Path:
    for name, z in zip(NAMES, Z, strict=True):
        np.save(root / f"{name}.npy", np.rint(1000 * z).astype(dtype))
    return root


def scanner_app(root: Path) -> Path:
    for name, z in zip(NAMES, Z, strict=True):
        cv2.imwrite(str(root / f"depth_{name}.PNG"), np.rint(1000 * z).astype(np.uint16))
        cv2.imwrite(str(root / f"conf_{name}.PNG"), np.full(z.shape, 2, np.uint8))
    return root


def ho3d(root: Path) -> Path:
    for name, z in zip(NAMES, Z, strict=True):
        units = np.rint(z / HO3D_DEPTH_UNIT_M).astype(int)
        blue_green_red = np.stack([np.zeros_like(units), units // 256, units % 256], axis=-1)
        cv2.imwrite(str(root / f"{name}.png"), blue_green_red.astype(np.uint8))
    return root


def moge(root: Path) -> Path:
    for name, z in zip(NAMES, Z, strict=True):
        (root / name).mkdir()
        (root / name / "depth.exr").write_bytes(exr({"Y": z.astype("<f4")}))
        (root / name / "depth_vis.png").write_bytes(b"")
        (root / name / "fov.json").write_text(json.dumps({"fov_x": 43.6, "fov_y": 33.4}))
    return root


def depth_anything(root: Path) -> Path:
    folder = root / "exports" / "npz"
    folder.mkdir(parents=True)
    K = np.tile(np.array([[40.0, 0, 16], [0, 41, 12], [0, 0, 1]], np.float32), (3, 1, 1))
    image = np.zeros((3, 24, 32, 3), np.uint8)
    np.savez(folder / "results.npz", image=image, depth=Z.astype(np.float32), conf=np.ones_like(Z), intrinsics=K)
    return root


def unidepth(root: Path) -> Path:
    np.save(root / "depth.npy", Z[:, None].astype(np.float32))
    return root / "depth.npy"


def depth_pro(root: Path) -> Path:
    for name, z in zip(NAMES, Z, strict=True):
        np.savez_compressed(root / f"{name}.npz", depth=z.astype(np.float32))
        (root / f"{name}.jpg").write_bytes(b"")
    return root


FORMATS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "realsense": (realsense, "metric"),
    "dexycb": (dexycb, "metric"),
    "ho3d": (ho3d, "metric"),
    "arkit": (realsense, "metric"),
    "moge": (moge, "frame"),
    "depth-anything-3": (depth_anything, "clip"),
    "unidepth": (unidepth, "metric"),
    "depth-pro": (depth_pro, "metric"),
}


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    return write_clip(*small_clip(), tmp_path / "clip")


def run(clip: Path, path: Path, name: str, *more: str) -> int:
    return cli.main(["import", "depth", str(path), "--from", name, "--clip", str(clip), *more])


def z_of(clip: Path) -> ndarray:
    depth = with_evidence(read_clip(clip)).evidence[DEPTH_KEY]
    return np.stack([depth.image(n) for n in range(3)])


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_gives_its_distances(tmp_path: Path, clip: Path, name: str) -> None:
    make, scale = FORMATS[name]
    (tmp_path / "made").mkdir()
    assert run(clip, make(tmp_path / "made"), name) == 0
    found = z_of(clip)
    np.testing.assert_allclose(found[found > 0.0], Z[found > 0.0], atol=6e-4)
    assert (found > 0.0).sum() > 0.1 * Z.size
    fields = json.loads((clip / "clip.json").read_text())
    assert fields[DEPTH_KEY]["scale"] == scale
    assert name in str(fields["provenance"][DEPTH_KEY])


MORE: dict[str, tuple[str, Callable[[Path], Path]]] = {
    "whole numbers in arrays": ("realsense", lambda root: sensor_arrays(root, np.uint16)),
    "the same as floats": ("realsense", lambda root: sensor_arrays(root, np.float32)),
    "confidence beside depth": ("arkit", scanner_app),
    "the small export": (
        "depth-anything-3",
        lambda root: (depth_anything(root) / "exports" / "npz").rename(root / "exports" / "mini_npz") and root,
    ),
    "a folder with one file of all": ("unidepth", lambda root: unidepth(root).parent),
}


@pytest.mark.parametrize("case", MORE)
def test_other_ways_in_which_they_are_written_give_the_same(tmp_path: Path, clip: Path, case: str) -> None:
    name, make = MORE[case]
    (tmp_path / "made").mkdir()
    assert run(clip, make(tmp_path / "made"), name) == 0
    found = z_of(clip)
    np.testing.assert_allclose(found[found > 0.0], Z[found > 0.0], atol=6e-4)
    assert (found > 0.0).sum() > 0.1 * Z.size


def test_what_the_user_says_counts(tmp_path: Path, clip: Path) -> None:
    (tmp_path / "made").mkdir()
    path = depth_pro(tmp_path / "made")
    assert run(clip, path, "depth-pro", "--scale", "clip", "--unit", "2", "--error", "0.02") == 0
    found = z_of(clip)
    np.testing.assert_allclose(found[found > 0.0], 2.0 * Z[found > 0.0], rtol=1e-3)
    assert json.loads((clip / "clip.json").read_text())[DEPTH_KEY]["error"] == 0.02


def test_depth_there_is_kept_and_other_counts_are_refused(
    tmp_path: Path, clip: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "made").mkdir()
    path = unidepth(tmp_path / "made")
    np.save(path, Z[:2].astype(np.float32))
    assert run(clip, path, "unidepth") == 1
    assert "2 depth images without names" in capsys.readouterr().err
    np.save(path, np.zeros_like(Z))
    assert run(clip, path, "unidepth") == 1
    said = capsys.readouterr().err
    assert "0 in all images" in said
    assert str(path) in said
    assert not (clip / DEPTH_KEY).exists()
    np.save(path, Z)
    assert run(clip, path, "unidepth") == 0
    assert run(clip, path, "unidepth") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert run(clip, path, "unidepth", "--overwrite") == 0


def test_another_field_of_view_and_missing_frames_are_said(
    tmp_path: Path, clip: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "made").mkdir()
    moge(tmp_path / "made")
    for sub in (tmp_path / "made").iterdir():
        (sub / "fov.json").write_text(json.dumps({"fov_x": 80.0}))
    (tmp_path / "made" / "0001" / "depth.exr").unlink()
    assert run(clip, tmp_path / "made", "moge") == 3
    said = capsys.readouterr().err
    assert "times the clip's focal length" in said
    assert "no depth in 1 of 3 frames (first: 0001)" in said
    (tmp_path / "whole").mkdir()
    moge(tmp_path / "whole")
    assert run(clip, tmp_path / "whole", "moge", "--overwrite") == 0, "what lacks a frame can be replaced, too"


@pytest.mark.parametrize(
    ("scale", "words"), [("metric", "or import with --scale clip"), ("clip", "its relief may be off")]
)
def test_the_field_of_view_in_arrays_is_compared_and_the_advice_fits_the_scale(
    tmp_path: Path, clip: Path, capsys: pytest.CaptureFixture[str], scale: str, words: str
) -> None:
    (tmp_path / "made").mkdir()
    for fov, status in ((43.6, 0), (80.0, 3)):
        for name, z in zip(NAMES, Z, strict=True):
            np.savez(tmp_path / "made" / f"{name}.npz", depth=z.astype(np.float32), fov=np.float32(fov))
        assert run(clip, tmp_path / "made", "unidepth", "--scale", scale, "--overwrite") == status
        assert (words in capsys.readouterr().err) == (status == 3)


def test_a_first_image_without_depth_costs_the_others_no_digits(tmp_path: Path, clip: Path) -> None:
    (tmp_path / "made").mkdir()
    path = unidepth(tmp_path / "made")
    np.save(path, np.concatenate([np.zeros_like(Z[:1]), Z[1:]]).astype(np.float32))
    assert run(clip, path, "unidepth") == 0
    found = z_of(clip)
    np.testing.assert_allclose(found[found > 0.0], Z[found > 0.0], atol=6e-4)


@pytest.mark.parametrize(
    ("arrays", "more", "says"),
    [
        ([1e300 * Z[0]], (), "distances about"),
        ([Z[0], 1e306 * Z[0]], (), "overflow"),
        ([Z[0]], ("--unit", "1e-300"), "--unit must be metres"),
        ([Z[0]], ("--unit", "nan"), "--unit must be metres"),
        ([Z[0], np.repeat(np.repeat(Z[0], 2, 0), 2, 1)], (), "size must be 32 x 24, as the first image"),
        ([Z[0].astype(np.complex64)], (), "numbers of shape (height, width)"),
    ],
)
def test_impossible_distances_units_and_sizes_are_refused(
    tmp_path: Path,
    clip: Path,
    capsys: pytest.CaptureFixture[str],
    arrays: list[ndarray],
    more: tuple[str, ...],
    says: str,
) -> None:
    (tmp_path / "made").mkdir()
    for name, array in zip(NAMES, arrays, strict=False):
        np.save(tmp_path / "made" / f"{name}.npy", array)
    status = run(clip, tmp_path / "made", "unidepth", *more)
    err = capsys.readouterr().err
    assert status in (1, 2)
    assert says in err
    assert not (clip / DEPTH_KEY).exists()


def test_numbers_of_frames_below_0_are_refused(tmp_path: Path, clip: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "d.npz", depth=Z, frames=[-2, -1, 0])
    assert run(clip, tmp_path / "d.npz", "unidepth") == 1
    assert "frames must be 3 names or numbers of frames" in capsys.readouterr().err


@pytest.mark.parametrize("source", ["depth-anything-3", "realsense"])
def test_numbers_that_grow_towards_the_camera_are_disparities(tmp_path: Path, run: Run, source: str) -> None:
    """A network's are refused, a sensor's are said; depth behind the object is neither."""
    clip, masks = small_clip()
    folder = write_clip(clip, masks, tmp_path / "clip")
    z = np.where(masks.object | masks.ignore, 0.5, 1.5)
    for name, values in (("depth", z), ("inverse", 1.0 / z)):
        np.savez(tmp_path / f"{name}.npz", depth=values.astype(np.float32))
        call = ("import", "depth", tmp_path / f"{name}.npz", "--from", source, "--clip", folder, "--overwrite")
        status, _, err = run(*call)
        assert ("disparities (inverse depth)" in err) == (name == "inverse")
        assert status == (0 if name == "depth" else 1 if source == "depth-anything-3" else 3)


def test_megasam_s_file_and_numbered_stacks(tmp_path: Path, clip: Path) -> None:
    K = np.array([[40.0, 0, 16], [0, 41, 12], [0, 0, 1]], np.float32)
    np.savez(
        tmp_path / "mug_sgd_cvd_hr.npz", depths=Z.astype(np.float16), intrinsic=K, cam_c2w=np.tile(np.eye(4), (3, 1, 1))
    )
    assert run(clip, tmp_path / "mug_sgd_cvd_hr.npz", "megasam") == 0
    np.save(tmp_path / "clip01.npy", Z)
    assert run(clip, tmp_path / "clip01.npy", "unidepth", "--overwrite") == 0
