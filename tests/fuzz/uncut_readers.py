"""Uncut clips: their segments, what is found in them and made of them; and the hands that are put into clips."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fuzz.child import Read
from fuzz.reader import SHARED, Reader
from getagrip.bench.inputs.hand_sources import HandSource, WithHands
from getagrip.cli.import_hands import HandFile
from getagrip.clip import Clip, Masks, Segment, input_sha256, read_clip, read_masks, write_clip
from getagrip.clip import read as read_module
from getagrip.clip.clip import World
from getagrip.clip.read import read_header
from getagrip.fitting.options import Options
from getagrip.io import arrays
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.results import read_result_clip_masks
from getagrip.reconstruct import reconstruct
from getagrip.report.pages.result_page import write_page
from getagrip.report.pictures.result_view import View
from getagrip.result import SegmentResult, read_result_record, write_result
from getagrip.timelines.detect.detect_segments import find_segments
from helpers.clips import small_clip
from helpers.results import true_result

FEW = Options(inits=2, frames=2)


def uncut() -> tuple[Clip, Masks]:
    """The small clip, first still and then held."""
    clip, masks = small_clip(frames=4)
    world = World(np.tile(np.eye(4), (4, 1, 1)), np.array([0.0, 0.0, 1.0]), support=-0.5)
    segments = Segment("static", 0, 1), Segment("grasp", 2, 3, "right")
    return replace(clip, world=world, segments=segments), masks


def warmed(write: Read, read: Read) -> Reader:
    """A reader that needs kernels: they are loaded here, since to load them looks like a pickle that names classes."""

    def write_and_read(folder: Path) -> None:
        write(folder)
        read(folder)

    return Reader(write_and_read, read)


def write_uncut(folder: Path) -> None:
    write_clip(*uncut(), folder / "clip")


def a_timeline(folder: Path) -> None:
    """What is made of it."""
    clip = read_clip(folder / "clip")
    reconstruct(clip, read_masks(clip), FEW)


def found(folder: Path) -> None:
    """What is found in it."""
    clip = read_clip(folder / "clip")
    find_segments(clip, read_masks(clip), options=FEW)


def listed(folder: Path) -> None:
    """Segments beside a clip."""
    clip, masks = uncut()
    write_clip(replace(clip, world=None, segments=()), masks, folder / "clip")
    given = read_module.SegmentList.of(clip, clip.segments, "marked by ann", "as ann states")
    (folder / "segments.json").write_text(json.dumps({"small": given.fields, "other": given.fields}))


def use_listed(folder: Path) -> None:
    given = read_module.read_segment_list(folder / "segments.json", ["small"])
    clip = read_module.add_segments(read_clip(folder / "clip"), given)
    with TemporaryDirectory(dir=SHARED) as out:
        header = replace(read_header(folder / "clip"), folder=Path(out))
        assert read_module.write_clip_segments(header, given) == clip.segments


def report(folder: Path) -> None:
    """A result of a timeline, beside its clip."""
    clip, masks = uncut()
    write_clip(clip, masks, folder / "clip")
    names = [(clip.frames[s.first], clip.frames[s.last]) for s in clip.segments]
    rows = [
        SegmentResult(state=s.state, first=a, last=b, iou=0.9) for s, (a, b) in zip(clip.segments, names, strict=True)
    ]
    rows[0] = replace(rows[0], T_world_obj=np.eye(4))
    result = replace(true_result(clip, None), segments=tuple(rows), T_cam_hand=clip.hand.T_cam_hand)
    write_result(result, folder / "result", input_sha256(folder / "clip"))


def write_report(folder: Path) -> None:
    """What ``report`` makes of it."""
    result, clip, masks = read_result_clip_masks(folder / "result", folder / "clip")
    view, evaluation = View.of(result, clip, masks), evaluate(result, clip, masks)
    with TemporaryDirectory(dir=SHARED) as out:
        write_page(view, evaluation, read_result_record(folder / "result"), Path(out) / "report.html")


def hands(folder: Path) -> None:
    """A hand file of some frames, as ``clip new`` takes it."""
    clip, _ = small_clip()
    track = clip.hand
    about = {
        "frames": np.arange(3) + 5, "K": clip.K[0], "side": np.array("right"),
        "provenance_hands": np.array("by an estimator"),
    }  # fmt: skip
    regions = {f"region_{name}": index for name, index in track.regions.items()}
    given = {"vertices": track.vertices, "faces": track.faces, "T_cam_hand": track.T_cam_hand}
    arrays.write(folder / "small.npz", {**about, **regions, **given, "joints": track.joints})


def use_hands(folder: Path) -> None:
    HandFile.of(folder / "small.npz").at(tuple(f"{n:06d}" for n in range(4, 8)), "right", None)
    clip, masks = small_clip()
    source = HandSource("name", folder)
    WithHands(source, (source,))(replace(clip, frames=("5", "6", "7")), masks, 0)


READERS: dict[str, Reader] = {
    "timeline": warmed(write_uncut, a_timeline),
    "found": warmed(write_uncut, found),
    "segments": Reader(listed, use_listed),
    "report": warmed(report, write_report),
    "hand file": Reader(hands, use_hands),
}
"""By name."""
