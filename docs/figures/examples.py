"""Draw docs/images/examples/*.webp: each script of examples/ is run, and what it made is drawn.

python docs/figures/examples.py [NUMBER...]
"""

from __future__ import annotations

import contextlib
import os
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy import ndarray
from PIL import Image

import getagrip
from getagrip.cli import main as getagrip_main
from getagrip.geometry.camera import crops_around
from getagrip.io.images import read_image
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stored_results import draw_overlay, draw_side_view, smooth_windows

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "docs" / "images" / "examples"
SIDE = 240
"""Height of the pictures and width of a tile [px]."""
CYAN, ORANGE, BLUE = (0, 170, 200), (235, 140, 60), (70, 110, 190)
Names = dict[str, Any]


def overlay(result: Any, clip: Any, masks: Any, n: int = 0, from_side: bool = False) -> ndarray:
    """A frame of a result over its masks, or from the side."""
    clip = clip.take(clip.index_of(result.frames))
    view = View.of(result, clip, masks)
    return (draw_side_view if from_side else draw_overlay)(view, n, smooth_windows(view, SIDE), n)


def tinted(clip: Any, masks: Any, n: int) -> tuple[ndarray, Any]:
    """The masks of a frame, the object's blue and the hand's orange, in a window around the object; and the window."""
    crops = crops_around(masks.object, 1.9, SIDE)
    shown = np.full((SIDE, SIDE, 3), 244, dtype=np.uint8)
    for mask, colour in ((masks.ignore, ORANGE), (masks.object, BLUE)):
        shown[crops.resample(mask, False)[n]] = colour
    return shown, crops.intrinsics(clip.K)[n]


def dots(picture: ndarray, X: ndarray, K: ndarray, radius: int = 3) -> ndarray:
    """Points of the camera frame on a picture."""
    for u, v in ((X / X[:, 2:]) @ K.T)[:, :2].round().astype(int):
        cv2.circle(picture, (int(u), int(v)), radius, (30, 30, 30), -1, cv2.LINE_AA)
    return picture


def synthetic_clip(names: Names) -> list[ndarray]:
    made = names["result"], names["clip"], names["masks"]
    return [overlay(*made, 10), overlay(*made, 10, from_side=True)]


def own_arrays(names: Names) -> list[ndarray]:
    clip, n = names["clip"], 15
    shown, K = tinted(clip, names["input_masks"], n)
    T = names["T_cam_hand"][n]
    dots(shown, names["vertices"][n] @ T[:3, :3].T + T[:3, 3], K, 1)
    result = names["result"]
    return [shown, overlay(result, clip, names["input_masks"], n, from_side=True)]


def own_video(names: Names) -> list[ndarray]:
    clip, n = names["clip"], 5
    image = read_image(names["source"] / "frames" / f"{clip.frames[n]}.jpg", clip.size)
    masked, _ = tinted(clip, names["masks"], n)
    crops = crops_around(names["masks"].object, 1.9, SIDE)
    (x, y), side = crops.corner[n].round().astype(int), int(crops.side)
    framed = cv2.copyMakeBorder(image, side, side, side, side, cv2.BORDER_REPLICATE)
    return [cv2.resize(framed[y + side : y + 2 * side, x + side : x + 2 * side], (SIDE, SIDE)), masked]


def estimator_files(names: Names) -> list[ndarray]:
    n = 15
    shown, K = tinted(names["clip"], names["masks"], n)
    with np.load(names["joints_file"]) as stored:
        dots(shown, stored["joints"][n], K)
    return [shown, overlay(names["result"], names["clip"], names["masks"], n, from_side=True)]


def real_dataset(names: Names) -> list[ndarray]:
    made = names["result"], names["clip"], names["masks"]
    return [overlay(*made, n) for n in (0, len(names["clip"]) - 1)]


def own_energy_term(names: Names) -> list[ndarray]:
    clip, masks = names["clip"], names["masks"]
    results = {"without": getagrip.reconstruct(clip, masks), "with it": names["result"]}
    true = clip.truth.T_cam_obj[:, :3, 2]
    off = {
        name: np.degrees(np.arccos(np.clip(np.sum(one.T_cam_obj[:, :3, 2] * true, axis=1), -1.0, 1.0)))
        for name, one in results.items()
    }
    return [overlay(names["result"], clip, masks, 15, from_side=True), curves("axis off, deg", off)]


def curves(title: str, lines: dict[str, ndarray]) -> ndarray:
    """Curves over the frames, from 0 to the largest value of all, each named beside its last point."""
    shown = np.full((SIDE, SIDE, 3), 250, dtype=np.uint8)
    left, right, top, bottom = 30, SIDE - 12, 46, SIDE - 24
    most = np.ceil(max(values.max() for values in lines.values()))
    label = partial(cv2.putText, shown, fontFace=cv2.FONT_HERSHEY_SIMPLEX, thickness=1, lineType=cv2.LINE_AA)
    label(text=title, org=(left, 22), fontScale=0.5, color=(60, 60, 60))
    label(text=f"{most:.0f}", org=(8, top + 5), fontScale=0.4, color=(60, 60, 60))
    label(text="0", org=(8, bottom + 4), fontScale=0.4, color=(60, 60, 60))
    cv2.polylines(shown, [np.array([[left, top], [left, bottom], [right, bottom]])], False, (190, 190, 190), 1)
    for (name, values), colour in zip(lines.items(), (ORANGE, BLUE), strict=True):
        x, y = np.linspace(left, right, len(values)), bottom - values / most * (bottom - top)
        cv2.polylines(shown, [np.stack([x, y], axis=1).round().astype(np.int32)], False, colour, 2, cv2.LINE_AA)
        label(text=name, org=(right - 66, int(y[-8:].min()) - 8), fontScale=0.45, color=colour)
    return shown


def own_method(names: Names) -> list[ndarray]:
    folders = {path.parent.parent.name: path.parent for path in sorted(names["out"].rglob("result.npz"), reverse=True)}
    results = [getagrip.read_result(folders[name])[0] for name in ("soft-hinge", "coarse-static")]
    clip, worst = getagrip.read_clip(names["out"] / "clips" / results[0].clip), int(np.argmin(results[1].iou))
    return [overlay(result, clip, getagrip.read_masks(clip), worst) for result in results]


def batch(names: Names) -> list[ndarray]:
    tiles = []
    for folder in sorted(path.parent for path in names["out"].glob("results/*/result.npz")):
        clip = getagrip.read_clip(names["out"] / "clips" / folder.name)
        tiles.append(overlay(getagrip.read_result(folder)[0], clip, getagrip.read_masks(clip), 15))
    return tiles


def robot_dataset(names: Names) -> list[ndarray]:
    """The path of hand and object in the exported arrays, and the frame that it ends in."""
    with np.load(names["out"] / "npz" / "scene.npz") as stored:
        paths = [(stored[key][:, :3, 3], colour) for key, colour in (("T_cam_hand", ORANGE), ("T_cam_obj", BLUE))]
    both = np.concatenate([path for path, _ in paths])[:, :2]
    middle, scale = (both.min(axis=0) + both.max(axis=0)) / 2.0, 0.8 * SIDE / np.ptp(both, axis=0).max()
    shown = np.full((SIDE, SIDE, 3), 250, dtype=np.uint8)
    for path, colour in paths:
        uv = ((path[:, :2] - middle) * scale + SIDE / 2.0).round().astype(np.int32)
        cv2.polylines(shown, [uv[:, None]], False, colour, 2, cv2.LINE_AA)
        for at in uv[::3]:
            cv2.circle(shown, tuple(map(int, at)), 3, colour, -1, cv2.LINE_AA)
    return [shown, overlay(names["result"], names["clip"], names["masks"], -1 % len(names["clip"]), from_side=True)]


def refine_poses(names: Names) -> list[ndarray]:
    clip, masks = names["clip"], names["masks"]
    return [overlay(one, clip, masks, len(clip) - 1) for one in (names["theirs"], names["refined"])]


def own_clip() -> list[str]:
    """The demo's clip."""
    assert getagrip_main(["demo", "--quiet"]) == 0
    return []


def clips() -> list[str]:
    """A folder of clips, since a dataset's images may not be shown."""
    clip, masks = getagrip.synthesise("bowl", 4)
    getagrip.write_clip(clip, masks, Path("clips") / clip.name)
    return ["clips"]


BEFORE: dict[str, Callable[[], list[str]]] = {"own_video": own_clip, "real_dataset": clips}
"""What a script needs: files, and its arguments."""


@contextlib.contextmanager
def called(script: Path, words: list[str]) -> Iterator[None]:
    """Arguments of a script, as it sees them."""
    before, sys.argv = sys.argv, [str(script), *words]
    try:
        yield
    finally:
        sys.argv = before


def draw(script: Path) -> None:
    """Run a script in a new folder, and draw its picture."""
    kind = script.stem[3:]
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        words = BEFORE.get(kind, list)()
        if kind == "own_method":  # the benchmark's processes import it
            subprocess.run([sys.executable, str(script)], check=True)
            names: Names = {"out": Path("out", "own-method")}
        else:
            with called(script, words):
                names = runpy.run_path(str(script), run_name="__main__")
        tiles = globals()[kind](names)
    row = np.concatenate([tile for pair in zip(tiles, [gap()] * len(tiles), strict=True) for tile in pair][:-1], axis=1)
    Image.fromarray(row).save(OUT / f"{script.stem}.webp", quality=80, method=6)
    print(f"{script.stem}: {(OUT / f'{script.stem}.webp').stat().st_size} bytes", file=sys.__stdout__)


def gap() -> ndarray:
    """White between tiles."""
    return np.full((SIDE, 8, 3), 255, dtype=np.uint8)


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    OUT.mkdir(exist_ok=True)
    for path in sorted((ROOT / "examples").glob("*.py")):
        if not sys.argv[1:] or path.stem[:2] in sys.argv[1:]:
            draw(path)
