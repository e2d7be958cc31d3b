"""The interface of a hand tracker, a dataclass of options with a reader of its files; and rows matched to frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from getagrip.clip.match_frames import check_unique_images, frame_of, number_of, rows_in_order
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays
from getagrip.io.files import printable, shorten_value
from getagrip.readers.trackers import records
from getagrip.readers.trackers.estimates import Estimates, Request
from getagrip.readers.trackers.records import Sample

MULTI_IMAGE_SUFFIXES = (".pkl", ".pickle", ".json", ".pt", ".pth")
"""Suffixes of files that may hold many images."""


@dataclass(frozen=True)
class Tracker:
    """A hand tracker. Its fields are options of the command, for information that the files lack."""

    name: ClassVar[str]
    """Name in a clip's provenance."""
    takes: ClassVar[str]
    """The tracker's files in a few words, for the command's help."""
    looks_for: ClassVar[str] = ""
    """Names and keys that identify the files, in a few words; empty if files are not recognised."""
    layouts: ClassVar[tuple[str, ...]] = ()
    """Patterns of the files below the tracker's output folder."""

    def recognises(self, sample: Sample) -> str:
        """Return a description of a file of this tracker; empty for other files."""
        return ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the hand in the requested frames; files of other frames are skipped.

        Raises ``InputError`` for missing, malformed or hostile files, ``UsageError`` for missing options.
        """
        raise NotImplementedError


def per_image(paths: Sequence[Path], request: Request) -> Iterator[tuple[Path, int, records.Record]]:
    """Yield the file, frame index and record of each image of a requested frame.

    A file is named like its image, or holds a dictionary by names of images. Raises ``InputError`` without any
    requested frame.
    """
    found, other = False, ""
    if len(paths) > 1:
        request.check_numbers(paths[0].parent, [path.stem for path in paths])
    alone: dict[str, int] = {}
    for path in paths:
        frame = frame_of(path.stem, request.frames)
        alone_or_unnumbered = len(paths) == 1 or number_of(path.stem) is None
        may_hold_many = path.suffix.lower() in MULTI_IMAGE_SUFFIXES and alone_or_unnumbered
        record = records.read_tracker_record(path) if frame is not None or may_hold_many else {}
        named = records.records_by_image(record)
        if not named and frame is not None:
            if "track_id" not in record:  # V2D has a folder for each track
                alone[str(path)] = frame
            found = True
            yield path, frame, record
        for (_, content), frame in zip(named.items(), frames_of_names(path, list(named), request), strict=True):
            if frame is not None:
                found = True
                yield path, frame, content
        other = other or next(iter(named), path.name)
    if not found:
        raise unmatched_names_error(paths, other, request)
    check_unique_images(paths[0].parent, list(alone), list(alone.values()), request.frames)


def frames_of_names(path: Path, names: Sequence[str], request: Request) -> list[int | None]:
    """Return the frame index of each image in a file, by its name; None for frames outside the clip.

    Raises ``InputError`` for two images of one frame, ``UsageError`` for images counted from another start.
    """
    request.check_numbers(path, [Path(name).stem for name in names])
    found = [frame_of(Path(name).stem, request.frames) for name in names]
    check_unique_images(path, names, found, request.frames)
    return found


def unmatched_names_error(paths: Sequence[Path], example: str, request: Request) -> InputError:
    """Make the error for files without a name of a frame."""
    named = " to ".join(printable(frame) for frame in (request.frames[0], request.frames[-1]))
    got = f"no name of a frame ({printable(example)}, ...) in {len(paths)} file{'s' if len(paths) > 1 else ''}"
    return InputError(paths[0], "", got, f"names like those of the clip's frames, {named}")


def frames_of_rows(path: Path, record: records.Record, count: int, request: Request) -> list[int | None]:
    """Return the frame index of each row of a file; None for frames outside the clip.

    The file's ``frames`` are their names; without, the rows are the clip's frames. Raises ``InputError``.
    """
    if "frames" in record:
        names = arrays.array_from_names(record["frames"])
        if names is None or len(names) != count:
            got = shorten_value(record["frames"])
            raise InputError(path, "frames", got, f"{count} names or numbers of frames")
        request.check_numbers(path, map(str, names))
        return [frame_of(str(name), request.frames) for name in names]
    option = request.ask_first or "--first"
    in_order = rows_in_order(count, request.frames, path, "hand", request.counted, option)
    rows = {row: n for n, row in in_order.items()}
    return [rows.get(row) for row in range(count)]


def frames_of_images(path: Path, record: records.Record, count: int, request: Request) -> list[int | None]:
    """Return the frame index of each row as ``frames_of_rows``; rows may also be all images of a video.

    Images are counted from 0, and the video's frames from 1 unless the user states the first number.
    """
    if "frames" in record or (count == len(request.frames) and not request.counted):
        return frames_of_rows(path, record, count, request)
    return [frame_of(str(n + 1 if request.ask_first else n), request.frames) for n in range(count)]


def only_file(paths: Sequence[Path], what: str) -> Path:
    """Return the only file. Raises ``UsageError`` for several files."""
    if len(paths) != 1:
        raise UsageError(f"FILE must be one, with the {what} of all frames (got {len(paths)} files)")
    return paths[0]
