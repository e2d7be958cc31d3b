"""Segments in a file of their own, as ``segment --from-masks`` finds them and ``annotate`` writes them, and into clips.

    {"pour-01": {"segments": [{"state": "static", "first": "000743", "last": "000760"}, ...],
                 "source": "marked by ann", "still_camera": "as ann states"}, ...}

By clip or video, ``segments`` as ``clip.json`` has them. ``source`` says where they come from; ``still_camera`` that
the camera did not move, and who says so. Other keys (``margins``, ``notes``) are for people.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from getagrip.clip.data import Clip, World
from getagrip.clip.reading import ClipHeader
from getagrip.clip.timeline import Segment, read_segments, segment_fields
from getagrip.errors import InputError, UsageError
from getagrip.io import files

SEGMENTS_SOURCE_KEY, CAMERA_POSE_KEY = "segments", "camera_pose"
"""Keys of a clip's provenance."""
STATED_BY_USER = "as the user states"
"""Who says that the camera did not move, where the command line does."""
MAX_TEXT_CHARACTERS = 500
"""Characters of a text."""


@dataclass(frozen=True)
class SegmentList:
    """The segments of one clip or video.

    Attributes:
        path: the file, or what stands for it in errors.
        key: what it is called in there.
        rows: what ``clip.json`` would say of the segments; unchecked.
        source: where they come from; None where nobody says.
        still_camera: who says that the camera did not move; None where nobody does.
    """

    path: Path
    key: str
    rows: Sequence[Mapping[str, object]]
    source: str | None
    still_camera: str | None = None

    @staticmethod
    def of(clip: Clip, segments: Sequence[Segment], source: str, still_camera: str | None = None) -> SegmentList:
        """Make a list of segments of a clip that were found or made here."""
        return SegmentList(clip.origin, "segments", segment_fields(segments, clip.frames), source, still_camera)

    @property
    def fields(self) -> dict[str, object]:
        """The segments as a file holds them."""
        about = {"source": self.source, "still_camera": self.still_camera}
        return {"segments": self.rows, **{key: text for key, text in about.items() if text is not None}}

    def at(self, frames: Sequence[str], has_world: bool) -> tuple[Segment, ...]:
        """Return the segments in a clip with these frames, cut at its ends.

        Raises ``InputError`` where none is in it.

        Frames whose names are numbers are compared as numbers: ``"86"`` and ``"000086"`` are the same.
        """
        inside = [row for row in (_crop_segment(row, frames) for row in self.rows) if row is not None]
        if self.rows and not inside:
            ends = [
                files.shorten_value(row.get(end)) for row, end in ((self.rows[0], "first"), (self.rows[-1], "last"))
            ]
            listed = f"segments from {ends[0]} to {ends[1]}"
            raise InputError(self.path, self.key, listed, f"some of the frames {frames[0]} to {frames[-1]}")
        try:
            return read_segments(self.path, inside, frames, has_world)
        except InputError as error:
            hint = "; --still-camera says that the camera did not move" if error.key.endswith(".state") else ""
            raise InputError(self.path, f"{self.key}.{error.key}", error.got, f"{error.expected}{hint}") from error


def read_segment_list(path: Path, names: Sequence[str]) -> SegmentList:
    """Read the list of the first of ``names`` that a file has, or its only one. Raises ``InputError``."""
    content = files.read_json(path)
    key = next((name for name in names if name in content), None)
    if key is None and len(content) == 1:
        (key,) = content
    if key is None:
        there = ", ".join(map(files.printable, list(content)[:5])) or "nothing"
        raise InputError(path, "", f"the segments of {there}", f"those of {' or '.join(names)}")
    entry = content[key]
    rows = entry.get("segments") if isinstance(entry, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(
            path, files.printable(key), files.shorten_value(entry), 'an object with "segments", a list of objects'
        )
    texts = [
        _parse_segment_text(path, f"{files.printable(key)}.{name}", entry.get(name))
        for name in ("source", "still_camera")
    ]
    return SegmentList(path, files.printable(key), rows, texts[0] or f"from {path.name}", texts[1])


def add_segments(clip: Clip, listed: SegmentList) -> Clip:
    """Add segments to a clip and, where it has no camera pose, that of a camera that is said to stand still.

    Raises ``InputError`` for segments that are malformed or not in the clip.
    """
    still = listed.still_camera if clip.world is None else None
    world = clip.world if still is None else World(np.tile(np.eye(4), (len(clip), 1, 1)))
    segments = listed.at(clip.frames, world is not None)
    known = clip.provenance | _segment_provenance(listed.source, still)
    return replace(clip, segments=segments, world=world, provenance=known)


def check_segments_replaceable(header: ClipHeader, overwrite: bool) -> None:
    """Raise ``UsageError`` where a clip has segments that are not to be replaced."""
    if header.fields.get("segments") and not overwrite:
        raise UsageError(f"{header.folder / 'clip.json'}: has segments already; --overwrite replaces them")


def write_clip_segments(header: ClipHeader, listed: SegmentList) -> tuple[Segment, ...]:
    """Write segments into the ``clip.json`` of a folder, in the place of those that are there.

    A camera pose stays as it is, unless it was itself a statement that the camera stands still. Raises ``InputError``
    for segments that are malformed or not in the clip.
    """
    fields, camera = header.fields, header.fields["camera"]
    has_world = "T_world_cam" in camera and CAMERA_POSE_KEY not in fields["provenance"]
    still = None if has_world else listed.still_camera
    segments = listed.at(header.frames, still is not None or "T_world_cam" in camera)
    pose = {} if still is None else {"T_world_cam": np.eye(4)}
    new = {"camera": {**camera, **pose}, "segments": segment_fields(segments, header.frames)}
    known = fields["provenance"] | _segment_provenance(listed.source, still)
    with files.new_file(header.folder / "clip.json") as part:
        files.write_json(part, header.changed({**new, "provenance": known}))
    return segments


def _segment_provenance(source: str | None, still_camera: str | None) -> dict[str, str]:
    """Return the sources of segments, and of the pose of a camera that stands still."""
    still = None if still_camera is None else f"identity: the camera stands still, {still_camera}"
    return {key: text for key, text in ((SEGMENTS_SOURCE_KEY, source), (CAMERA_POSE_KEY, still)) if text is not None}


def _parse_segment_text(path: Path, key: str, value: object) -> str | None:
    if value is None:
        return None
    if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT_CHARACTERS or not value.isprintable():
        raise InputError(path, key, files.shorten_value(value), f"a text of up to {MAX_TEXT_CHARACTERS} letters")
    return value


def _crop_segment(row: Mapping[str, object], frames: Sequence[str]) -> Mapping[str, object] | None:
    """Return a segment in the frames of a clip, cut at its ends; None outside.

    Frames without a number stay as they are.
    """
    ends = [row.get("first"), row.get("last")]
    if not all(_is_frame_number(name) for name in (*ends, *frames)):
        return row
    first, last = (int(str(end)) for end in ends)
    within = [name for name in frames if first <= int(name) <= last]
    if first > last or not within:
        return row if first > last else None
    return {**row, "first": within[0], "last": within[-1]}


def _is_frame_number(name: object) -> bool:
    return isinstance(name, str) and name.isascii() and name.isdigit() and len(name) < 16
