"""``getagrip import segments``: what the object does from frame to frame, from a file into a clip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from getagrip.clip import Segment, segment_files
from getagrip.clip.reading import read_header
from getagrip.clip.segment_files import STATED, SegmentList
from getagrip.errors import UsageError
from getagrip.io.counts import counted
from getagrip.io.terminal import say


def into_clip(source: Path, folder: Path, still_camera: bool, overwrite: bool) -> int:
    """Write the segments of a file into a clip's ``clip.json``.

    Raises ``InputError``, and ``UsageError`` where there are segments already, or a camera pose that is to be another.
    """
    header = read_header(folder)
    segment_files.check_free(header, overwrite)
    given = stated(segment_files.read(source, [header.fields["name"]]), still_camera)
    if still_camera and "T_world_cam" in header.fields["camera"]:
        raise UsageError(f"--still-camera: got it, expected none: {header.folder} has camera.T_world_cam")
    segments = segment_files.into_clip(header, given)
    say(f"{header.folder / 'clip.json'}: {in_words(segments)}")
    return 0


def stated(given: SegmentList, still_camera: bool) -> SegmentList:
    """Segments with what the command line says of the camera."""
    return replace(given, still_camera=STATED) if still_camera else given


def in_words(segments: tuple[Segment, ...]) -> str:
    """Which segments there are."""
    return f"{counted(len(segments), 'segment')}: {', '.join(one.state for one in segments)}"
