"""A call of every command that writes as much as it can, and a small folder of what these calls read."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from getagrip import cli
from getagrip.bench.figures import FIGURES
from getagrip.bench.pixels.recording import DraftRequest
from getagrip.bench.pixels.video_draft import VideoDraft
from getagrip.bench.sequences.segments import TIME_DIRECTIONS
from getagrip.cli.datasets import DATASETS
from getagrip.clip import Clip, Masks, Segment, input_sha256, read_clip, write_clip
from getagrip.fitting.options import Options
from getagrip.hands import generic
from getagrip.io import arrays
from getagrip.readers.datasets.dataset import Draft
from getagrip.readers.datasets.ho3d import Ho3dEvaluation
from getagrip.result import Reconstruction, write_result
from getagrip.stable_grasps.find import as_listed
from getagrip.studio.store import labels
from getagrip.synthetic.scene import Scene, clip_name, make_scene
from getagrip.synthetic.scene_options import SceneOptions
from getagrip.timelines.detect.detect_segments import DetectedSegment, DetectedSegments
from helpers.clips import small_clip
from helpers.epic_files import box, hand, sparse, thing, write, write_mapping
from helpers.labelled_scene import SceneNets, circle, joints, write_scene
from helpers.recordings import write_recording
from helpers.results import AHEAD, K, everything, true_result, write_inputs
from helpers.scenes import SHORT, scene

CUP = f"--interval 3 8 --side right --mesh unit.obj --size-mm 120 --K {' '.join(K)} --overwrite"
MASKS = "--object 1 --ignore 2"
NEW_FRAMES = f"--side right --frames 3 8 --size 64 48 --K {' '.join(K)} --overwrite"
BENCH = "--out out --workers 1 --methods static"
BENCHED = ("dexycb", "ho3d-eval")
COMPOSED = ("reproduce epic-grasps", "reproduce arctic-grasps")
"""Commands that call others, and write tables only (tests/reproduction)."""
EXPORTS = {"usd": "pxr", "mujoco": "mujoco", "lerobot": "pyarrow", "mcap": "mcap"}
"""Formats that need a library."""
CALLS: dict[str, Sequence[str]] = {
    "demo": ["--out out"],
    "doctor": [""],
    "draft": ["scene.mp4 --object cup --out marks --no-page"],
    "label": ["videos --object cup --out marks --no-page"],
    "clip new": [f"video.mp4 --out new {CUP} --masks masks {MASKS} --hands six.npz"],
    "annotate": [
        "scene.mp4 --out marks",
        "scene.mp4 --out marks --import-labels labels.json --export",
        "scene.mp4 --out marks --import-segments segments.json --export",
    ],
    **{f"import {name}": ["root --out out --workers 1"] for name in DATASETS},
    "import hot3d": ["root --out out --workers 1", "root --out out --workers 1 --whole"],
    "import epic": ["table.csv --visor visor --out out --workers 1"],
    "import hands": [
        "joints.npz --from joints --order openpose --clip cup --overwrite",
        f"joints.npz --from joints --order openpose --out hands/new.npz {NEW_FRAMES}",
    ],
    "import depth": ["depths.npy --from unidepth --clip cup --overwrite"],
    "import masks": [f"masks {MASKS} --clip cup --overwrite"],
    "import cameras": ["cameras.txt --clip cup"],
    "import segments": ["segments.json --clip cup --still-camera --overwrite"],
    "epic candidates": ["--visor visor --actions actions.csv --out tables/out.csv --json out.json"],
    "reconstruct": [
        "clips --out out --workers 1 --method static --overwrite",
        "clips --find-grasps --out out --workers 1",
        "clips --cut-grasps --out out --workers 1 --method static",
    ],
    "evaluate": ["results --json new/out.json"],
    "refine": ["theirs.npy --clips clips --out out --workers 1 --overwrite"],
    "report": ["results/small --mp4", "results --workers 1"],
    "status": ["results"],
    "synthesise": ["bottle --frames 2 --out out --video"],
    "view": ["results"],
    **{f"figure {name}": ["results/small --out new/out.png"] for name in FIGURES},
    "figure ihoi": ["results/small --meshes other=meshes --out new/out.png"],
    "export": [
        *("results --to csv --overwrite", "results --to obj", "results --to glb --out out"),
        *(f"results --to {to} --out out" for to in ("npz", "bop", "spider", "dex-retargeting")),
        *(f"results --to {to} --out out" for to, library in EXPORTS.items() if find_spec(library)),
        *["results --to lerobot --out out --one-dataset"] * (find_spec("pyarrow") is not None),
    ],
    "replay": ["results --json new/out.json"] * (find_spec("mujoco") is not None),
    "bench clips": [f"clips {BENCH} --json out.json", f"clips {BENCH} --ablation mask-noise"],
    "bench synthetic": [f"{BENCH} --clips 1"],
    **{f"bench {name}": [f"--root root {BENCH} --split all"] for name in BENCHED},
    "bench recording": ["--root recording --hands found --out out --workers 1 --json out.json"],
    "bench video": ["--out out --clips 1 --workers 1 --json out.json"],
    "bench dexycb-segments": ["--root root --out out --workers 1 --split all --json out.json"],
    "bench dexycb-timelines": ["--root root --out out --workers 1 --split all --preset exact"],
    "bench hot3d-timelines": ["--root root --out out --workers 1 --split all --preset exact --json out.json"],
    "segment": [
        "held --out out --json out.json --workers 1",
        "clips --from-masks --out out --json out.json --write --workers 1",
    ],
    "study": ["held --out out --json out.json --workers 1"],
    "stats": ["grasps.json --out out --json out.json"],
    "init learn": ["clips --out new/out.npz --as-folder folder"],
}


def small(name: str = "S1--a--small", frames: int = 6) -> tuple[Clip, Masks]:
    """The small clip under a name that says whose it is, as those of datasets do."""
    clip, masks = small_clip(frames)
    return replace(clip, name=name, provenance={**clip.provenance, "camera": "known"}), masks


@dataclass(frozen=True)
class SmallPart:
    """A part of any dataset: the small clip."""

    name: str = "part"

    def drafts(self, *_: object) -> Iterator[Draft]:
        yield Draft(small()[0].name, small)


@cache
def _small_scene() -> Scene:
    return make_scene("bottle", 0, SceneOptions(frames=2, size=(160, 120), focal=150.0))


def quicken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put trifles in the place of what takes long and writes nothing: servers, fits, drawings, and datasets' files."""

    def ended(*_: object) -> None:
        raise KeyboardInterrupt

    def drawn(*_: object) -> Any:
        from matplotlib.figure import Figure

        return Figure(figsize=(1, 1))

    def fitted(clip: Clip, masks: object, options: Options = Options(), *_: object, **__: object) -> Reconstruction:  # noqa: B008
        return replace(true_result(clip, None), options=asdict(options))

    def drafted(request: DraftRequest) -> None:
        clip, masks = small()
        made = write_clip(clip, masks, request.out / "clips" / "grasp")
        write_result(true_result(clip, None), request.out / "results" / "grasp", input_sha256(made), {}, made)

    class SmallDraft(VideoDraft):
        def __init__(self, *_: object) -> None:
            self.stages = {}

        def solve(self, *_: object) -> dict[str, object]:
            return {"failure": "not tried", "seconds": 0.1}

    def found(clip: Clip, *_: object, **__: object) -> DetectedSegments:
        return DetectedSegments((DetectedSegment(Segment("grasp", 0, len(clip) - 1, clip.side), 9.0),), ())

    def made(category: str, seed: int, options: SceneOptions) -> tuple[Clip, Masks]:
        return small(clip_name(category, seed, options))

    spans = {"true": [[0, 1]], "fits": [[0, 1]], "motion": [[0, 1]], "seconds": 0.1}
    in_a_timeline = {"kind": "grasp", "right": True, "right_sym": True, "sca": 1.0}
    by = {"ours": {"segments": [in_a_timeline], "jumps": [], "seconds": 0.1}}
    parsed = cache(cli._parse_command)
    places = {
        "studio.server.Server.serve_forever": ended,
        "synthetic.video.VIDEO_SIZE_PX": (160, 120),
        "compiling.compile_once": lambda *_: None,
        "cli._parse_command": lambda words: parsed(tuple(words)),
        "synthetic.scene_options.DEMO_SCENE_OPTIONS": SHORT,
        "cli.calls.run_draft": drafted,
        "cli.doctor._smoke_test": lambda: None,
        "studio.hands.load_models": lambda _: SceneNets(),
        "synthetic.scene.synthesise": made,
        "bench.comparison.ABLATION_PLOT_METRICS": ("iou",),
        "bench.pixels.videos.VideoDraft": SmallDraft,
        "bench.pixels.videos.make_filmed_scene": lambda _: (_small_scene(), None),
        "bench.sequences.segments._find_in_both_directions": lambda _: dict.fromkeys(TIME_DIRECTIONS, spans),
        "bench.sequences.timelines._score_noise_level": lambda *_: {"category": "box", "by": by},
        "timelines.detect.detect_segments.find_segments": found,
        "report.pages.viewer.ViewerServer.serve_forever": ended,
        "report.film._overlay_and_turned_frames": lambda *_: iter(np.zeros((2, 576, 1080, 3), np.uint8)),
        "report.pictures.result_picture.report_figure": drawn,
    }
    for place, trifle in places.items():
        monkeypatch.setattr(f"getagrip.{place}", trifle)
    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", fitted)
    for kind in FIGURES.values():
        monkeypatch.setattr(kind, "draw", drawn)
    for dataset in (*DATASETS.values(), Ho3dEvaluation):
        monkeypatch.setattr(dataset, "parts", lambda *_: [SmallPart()])


def write_link_inputs(folder: Path) -> Path:
    """All that the calls read, as their words name it."""
    write_inputs(folder)
    (folder / "root").mkdir()
    (folder / "table.csv").touch()
    clip = small()[0]
    write_recording(folder / "recording", clip, [np.zeros((*clip.size[::-1], 3), np.uint8)] * len(clip))
    write_clip(*scene("can", 0, SHORT), folder / "held" / "can")
    _write_results(folder)
    _write_cup(folder)
    _write_annotations(folder)
    return folder


def _write_results(folder: Path) -> None:
    """A clip, its true poses as a result, and the list of its grasp."""
    there = write_clip(*small("small"), folder / "clips" / "small")
    clip = read_clip(there)
    true = true_result(clip, None)
    write_result(true, folder / "results" / "small", input_sha256(there), {}, there)
    np.save(folder / "theirs.npy", clip.hand.T_cam_hand @ true.T_hand_obj)
    (folder / "meshes").mkdir()
    for frame in clip.frames:
        trimesh.creation.box((0.1, 0.1, 0.1)).export(folder / "meshes" / f"{frame}.obj")
    (folder / "grasps.json").write_text(json.dumps({"version": 1, "grasps": [as_listed(clip, 0, 3).row()]}))


def _write_cup(folder: Path) -> None:
    """A clip with frames of the video, joints of its hand, and segments."""
    cup = ["clip", "new", folder / "video.mp4", "--out", folder / "cup", *everything(folder)]
    assert cli.main([*map(str, cup), "--hands", str(folder / "six.npz")]) == 0
    joints_of = generic.load("right").with_shape().with_pose().joints + AHEAD
    arrays.write(folder / "joints.npz", {"joints": np.tile(joints_of, (6, 1, 1)), "frames": np.arange(3, 9)})
    np.save(folder / "depths.npy", np.full((6, 48, 64), 0.5, np.float32))
    np.savetxt(folder / "cameras.txt", np.tile(np.eye(4)[:3].reshape(1, 12), (6, 1)))
    row = {"state": "static", "first": "000003", "last": "000005"}
    (folder / "segments.json").write_text(json.dumps({"scene": {"segments": [row]}}))


def _write_annotations(folder: Path) -> None:
    """A video with labels of its first frames, and VISOR's and EPIC's of another."""
    write_scene(folder / "scene.mp4", 6)
    (folder / "videos").mkdir()
    shutil.copy(folder / "scene.mp4", folder / "videos")
    clicked = {n: labels.FrameLabels(np.array(joints(n)), (np.array(circle(n)),)) for n in (0, 2)}
    sha256 = hashlib.sha256((folder / "scene.mp4").read_bytes()).hexdigest()
    labels.write_label_file(
        labels.Labels("scene", (320, 240), "left", 30.0, 0, 2, clicked, sha256), folder / "labels.json"
    )
    cup = thing("c", "cup", 13, box(0, 0, 9, 9))
    frames = [sparse("P01_101", n, cup, hand("left", "c", box(0, 0, 5, 5))) for n in (52, 82)]
    write(folder / "visor" / "P01_101.json", frames)
    write_mapping(folder / "visor" / "frame_mapping.json", "P01_101", {52: 50, 82: 80})
    heads = "narration_id,participant_id,video_id,start_frame,stop_frame,narration,verb,verb_class,noun,noun_class"
    heads += ",all_nouns"
    cells = "1,P01,P01_101,40,90,wash cup,wash,2,cup,13,['cup']"
    (folder / "actions.csv").write_text(f"{heads}\n{cells}\n")
