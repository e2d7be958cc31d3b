"""Two images, rows or poses of one frame are refused by every command, with the choice that mends it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import write_clip
from getagrip.io.images import write_image
from helpers.clips import small_clip
from helpers.environment import Run
from helpers.program_files import write_png

SETS = ("cam0", "cam1")
COUNT = 3


def files_of(place: Path, suffix: str, write: Callable[[Path, int], object]) -> Path:
    """A file of each frame and camera, and what other systems leave beside each."""
    place.mkdir()
    for n in range(COUNT):
        for name in SETS:
            write(place / f"{name}_{n:04d}{suffix}", n)
            (place / f"._{name}_{n:04d}{suffix}").write_bytes(b"\0\5\x16\7")
    return place


def masks(place: Path) -> Path:
    return files_of(place, ".png", lambda path, n: write_png(path, 1 * small_clip()[1].object[n], 8, 0))


def depth(place: Path) -> Path:
    return files_of(place, ".npy", lambda path, _: np.save(path, np.full((24, 32), 0.6, np.float32)))


def cameras(place: Path) -> Path:
    place.mkdir()
    matrix = np.eye(4).tolist()
    frames = [{"file_path": f"{s}/{n:04d}.jpg", "transform_matrix": matrix} for s in SETS for n in range(COUNT)]
    (place / "transforms.json").write_text(json.dumps({"frames": frames}))
    return place


IMPORTS = {
    "masks": (masks, ("import", "masks"), ()),
    "depth": (depth, ("import", "depth"), ("--from", "unidepth")),
    "cameras": (cameras, ("import", "cameras"), ()),
}


@pytest.mark.parametrize("kind", IMPORTS)
def test_two_of_a_frame_are_chosen_from(tmp_path: Path, run: Run, kind: str) -> None:
    make, command, options = IMPORTS[kind]
    folder = write_clip(small_clip()[0], None, tmp_path / "clip")
    fields = json.loads((folder / "clip.json").read_text())
    fields["camera"] = {"K": fields["camera"]["K"]}
    (folder / "clip.json").write_text(json.dumps(fields))
    before = (folder / "clip.json").read_bytes()
    call = (*command, make(tmp_path / "theirs"), "--clip", folder, *options)
    status, _, err = run(*call)
    assert status == 1
    assert "a second " in err
    assert "of frame 0000" in err
    assert "--images chooses: cam0" in err
    assert (folder / "clip.json").read_bytes() == before
    status, _, err = run(*call, "--images", "cam1*" if kind != "cameras" else "cam1")
    assert status in (0, 3), err
    status, _, err = run(*call, "--images", "cam7", "--overwrite")
    assert status == 2
    assert "--images must be" in err


@pytest.mark.parametrize("names", [("rgb_{:06d}.png", "depth_{:06d}.png"), ("{:04d}.jpg", "{:04d}_thumb.jpg")])
def test_two_sets_of_a_folder_of_footage_are_chosen_from(tmp_path: Path, run: Run, names: tuple[str, str]) -> None:
    (tmp_path / "images").mkdir()
    for n in range(COUNT):
        for k, name in enumerate(names):
            write_image(tmp_path / "images" / name.format(n), np.full((24, 32, 3), 40 * k, np.uint8))
            (tmp_path / "images" / f"._{name.format(n)}").write_bytes(b"\0\5\x16\7")
    call = ["clip", "new", tmp_path / "images", "--interval", "1", "3", "--side", "right", "--mesh", "mug"]
    call += ["--focal", "40", "--out", tmp_path / "clip"]
    status, _, err = run(*call)
    patterns = [name.partition("{")[0] + "*" + name.partition("}")[2].rpartition(".")[0] for name in names]
    assert status == 1
    assert all(f"--images '{pattern}'" in err for pattern in patterns)
    status, _, err = run(*call, "--images", patterns[0])
    assert status == 3, err
    made = [path.name for path in sorted((tmp_path / "clip" / "frames").iterdir())]
    assert made == [Path(names[0].format(n)).stem + ".jpg" for n in range(COUNT)]


@pytest.mark.parametrize("kind", ["masks", "depth", "cameras"])
def test_first_chooses_among_rows_without_names(tmp_path: Path, run: Run, kind: str) -> None:
    """Arrays of a whole video: row N on is the clip's, and without --first it is asked for."""
    folder = write_clip(small_clip()[0], None, tmp_path / "clip")
    fields = json.loads((folder / "clip.json").read_text())
    fields["camera"] = {"K": fields["camera"]["K"]}
    (folder / "clip.json").write_text(json.dumps(fields))
    seen = small_clip()[1].object
    if kind == "masks":
        np.save(tmp_path / "x.npy", np.concatenate([np.zeros_like(seen), seen, seen]))
        call = ["import", "masks", tmp_path / "x.npy"]
    elif kind == "depth":
        np.save(tmp_path / "x7.npy", np.concatenate([np.full((3, 24, 32), 9.0), np.full((6, 24, 32), 0.6)]))
        call = ["import", "depth", tmp_path / "x7.npy", "--from", "unidepth"]
    else:
        T = np.tile(np.eye(4), (9, 1, 1))
        T[:, 0, 3] = np.arange(9)
        np.savez(tmp_path / "x.npz", cam_c2w=T)
        call = ["import", "cameras", tmp_path / "x.npz"]
    call += ["--clip", folder]
    status, _, err = run(*call)
    assert status == 2
    assert "without names for 3 frames: missing --first N" in err
    assert run(*call, "--first", "8")[0] == 2
    status, _, err = run(*call, "--first", "3")
    assert status in (0, 3), err
    if kind == "cameras":
        camera = json.loads((folder / "clip.json").read_text())["camera"]
        assert np.array(camera["T_world_cam"])[:, 0, 3].tolist() == [3.0, 4.0, 5.0]
