"""``getagrip import segments``: what the object does from frame to frame, from a file into a clip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from getagrip.clip import Segment, segment_files
from getagrip.clip.reading import read_header
from getagrip.clip.segment_files import STATED_BY_USER, SegmentList
from getagrip.commands.command import Command
from getagrip.errors import UsageError
from getagrip.io.arguments import Flag
from getagrip.io.terminal import format_count, print_result


@dataclass(frozen=True, kw_only=True)
class ImportSegments(Command):
    """Add segments to a clip, which becomes a timeline: a file of annotate or of segment --from-masks."""

    path: Annotated[Positional[Path], arg(metavar="FILE")]
    """segments.json, or segments-NAME.json (docs/formats.md). The clip's own entry is taken, or the only one."""
    clip: Annotated[Path, arg(metavar="CLIP")]
    """The clip's folder. Segments are cut at the clip's ends."""
    still_camera: Flag = False
    """The camera did not move: its frame is the world."""
    overwrite: Flag = False
    """Replace segments that are there already."""

    def run(self) -> int:
        """Write the segments of a file into a clip's ``clip.json``.

        Raises ``InputError``, and ``UsageError`` where there are segments already, or a camera pose that is to be
        another.
        """
        header = read_header(self.clip)
        segment_files.check_segments_replaceable(header, self.overwrite)
        listed = add_camera_statement(
            segment_files.read_segment_list(self.path, [header.fields["name"]]), self.still_camera
        )
        if self.still_camera and "T_world_cam" in header.fields["camera"]:
            raise UsageError(f"--still-camera cannot be used with {header.folder}: it has camera.T_world_cam")
        segments = segment_files.write_clip_segments(header, listed)
        print_result(f"{header.folder / 'clip.json'}: {describe_segments(segments)}")
        return 0


def add_camera_statement(listed: SegmentList, still_camera: bool) -> SegmentList:
    """Add the command line's statement about the camera to segments."""
    return replace(listed, still_camera=STATED_BY_USER) if still_camera else listed


def describe_segments(segments: tuple[Segment, ...]) -> str:
    """List the segments, in words."""
    return f"{format_count(len(segments), 'segment')}: {', '.join(one.state for one in segments)}"
