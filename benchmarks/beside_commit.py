"""Speed of an earlier commit and of today's code, in turn in one run: ``python -m benchmarks.beside_commit [CLIPS]``.

The code of ``COMMIT`` is taken out of git, and runs with the libraries of this environment. A process of each code
makes the same scenes and answers the same requests, a request at a time, in an order that alternates; only names that
both codes have are used. CLIPS is a folder of clips, such as six of DexYCB, that both can read.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from statistics import mean, median
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks import store
from benchmarks.store import Table, of_cells
from benchmarks.timing import circumstances
from getagrip.geometry.mesh import Mesh, decimate, edge_length, face_areas, subdivide_surface
from getagrip.geometry.mesh_files import write_mesh
from getagrip.synthetic.scene import synthesise

COMMIT = "660d4867"
CATEGORIES = "mug", "pan", "kettle", "scissors", "spoon", "bowl", "box", "bottle"
FRAMES, FACES, SIZES = (10, 30, 100, 300, 1000), (300, 2000, 20_000), ((640, 480), (1920, 1080), (3840, 2160))
MOST_FRAMES_THEN = 300
"""Number of frames beyond which the earlier code needs several gigabytes, and is not run."""
REPEATS = 3
MIN_FACE_AREA_M2 = 1e-9
"""Smaller faces have no area in a file of rounded coordinates."""
SYNTHETIC = "synthetic:"
WORKER = """
import json, sys, time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
import numpy as np
import getagrip

def made(ask):
    if not ask["clip"].startswith("synthetic:"):
        clip = getagrip.read_clip(Path(ask["clip"]))
        return clip, getagrip.read_masks(clip)
    clip, masks = getagrip.synthesise(ask["clip"].split(":")[1], 0, getagrip.SceneOptions(**ask.get("scene", {})))
    return replace(clip, mesh=getagrip.read_mesh(ask["mesh"])) if "mesh" in ask else clip, masks

def answer(ask):
    clip, masks = made(ask)
    options, folder = getagrip.Options(**ask.get("options", {})), None
    if ask.get("read"):
        folder = getagrip.write_clip(clip, masks, Path(scratch) / str(time.time_ns()))
    best = None
    for _ in range(ask["repeats"]):
        since = time.process_time()
        if folder is not None:
            clip = getagrip.read_clip(folder)
            masks = getagrip.read_masks(clip)
        clip = replace(clip, mesh=getagrip.Mesh(clip.mesh.vertices, clip.mesh.faces))
        result = getagrip.reconstruct(clip, masks, options)
        spent = time.process_time() - since
        if best is None or spent < best[0]:
            best = spent, result
    found = {"cpu": best[0], "iou": float(np.nanmean(best[1].iou)), "stages": best[1].seconds}
    if ask.get("score"):
        found["add"] = getagrip.evaluate(best[1], clip, masks).metrics["add_sym_mm"] / (1e3 * clip.mesh.diameter)
    return found

with TemporaryDirectory() as scratch:
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)
"""


Ask = dict[str, Any]
"""A request: clip, its scene, faces, options, repeats, and mesh, whether reading counts and the pose is scored."""
Answer = dict[str, Any]


class Code:
    """A process of one code, which answers requests."""

    def __init__(self, source: Path) -> None:
        environment = os.environ | {"PYTHONPATH": str(source), "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [sys.executable, "-c", WORKER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )

    def answer(self, ask: Ask) -> Answer:
        """Answer a request. Raises ``SystemExit`` where the process has died."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(ask) + "\n")
        self.process.stdin.flush()
        if line := self.process.stdout.readline():
            return dict(json.loads(line))
        sys.exit(f"the process for {ask} has died: see its error above")


def earlier_source(folder: Path) -> Path:
    """Take the code of ``COMMIT`` out of git, into a folder."""
    packed = subprocess.run(["git", "archive", COMMIT, "src"], check=True, capture_output=True).stdout
    with tarfile.open(fileobj=BytesIO(packed)) as tar:
        tar.extractall(folder, filter="data")
    return folder / "src"


def tables(clips: Sequence[Path]) -> dict[str, Table]:
    """Measure: clips with their stages, and growth with frames, faces and pixels."""
    asked: dict[str, Ask] = {name: {"clip": SYNTHETIC + name, "score": True} for name in CATEGORIES}
    asked |= {path.name: {"clip": str(path.absolute()), "score": True} for path in clips}
    with TemporaryDirectory() as scratch, ExitStack() as ends:
        grown = growing(Path(scratch))
        codes = Code(earlier_source(Path(scratch))), Code(Path("src").absolute())
        for code in codes:
            ends.callback(code.process.kill)
            code.answer({"clip": SYNTHETIC + CATEGORIES[0], "repeats": 1})  # compiles kernels or loads them
        pairs = {label: in_turn(codes, ask, k % 2) for k, (label, ask) in enumerate((asked | grown).items())}
    of_clips = [pairs[label] for label in asked]
    ratios = [now["cpu"] / then["cpu"] for then, now in of_clips if then]
    means = [mean(each[k]["cpu"] for each in of_clips) for k in (0, 1)]
    rows = [[label, *times(*pairs[label]), *quality(*pairs[label])] for label in asked]
    rows.append(["mean", *cells(*means), "", "", "", ""])
    rows.append(["median of the ratios", "", "", f"{median(ratios):.2f}", "", "", "", ""])
    stages = [
        [name, *cells(*(mean(each[k]["stages"].get(name, 0.0) for each in of_clips) for k in (0, 1)))]
        for name in of_clips[0][1]["stages"]
    ]
    columns, about = ["then, ms", "now, ms", "ratio"], f"beside commit {COMMIT}"
    how = [f"processor time, the least of {REPEATS} runs in turn with the earlier code's, one thread"]
    scores = ["IOU then", "IOU now", "ADD then, % of diameter", "ADD now, % of diameter"]
    growth = [[label, *times(*pairs[label])] for label in grown]
    return {
        "beside-commit": of_cells(f"Time of a clip {about}", ["clip", *columns, *scores], rows, how),
        "beside-commit-stages": of_cells(
            f"By stage {about}", ["stage", *columns], stages, ["wall time, mean of the clips"]
        ),
        "beside-commit-growth": of_cells(f"Growth {about}", ["a kettle", *columns], growth, how),
    }


def growing(scratch: Path) -> dict[str, Ask]:
    """Return requests of growing size: frames fitted together, faces, and images read and fitted.

    Meshes go into ``scratch``.
    """
    kettle = SYNTHETIC + "kettle"
    asks: dict[str, Ask] = {
        f"{n} frames together": {"clip": kettle, "scene": {"frames": n}, "options": {"frames": n}, "repeats": 1}
        for n in FRAMES
    }
    asks["1000 frames, 30 together"] = {"clip": kettle, "scene": {"frames": 1000}, "repeats": 1}
    mesh = synthesise("kettle", 0)[0].mesh
    length = edge_length(float(mesh.vertex_areas.sum()), max(FACES))
    fine = Mesh(*subdivide_surface(mesh.vertices, mesh.faces, length))
    for n in FACES:
        path = scratch / f"{n}.obj"
        few = decimate(fine, n)
        whole = face_areas(few.vertices, few.faces) > MIN_FACE_AREA_M2
        write_mesh(Mesh(few.vertices, few.faces[whole]), path)
        asks[f"{n} faces"] = {"clip": kettle, "mesh": str(path)}
    for width, height in SIZES:
        scene = {"size": [width, height], "focal": 600.0 * height / 480.0}
        asks[f"{width} x {height}, with reading"] = {"clip": kettle, "scene": scene, "read": True}
    return asks


def in_turn(codes: tuple[Code, Code], ask: Ask, first: int) -> tuple[Answer | None, Answer]:
    """Ask both codes, ``first`` (0 or 1) first; None where the request is too large for the earlier one."""
    whole = {"repeats": REPEATS} | ask
    answers: list[Answer | None] = [None, None]
    for which in (first, 1 - first):
        if which == 1 or ask.get("options", {}).get("frames", 0) <= MOST_FRAMES_THEN:
            answers[which] = codes[which].answer(whole)
    assert answers[1] is not None
    return answers[0], answers[1]


def cells(then: float, now: float) -> list[str]:
    """Format two times [s] and their ratio."""
    return [f"{1e3 * then:,.0f}", f"{1e3 * now:,.0f}", f"{now / then:.2f}" if then else "–"]


def times(then: Answer | None, now: Answer) -> list[str]:
    """Format the times of both codes; a dash for one that was not asked."""
    return cells(then["cpu"], now["cpu"]) if then else ["–", f"{1e3 * now['cpu']:,.0f}", "–"]


def quality(then: Answer | None, now: Answer) -> list[str]:
    """Format IOU and ADD of both codes."""
    assert then is not None
    return [*(f"{it['iou']:.3f}" for it in (then, now)), *(f"{100 * it['add']:.1f}" for it in (then, now))]


def main(arguments: Sequence[str]) -> None:
    """Measure, and keep the tables."""
    clips = sorted(path for folder in arguments for path in Path(folder).iterdir())
    made = circumstances("python -m benchmarks.beside_commit" + " CLIPS" * bool(clips))
    for name, table in tables(clips).items():
        print(store.write(name, replace(table, made=made)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
