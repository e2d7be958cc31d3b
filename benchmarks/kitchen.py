"""The measurements of docs/kitchen.md: ``python -m benchmarks.kitchen VIDEO OUT [--write]``.

VIDEO is ``kitchen_plate.mp4``. Each labelled frame but the first and last is left out in turn, and estimated from the
others. Then the clip is made and reconstructed, by commands, into the folder OUT: with the guessed focal length and
with that of a wide lens. ``--write`` puts the tables into the page.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from benchmarks import page
from getagrip.annotate import labels
from getagrip.annotate.carried_masks import Images
from getagrip.annotate.clicked_hands import ClickedHands, hands_from_clicks
from getagrip.annotate.labels import OBJECT, Labels
from getagrip.annotate.propagated_masks import propagate
from getagrip.annotate.steadied_hands import steadied
from getagrip.annotate.video import Video
from getagrip.clip import read_clip
from getagrip.clip.intrinsics import intrinsics
from getagrip.experiments.stamp import stamp
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.lens import Lens
from getagrip.result import read_result

LABELLED = page.ROOT / "tests" / "helpers" / "kitchen_plate_labels.json"
LENSES = {"guessed, 1920 px": [], "1000 px": ["--focal", "1000"]}
"""Options by what they mean: the image's longer side, and a wide lens, usual for cameras worn on the head."""
METHODS = ("soft-hinge", "contact-consistency", "one-dof", "static")


def main(video: Path, out: Path, write: bool) -> None:
    """Measure, and print the tables or put them into the page."""
    sections = {"kitchen-left-out": left_out(video), "kitchen-lens": lenses(video, out)}
    for name, text in sections.items():
        page.write(name, text) if write else print(text, end="\n\n")


def left_out(video: Path) -> str:
    """What is estimated for labelled frames from the others."""
    annotation, footage = labels.read(LABELLED), Video(video)
    masks, joints = polygons_left_out(annotation, footage.image), joints_left_out(annotation, footage.image)
    footage.close()
    none = ("", "", "")
    rows = [[str(n), *masks.get(n, none[:2]), *joints.get(n, none)] for n in sorted(masks | joints)]
    columns = ["polygon gap", "IOU of the mask", "joint gap", "joint error, smooth only", "joint error, with tracking"]
    K, _ = intrinsics(Lens(guess_focal=True), annotation.size)
    fit = hands_from_clicks(annotation.clicks, K, annotation.side, annotation.first, annotation.last)
    off = f"All clicks in use, the joints are {np.sqrt(np.nanmean(fit.residuals**2)):.1f} px off, root mean square."
    return f"*Made {stamp()}.*\n\n{page.table(['frame left out', *columns], rows)}\n\n{off}"


def joints_left_out(annotation: Labels, image: Images) -> dict[int, tuple[str, str, str]]:
    """The gap, and the distance of the fitted joints from the clicks without and with tracking."""
    K, _ = intrinsics(Lens(guess_focal=True), annotation.size)
    rows = {}
    for n in list(annotation.clicks)[1:-1]:
        others = {key: points for key, points in annotation.clicks.items() if key != n}
        smooth = hands_from_clicks(others, K, annotation.side, annotation.first, annotation.last)
        tracked = steadied(smooth, annotation.first, K, annotation.size, image)
        gap = min(key for key in others if key > n) - max(key for key in others if key < n)
        off = [_off(hands, n - annotation.first, K, annotation.clicks[n]) for hands in (smooth, tracked)]
        rows[n] = (str(gap), f"{off[0]:.0f} px", f"{off[1]:.0f} px")
    return rows


def _off(hands: ClickedHands, row: int, K: Float[ndarray, "3 3"], clicks: Float[ndarray, "21 2"]) -> float:
    assert hands.hand.joints is not None
    uv = project(K, se3.transform(hands.hand.T_cam_hand[row], hands.hand.joints[row]))
    return float(np.nanmean(np.linalg.norm(uv - clicks, axis=1)))


def polygons_left_out(annotation: Labels, image: Images) -> dict[int, tuple[str, str]]:
    """The gap, and the IOU of the propagated mask with the polygon."""
    keys, rows = annotation.label_maps(), {}
    frames = sorted(keys)
    for start, n, end in zip(frames, frames[1:], frames[2:], strict=False):
        for frame, drawn, _ in propagate(image, {start: keys[start], end: keys[end]}, start, end):
            if frame == n:
                a, b = drawn == OBJECT, keys[n] == OBJECT
                rows[n] = (str(end - start), f"{(a & b).sum() / (a | b).sum():.3f}")
    return rows


def lenses(video: Path, out: Path) -> str:
    """Results with each focal length, by each method."""
    rows = []
    for lens, option in LENSES.items():
        folder = out / ("-".join(option).strip("-") or "guessed")
        clip = make(video, folder, option)
        for method in METHODS:
            run("reconstruct", clip, "--method", method, "--out", folder / method, "--overwrite")
            result, _ = read_result(folder / method / clip.name)
            diameter = result.scale * read_clip(clip).warped(result.warp).mesh.diameter
            energy = result.candidates.energy
            second = f"+{100 * (energy[1] / energy[0] - 1):.1f} %" if len(energy) > 1 else "none"
            rows.append([
                f"{lens}, `{method}`", f"{np.nanmean(result.iou):.2f}", f"{result.energy['total']:.0f}",
                f"{diameter:.3f} m", "yes" if result.warp else "no", second,
                str(result.probability_right or ""),
            ])  # fmt: skip
    columns = [
        "IOU",
        "energy",
        "plate's diameter",
        "shape fitted",
        "second solution's energy",
        "probably right in the hand",
    ]
    return f"*Made {stamp()}.*\n\n{page.table(['focal length, method', *columns], rows)}"


def make(video: Path, folder: Path, lens: list[str]) -> Path:
    """The clip, by the commands of the page."""
    labelled, clip = folder / "labels", folder / "kitchen"
    run("annotate", video, "--out", labelled, "--import-labels", LABELLED, "--export", *lens)
    (made,) = labelled.glob("imported-*")
    run(
        "clip", "new", video, "--interval", "36", "112", "--side", "left", "--hands", made / "hand.npz",
        "--masks", made / "masks", "--object", "1", "--ignore", "2", "--hand", "3", "--mesh", "plate",
        "--out", clip, "--overwrite", *lens,
    )  # fmt: skip
    return clip


def run(*command: str | Path) -> None:
    """A command of ``getagrip``. Raises ``subprocess.CalledProcessError`` where it fails."""
    subprocess.run([sys.executable, "-m", "getagrip", *map(str, command)], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), "--write" in sys.argv)
