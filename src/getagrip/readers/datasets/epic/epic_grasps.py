"""EPIC-Grasps (Zhu and Damen, "Get a Grip"): stable grasps in EPIC-KITCHENS' videos, as clips with VISOR's masks.

Hands come from an estimator's files; a clip without hands lacks its ``hand.npz`` until the user adds it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from getagrip.clip import Clip, Masks, Segment
from getagrip.errors import InputError, UsageError
from getagrip.io.files import read_bytes, shorten_value
from getagrip.io.options import Folder, OptionalFile, OptionalFolder
from getagrip.io.terminal import format_count
from getagrip.provenance import is_assumed
from getagrip.readers.datasets.dataset import Dataset, Draft, Missing, Note, Part
from getagrip.readers.datasets.epic import epic_clips, epic_images, visor
from getagrip.readers.datasets.epic.epic_images import Frames, Images, Video
from getagrip.readers.datasets.epic.epic_tables import MAX_EPIC_TABLE_BYTES, EpicGrasp, chosen_errata, read_grasps
from getagrip.stable_grasps.grasp_lists import parse_timeline_segments, report_backwards


@dataclass(frozen=True, kw_only=True)
class EpicGrasps(Dataset):
    """EPIC-Grasps' table, VISOR's annotations of its grasps, and what else their clips are made of."""

    parts_are = "videos"

    csv: Annotated[Positional[Path], arg(metavar="CSV")]
    """EPIC-Grasps' table, as published."""
    visor: Folder
    """VISOR's annotations, sparse, dense or both, and its frame_mapping.json, anywhere below."""
    frames: OptionalFolder = None
    """EPIC-KITCHENS' images: P01/rgb_frames/P01_01/frame_0000000001.jpg or P01_01.tar, or P01_01/..."""
    videos: OptionalFolder = None
    """EPIC-KITCHENS' videos, instead of --frames: P01/videos/P01_01.MP4, or P01_01.MP4."""
    hands: OptionalFolder = None
    """Hand files, one <clip name>.npz per clip: a hand.npz, optionally with frames and K (docs/datasets.md)."""
    cad: OptionalFolder = None
    """Meshes of the categories, <category>.obj, in metres, z up; by default the built-in shapes."""
    cameras: OptionalFolder = None
    """EPIC-Fields' cameras, <video>.json each."""
    timelines: OptionalFile = None
    """Import the timelines of EPIC-HIT's list instead of the table's grasps (docs/timelines.md); needs --cameras
    and --metric."""
    metric: OptionalFolder = None
    """With --timelines: similarities that make EPIC-Fields' worlds metric, with z up, one <video>.json per video."""
    focal: Annotated[float | None, arg(metavar="PX", help_behavior_hint="(default: assumed)")] = None
    """The focal length, instead of --cameras, in pixels of images 854 wide."""
    errata: bool = True
    """Apply the errata beside the table (<CSV>_errata.csv), if there are any. The paper's table does not apply them."""
    errata_file: Annotated[Path | None, arg(metavar="CSV", help_behavior_hint="(default: beside the table)")] = None
    """The file of the errata, if it is not beside the table."""

    def grasps(self) -> list[EpicGrasp]:
        """Read the stable grasps of the table. Raises ``UsageError`` and ``InputError``."""
        return read_grasps(self.csv, chosen_errata(self.csv, self.errata, self.errata_file))

    def parts(self, note: Note) -> Sequence[Part]:
        """List the videos with grasps and annotations."""
        images = self._images()
        self._check_camera()
        by_video: dict[str, list[EpicTimeline]] = {}
        for timeline in self._timelines(note):
            by_video.setdefault(timeline.span.video, []).append(timeline)
        there, mapping = visor.find_visor_files(self.visor), visor.find_mapping(self.visor)
        absent = [len(spans) for video, spans in by_video.items() if video not in there]
        if absent:
            of = format_count(len(absent), "video")
            note(f"{format_count(sum(absent), 'grasp')} skipped: VISOR's files of {of} are missing")
        if mapping is None:
            note(visor.NO_FRAME_MAPPING_NOTE)
        return [
            VideoGrasps(video, tuple(spans), tuple(there[video]), mapping, images(video), self)
            for video, spans in by_video.items()
            if video in there
        ]

    def _timelines(self, note: Note) -> list[EpicTimeline]:
        """List the timelines, one for each clip; a grasp of the table has no segments. Raises ``UsageError``."""
        if self.timelines is None:
            if self.metric is not None:
                raise UsageError("--metric cannot be used without --timelines")
            return [EpicTimeline(grasp, ()) for grasp in self.grasps()]
        if self.cameras is None or self.metric is None:
            raise UsageError("missing --cameras or --metric: --timelines needs both: static segments need a world")
        found = read_timelines(self.timelines, self.grasps(), note)
        metric = [one for one in found if (self.metric / f"{one.span.video}.json").is_file()]
        if len(metric) < len(found):
            note(f"{len(found) - len(metric)} timelines skipped: their videos have no file in {self.metric}")
        return metric

    def _images(self) -> Callable[[str], Images]:
        """Return the reader of each video's images. Raises ``UsageError`` unless the user names frames or videos."""
        if self.frames is not None and self.videos is None:
            return partial(Frames, self.frames)
        if self.videos is not None and self.frames is None:
            return partial(Video, self.videos)
        raise UsageError("missing --frames or --videos: EPIC-KITCHENS' images, or its videos, not both")

    def _check_camera(self) -> None:
        """Raise ``UsageError`` for conflicting options, and for an implausible focal length."""
        if self.cameras is not None and self.focal is not None:
            raise UsageError("--cameras cannot be used with --focal")
        width = epic_clips.EPIC_IMAGE_SIZE_PX[0]
        if self.focal is not None and not 0.05 * width <= self.focal <= 100 * width:
            raise UsageError(f"--focal must be in pixels of images {width} wide (got {self.focal:g})")

    def advice(self, made: Sequence[Mapping[str, object]], handless: int) -> Iterator[str]:
        """Yield advice on assumed cameras and missing hands."""
        guessed = [provenance["camera"] for provenance in made if is_assumed(provenance["camera"])]
        if guessed:
            yield f"the camera of {format_count(len(guessed), 'clip')} is {guessed[0]}; name --cameras or --focal"
        if handless:
            lacking = format_count(handless, "clip lacks its", "clips lack their")
            yield (
                f"{lacking} hand.npz: docs/estimators.md explains how to make it from a clip's frames; add it to the "
                "clip, or call this again with --hands"
            )


@dataclass(frozen=True)
class VideoGrasps:
    """The grasps or timelines of one video."""

    name: str
    """Name of the video."""
    grasps: tuple[EpicTimeline, ...]
    annotations: tuple[Path, ...]
    """VISOR's files of the video."""
    mapping: Path | None
    images: Images
    options: EpicGrasps

    def drafts(self, missing: Missing, note: Note) -> Iterator[Draft]:
        """Yield a clip for each grasp, with its images."""
        waiting = [one for one in self.grasps if missing(one.span.name, with_hands=self._hands(one.span) is not None)]
        if not waiting:
            return
        camera = self._camera(range(min(one.span.start for one in waiting), max(one.span.end for one in waiting) + 1))
        spans = [one.span for one in waiting]
        frames = epic_clips.collect_grasp_frames(self.annotations, visor.read_mapping(self.mapping, self.name), spans)
        for timeline in waiting:
            grasp = timeline.span
            make = partial(self._clip, timeline, frames.pop(grasp.name), camera, note)
            hands = self._hands(grasp)
            hand = None if hands is None else partial(epic_clips.read_grasp_hand, hands)
            yield Draft(grasp.name, make, lambda clip: self.images([int(name) for name in clip.frames]), hand)

    def _clip(
        self, timeline: EpicTimeline, frames: epic_clips.VisorFrames, camera: epic_clips.EpicCamera, note: Note
    ) -> tuple[Clip, Masks] | None:
        grasp = timeline.span
        path = self._hands(grasp)
        mesh, source = epic_clips.category_mesh(grasp.category, self.options.cad)
        hands = None if path is None else epic_clips.read_epic_hand_file(path)
        has_mapping = self.mapping is not None
        segments = timeline.segments
        return epic_clips.make_epic_clip(grasp, frames, mesh, source, camera, hands, has_mapping, note, segments)

    def _hands(self, grasp: EpicGrasp) -> Path | None:
        path = None if self.options.hands is None else self.options.hands / f"{grasp.name}.npz"
        return path if path is not None and path.is_file() else None

    def _camera(self, wanted: range) -> epic_clips.EpicCamera:
        """Read the camera of the video; for timelines, with its poses in the ``wanted`` frames."""
        if self.options.cameras is None:
            return epic_clips.epic_pinhole(self.options.focal)
        path = self.options.cameras / f"{self.name}.json"
        camera = epic_clips.read_epic_camera(path)
        if self.options.metric is None:
            return camera
        scale, T_metric_world = epic_images.read_metric_similarity(self.options.metric / f"{self.name}.json")
        T_world_cam = epic_images.read_epic_camera_poses(path, scale, T_metric_world, wanted)
        source = replace(camera.source, text=f"{camera.source}; its world made metric")
        return replace(camera, source=source, T_world_cam=T_world_cam)


@dataclass(frozen=True)
class EpicTimeline:
    """An interaction of a hand with an object."""

    span: EpicGrasp
    """The object and its main hand, from the first to the last frame."""
    segments: tuple[Segment, ...]
    """Segments by EPIC's frame numbers, with possible overlaps and gaps."""


def read_timelines(path: Path, grasps: Sequence[EpicGrasp], note: Note) -> list[EpicTimeline]:
    """Read the timelines of the authors' list (``epic_hit.json``), each once. Raises ``InputError``."""
    content = read_bytes(path, MAX_EPIC_TABLE_BYTES)
    try:
        listed = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(path, "", f"invalid JSON ({error})", "EPIC-HIT's list of timelines") from error
    if not isinstance(listed, list) or not all(isinstance(entry, dict) for entry in listed):
        raise InputError(path, "", shorten_value(listed), "a list of timelines, as epic_hit.json")
    by_film = {grasp.film: grasp for grasp in grasps if grasp.film}
    found: dict[str, EpicTimeline] = {}
    for n, entry in enumerate(listed):
        timeline = _parse_epic_timeline(path, f"[{n}]", entry, by_film)
        if timeline.segments:
            found[timeline.span.name] = timeline
    report_backwards(path, listed, note)
    if len(found) < len(listed):
        note(f"{path.name}: {len(listed) - len(found)} of {len(listed)} timelines are listed twice or empty: skipped")
    return list(found.values())


def _parse_epic_timeline(
    path: Path, key: str, entry: Mapping[str, object], by_film: Mapping[str, EpicGrasp]
) -> EpicTimeline:
    film = entry.get("mp4_name")
    grasp = by_film.get(film.removesuffix(".mp4")) if isinstance(film, str) else None
    if grasp is None:
        raise InputError(path, f"{key}.mp4_name", shorten_value(film), "the mp4_name of a grasp in EPIC-Grasps' table")
    for name, value in (("vid", grasp.video), ("cat", grasp.category)):
        if entry.get(name) != value:
            expected = f"{value}, as of {shorten_value(film)} in the table"
            raise InputError(path, f"{key}.{name}", shorten_value(entry.get(name)), expected)
    side = entry.get("main_side")
    if side not in ("left", "right"):
        raise InputError(path, f"{key}.main_side", shorten_value(side), "left or right")
    segments = parse_timeline_segments(path, f"{key}.segments", entry.get("segments"))
    if not segments:
        return EpicTimeline(grasp, ())
    first, last = min(s.first for s in segments), max(s.last for s in segments)
    return EpicTimeline(replace(grasp, side=side, start=first, end=last, note=""), segments)
