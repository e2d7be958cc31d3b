"""Depth images of a clip: files of every kind, EXR among them, and samples."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip import Clip, Masks, input_sha256, read_clip, with_evidence, write_clip
from getagrip.clip.depth import (
    DEPTH_KEY,
    N_WINDOW_SAMPLES,
    Depth,
    DepthSource,
    read_channel,
    sample_window,
    sampling_windows,
)
from getagrip.errors import InputError
from getagrip.geometry.camera import backproject, project
from helpers.clips import small_clip
from helpers.program_files import exr


def a_clip() -> tuple[Clip, Masks]:
    """A small clip whose images are large enough for windows with gaps between samples."""
    clip, masks = small_clip()
    many = np.kron(masks.object, np.ones((10, 10), bool)), np.kron(masks.ignore, np.ones((10, 10), bool))
    K = clip.K * np.array([10.0, 10.0, 1.0])[:, None]
    return replace(clip, size=(320, 240), K=K, truth=None), Masks(*many)


def a_depth(clip: Clip, masks: Masks, image: ndarray) -> Depth:
    size = image.shape[1], image.shape[0]
    corner, stride = sampling_windows(clip, masks, size)
    z = np.stack([sample_window(image, c, int(s)) for c, s in zip(corner, stride, strict=True)])
    return Depth(z, corner, stride, size, DepthSource("metric", "sensor", 0.001))


def stored(folder: Path, images: list[ndarray], **source: object) -> Path:
    """A clip whose depth images are 16-bit PNG."""
    clip, masks = a_clip()
    write_clip(clip, masks, folder)
    (folder / DEPTH_KEY).mkdir()
    for frame, image in zip(clip.frames, images, strict=False):
        cv2.imwrite(str(folder / DEPTH_KEY / f"{frame}.png"), image)
    describe(folder, **source)
    return folder


def describe(folder: Path, **source: object) -> None:
    fields = json.loads((folder / "clip.json").read_text())
    fields[DEPTH_KEY] = {"scale": "metric", "source": "sensor", "unit": 0.001} | source
    (folder / "clip.json").write_text(json.dumps(fields))


def flat(value: float = 500, size: tuple[int, int] = (240, 320), dtype: type = np.uint16) -> ndarray:
    return np.full(size, value, dtype)


@pytest.mark.parametrize("size", [(320, 240), (160, 120), (336, 252)])
def test_intrinsics_are_those_of_the_sampled_pixels(size: tuple[int, int]) -> None:
    clip, masks = a_clip()
    rows, columns = np.mgrid[: size[1], : size[0]]
    for image, axis in ((columns, 0), (rows, 1)):
        depth = a_depth(clip, masks, 1.0 + image)
        K = depth.intrinsics(clip)
        for n, i, j in ((0, 20, 30), (2, 31, 12)):
            ray = backproject(K[n], np.array([[j + 0.5, i + 0.5]]))
            pixel = project(clip.K[n], ray)[0, axis] * size[axis] / clip.size[axis]
            assert pixel == pytest.approx(depth.z[n, i, j] - 0.5)


def test_windows_hold_object_and_hand() -> None:
    clip, masks = a_clip()
    depth = a_depth(clip, masks, np.ones((240, 320)))
    seen = depth.of_masks(masks.object, clip.size)
    area = seen.sum(axis=(1, 2)) * depth.stride**2
    np.testing.assert_allclose(area, masks.object.sum(axis=(1, 2)), rtol=0.15)
    assert (depth.stride > 1).any()


def test_samples_survive_a_folder_and_frames_are_taken(tmp_path: Path) -> None:
    clip, masks = a_clip()
    image = np.random.default_rng(0).integers(300, 900, (240, 320)) * 0.001
    depth = a_depth(clip, masks, image)
    write_clip(replace(clip, evidence={DEPTH_KEY: depth}), masks, tmp_path / "a")
    for source, target in (("a", "b"), ("b", "c")):
        there = with_evidence(read_clip(tmp_path / source))
        found = there.evidence[DEPTH_KEY]
        assert isinstance(found, Depth)
        np.testing.assert_allclose(found.z, depth.z, rtol=1e-6)
        assert found.source == depth.source
        write_clip(read_clip(tmp_path / source), masks, tmp_path / target)
    index = np.array([2, 0])
    np.testing.assert_allclose(
        with_evidence(read_clip(tmp_path / "a").take(index)).evidence[DEPTH_KEY].z, depth.z[index], rtol=1e-6
    )


def test_results_depend_on_depth(tmp_path: Path) -> None:
    folder = stored(tmp_path / "clip", [flat()] * 3)
    before = input_sha256(folder)
    cv2.imwrite(str(folder / DEPTH_KEY / "0001.png"), flat(501))
    assert input_sha256(folder) != before


def test_a_frame_may_lack_depth_and_65535_is_none(tmp_path: Path) -> None:
    depth = with_evidence(read_clip(stored(tmp_path / "clip", [flat(), flat(65535)]))).evidence[DEPTH_KEY]
    assert [bool(z.any()) for z in depth.z] == [True, False, False]


@pytest.mark.parametrize("kind", ["npy", "npz", "exr"])
def test_numbers_with_fractions_are_read_and_nan_is_none(tmp_path: Path, kind: str) -> None:
    folder, image = stored(tmp_path / "clip", [], unit=1.0), flat(0.5, dtype=np.float32)
    image[100:110], image[0, 0] = np.nan, np.inf
    path = folder / DEPTH_KEY / f"0000.{kind}"
    match kind:
        case "npy":
            np.save(path, image)
        case "npz":
            np.savez(path, depth=image)
        case _:
            path.write_bytes(exr({"Y": image}))
    depth = with_evidence(read_clip(folder)).evidence[DEPTH_KEY]
    assert set(np.unique(depth.z[0])) == {0.0, 0.5}


BAD: dict[str, tuple[Callable[[Path], object], str]] = {
    "another shape": (lambda f: cv2.imwrite(str(f / "0000.png"), flat(size=(200, 320))), "neither cropped nor turned"),
    "turned": (lambda f: cv2.imwrite(str(f / "0000.png"), flat(size=(320, 240))), "neither cropped nor turned"),
    "two sizes": (lambda f: cv2.imwrite(str(f / "0001.png"), flat(size=(120, 160))), "as the first image"),
    "8 bit": (lambda f: cv2.imwrite(str(f / "0000.png"), flat(5, dtype=np.uint8)), "16 bit, one channel"),
    "zeros": (lambda f: [cv2.imwrite(str(f / f"000{n}.png"), flat(0)) for n in range(3)], "0 in all images"),
    "metres as mm": (lambda f: describe(f.parent, unit=1.0), "are these millimetres"),
    "no unit": (lambda f: describe(f.parent, unit=None), "depth.unit"),
    "NaN for a unit": (lambda f: describe(f.parent, unit="nan"), "depth.unit"),
    "unknown scale": (lambda f: describe(f.parent, scale="inverse"), "metric or clip or frame"),
    "unknown key": (lambda f: describe(f.parent, units=1.0), "an unknown key"),
    "a text": (lambda f: (f / "0000.png").write_text("depth"), "no PNG"),
    "no frame's name": (lambda f: [one.rename(f / f"other{one.name}") for one in sorted(f.iterdir())], "named like"),
    "a link out": (lambda f: ((f / "0000.png").unlink(), (f / "0000.png").symlink_to("/etc/hostname")), "leads out"),
}  # fmt: skip


@pytest.mark.parametrize("fault", BAD)
def test_bad_depth_is_an_error(tmp_path: Path, fault: str) -> None:
    folder = stored(tmp_path / "clip", [flat()] * 3)
    with_evidence(read_clip(folder))
    make, message = BAD[fault]
    make(folder / DEPTH_KEY)
    with pytest.raises(InputError, match=message):
        with_evidence(read_clip(folder))


def test_disparities_objects_and_missing_descriptions_are_errors(tmp_path: Path) -> None:
    folder = stored(tmp_path / "clip", [], unit=1.0)
    path = folder / DEPTH_KEY / "0000.npy"
    for bad, message in ((flat(-1.0, dtype=np.float32), "no disparities"), (np.ones((2, 3, 4)), "height, width")):
        np.save(path, bad)
        with pytest.raises(InputError, match=message):
            with_evidence(read_clip(folder))
    np.save(path, np.array([[{}]], dtype=object), allow_pickle=True)
    with pytest.raises(InputError):
        with_evidence(read_clip(folder))
    fields = json.loads((folder / "clip.json").read_text())
    del fields[DEPTH_KEY]
    (folder / "clip.json").write_text(json.dumps(fields))
    with pytest.raises(InputError, match="what the images in the folder depth are"):
        with_evidence(read_clip(folder))
    describe(folder)
    shutil.rmtree(folder / DEPTH_KEY)
    with pytest.raises(InputError, match="the description of a folder depth, or left out"):
        with_evidence(read_clip(folder))


def test_depth_is_read_in_little_memory(tmp_path: Path) -> None:
    clip, masks = a_clip()
    assert a_depth(clip, masks, np.ones((240, 320))).z[0].nbytes <= N_WINDOW_SAMPLES * N_WINDOW_SAMPLES * 8


MOST = 10_000


@pytest.mark.parametrize("compression", [0, 2, 3])
@pytest.mark.parametrize("dtype", ["<f2", "<f4"])
@pytest.mark.parametrize("names", [("Y",), ("B", "G", "R"), ("A", "Z")])
def test_numbers_are_read_as_they_were_written(
    tmp_path: Path, compression: int, dtype: str, names: tuple[str, ...]
) -> None:
    rng = np.random.default_rng(0)
    channels = {name: rng.uniform(0.3, 3.0, (37, 11)).astype(dtype) for name in names}
    (tmp_path / "depth.exr").write_bytes(exr(channels, compression))
    wanted = next(name for name in ("Z", "Y", "R") if name in channels)
    np.testing.assert_array_equal(read_channel(tmp_path / "depth.exr", MOST), channels[wanted])


def test_damage_is_an_error_or_other_numbers(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    whole = exr({"Y": rng.uniform(0.3, 3.0, (20, 7)).astype("<f4")})
    path = tmp_path / "depth.exr"
    for k in range(300):
        damaged = bytearray(whole[: rng.integers(len(whole))] if k % 3 == 0 else whole)
        for at in rng.integers(0, max(len(damaged), 1), 3) if damaged else ():
            damaged[at] = rng.integers(256)
        path.write_bytes(bytes(damaged))
        with suppress(InputError):
            read_channel(path, MOST)


def test_other_kinds_are_refused(tmp_path: Path) -> None:
    path, image = tmp_path / "depth.exr", np.ones((200, 100), "<f4")
    path.write_bytes(exr({"Y": image}))
    with pytest.raises(InputError, match="pixels"):
        read_channel(path, MOST)
    path.write_bytes(exr({"Y": image}).replace(b"compression\0\x01\0\0\0\x03", b"compression\0\x01\0\0\0\x04"))
    with pytest.raises(InputError, match="none, ZIPS or ZIP"):
        read_channel(path, 10 * MOST)
