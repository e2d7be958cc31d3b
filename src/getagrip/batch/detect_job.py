"""Detect the segments of one uncut clip and write them as clips; valid earlier ones are kept.

A record of the clips and their inputs is written last, beside the clips: without it, they count as unfinished.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from getagrip.batch.freshness import RESULT_INPUT_LABELS, damaged_reason, describe_difference
from getagrip.batch.job import Outcome, Progress, failed_outcome
from getagrip.batch.ledger import LedgerEntry
from getagrip.clip import input_sha256, read_clip, read_masks
from getagrip.errors import InputError
from getagrip.fitting.options import Options
from getagrip.io import files, plugins

DETECTION_INPUT_LABELS = {key: RESULT_INPUT_LABELS[key] for key in ("input_sha256", "options", "code")}
"""Names of a record's inputs in messages, by key."""


@dataclass(frozen=True)
class DetectionJob:
    """A clip whose segments are to be detected."""

    name: str
    clip: Path
    to: Path
    """Folder for the new clips."""
    options: Options
    alone: bool
    """True: each grasp becomes a clip; False: the clip becomes a timeline."""

    @property
    def record(self) -> Path:
        """File that lists the new clips and their inputs."""
        return self.to / f"{self.name}.{'grasps' if self.alone else 'timeline'}.json"

    def made_from(self, checksum: str) -> dict[str, object]:
        """Return everything that the segments depend on; ``checksum`` is the clip's."""
        from getagrip.timelines.detect.grasp_evidence import HINGE_FIT_METHOD

        # detection sets these two itself, whatever the user chose
        options = asdict(replace(self.options, method=HINGE_FIT_METHOD, every_frame=True))
        return {"input_sha256": checksum, "options": options, "code": plugins.fingerprint("timelines/detect")}


@dataclass(frozen=True)
class DetectedClip:
    """The segments of a clip, written as clips."""

    clip: str
    state: Literal["done", "kept"]
    folders: tuple[Path, ...]
    spans: tuple[str, ...]
    """Names of the first and last frame of each stable grasp, for messages."""
    notes: tuple[str, ...]
    inputs: str
    """Checksum of the clip."""
    why: str = ""
    """Reason why an earlier detection was invalid."""

    def __str__(self) -> str:
        found = f"stable grasps in {', '.join(self.spans)}" if self.spans else "no stable grasp"
        how = ["found before"] * (self.state == "kept") + [f"found again, since {self.why}"] * bool(self.why)
        return f"{self.clip}: {'; '.join([found, *self.notes, *how])}"


def detect_clip_segments(job: DetectionJob, progress: Progress = lambda *_: None) -> DetectedClip | Outcome:
    """Detect the segments of one clip and write them; errors become a failed ``Outcome``. Raises nothing."""
    try:
        checksum = input_sha256(job.clip)
        existing, why = _existing_detection(job, checksum)
        return _detect_and_write(job, checksum, why, progress) if existing is None else existing
    except Exception as error:  # an error in one clip must not end the others
        return failed_outcome(job.name, error)


def detection_entry(found: DetectedClip | Outcome) -> LedgerEntry:
    """Make the ledger's entry of a clip."""
    if isinstance(found, Outcome):
        return LedgerEntry(found.name, "failed", found.message)
    about = {"clips": [folder.name for folder in found.folders]}
    return LedgerEntry(found.clip, found.state, "; ".join(found.notes), inputs=found.inputs, about=about)


def _detect_and_write(job: DetectionJob, checksum: str, why: str, progress: Progress) -> DetectedClip:
    """Raise ``InputError`` where the clip is invalid or changes meanwhile."""
    from getagrip.timelines.detect.detect_segments import find_segments, write_grasps, write_timeline

    clip = read_clip(job.clip)
    masks = read_masks(clip)
    found = find_segments(clip, masks, options=job.options, progress=lambda part: progress("grasps", part))
    if input_sha256(job.clip) != checksum:
        raise InputError(job.clip, "", "files that changed while they were read", "a clip that stays as it is")
    folders = tuple((write_grasps if job.alone else write_timeline)(clip, masks, found, job.to))
    spans = tuple(f"frames {clip.frames[first]} to {clip.frames[last]}" for first, last in found.grasps)
    clips = {folder.name: input_sha256(folder) for folder in folders}
    with files.new_file(job.record) as part:
        files.write_json(part, {**job.made_from(checksum), "clips": clips, "spans": spans, "notes": found.notes})
    return DetectedClip(job.name, "done", folders, spans, found.notes, checksum, why)


def _existing_detection(job: DetectionJob, checksum: str) -> tuple[DetectedClip | None, str]:
    """Return an earlier detection if it is valid, else None and the reason (empty without an earlier one).

    Valid means the same clip, options and code, and unchanged files.
    """
    if not job.record.exists():
        return None, ""
    try:
        record = files.read_json(job.record)
        if why := describe_difference(record, job.made_from(checksum), DETECTION_INPUT_LABELS):
            return None, why
        clips, spans, notes = (record.get(key) for key in ("clips", "spans", "notes"))
        if not (isinstance(clips, dict) and isinstance(spans, list) and isinstance(notes, list)):
            return None, damaged_reason(job.record)
        folders = tuple(job.to / name for name in clips if files.is_portable_name(name))
        if {folder.name: input_sha256(folder) for folder in folders} != clips:
            return None, "the earlier result has been changed"
    except InputError as error:
        return None, damaged_reason(error)
    return DetectedClip(job.name, "kept", folders, tuple(map(str, spans)), tuple(map(str, notes)), checksum), ""
