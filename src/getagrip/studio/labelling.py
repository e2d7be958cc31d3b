"""Labelling of one grasp: changes of its key frames, drafts of the other frames, files of a clip, and its result."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from threading import Lock
from typing import Any
from uuid import uuid4

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip import __version__
from getagrip.checks.intrinsics import compute_intrinsics
from getagrip.errors import UsageError
from getagrip.geometry.lens import Lens
from getagrip.hands.from_2d.clicks import MIN_CLICKED_JOINTS
from getagrip.io import files
from getagrip.io.files import Json, shorten_value
from getagrip.readers.footage import Footage
from getagrip.studio import jobs
from getagrip.studio.detect_grasps import boxes_of_polygons
from getagrip.studio.hands.detect_hands import DETECTED_HANDS_FOLDER, DRAFTS_FOLDER, HandDetectionFiles
from getagrip.studio.jobs import BackgroundJob, BackgroundQueue, Work
from getagrip.studio.masks.filled_maps import FilledFrames, FilledMaps
from getagrip.studio.masks.propagate_clip import keyframe_spans
from getagrip.studio.masks.propagate_frame import Images
from getagrip.studio.next_step import discount_confidence, lost_frames, next_step, suggest_frame
from getagrip.studio.shown_result import ResultOutlines, describe_result, take_candidate
from getagrip.studio.store import grasp_settings, history
from getagrip.studio.store.export_clip import footage_checksum
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.labels import (
    KEYFRAME_SETTABLE_FIELDS,
    MIN_SHAPE_POINTS,
    KeyFrame,
    Labels,
    apply_keyframe_change,
    blank_keyframe,
    change_from_labels,
    labels_to_json,
    write_label_file,
)
from getagrip.studio.store.mark_store import Store
from getagrip.studio.store.marks import Grasp, MarkedGrasp
from getagrip.studio.store.shapes import mesh_error
from getagrip.studio.store.tasks import open_footage

Basis = dict[str, list[tuple[int, int, str]]]
"""Inputs of the drafts of "masks" and "hand": first and last frame, and a checksum of the inputs."""

OUTLINED_FRAMES = 16
"""Number of frames of which outlines are sent at once."""
FIRST_MASKS = 24
"""Number of frames whose masks a first result is made of, where twice as many are yet to be filled in."""


@dataclass(frozen=True)
class _Written:
    """The files of a clip."""

    of: str
    """Checksum of what they are made of."""
    command: str
    """Command that makes the clip."""
    confidence: dict[int, float]
    """Confidence of the mask of each frame."""


class Labelling:
    """The key frames of the grasps in a store."""

    def __init__(self, store: Store, lens: Lens, out: Path) -> None:
        """Write the files of grasps into ``out``; without a lens a grasp keeps its own, or it is assumed."""
        self.store, self.out = store, out
        self.depth: jobs.DepthFiles | None = None
        self.views: jobs.AddViews | None = None
        self.stated_lens = lens
        self._found: dict[Path, HandDetectionFiles] = {}
        self._iou: dict[Path, tuple[int, dict[str, float]]] = {}  # time of a result, its IOU by the frames' names
        self._verdicts: dict[Path, tuple[int, dict[str, Any]]] = {}  # time of a result, and what is said of it
        self._outlines: tuple[tuple[Path, int], ResultOutlines] | None = None  # of the result shown last, and its time
        self._reports: set[str] = set()  # checksums of report files written by this process
        self._reporting = Lock()
        self._filled = FilledMaps()
        self.background = BackgroundQueue()

    def found(self, grasp: MarkedGrasp) -> HandDetectionFiles:
        """Return the detected hands of a grasp's footage: in its draft's folder, else beside the marks."""
        own = self.out / DRAFTS_FOLDER / grasp.task.key / DETECTED_HANDS_FOLDER
        folder = own if own.is_dir() else self.out / DETECTED_HANDS_FOLDER
        if not folder.is_dir():  # it may be written later
            return HandDetectionFiles(folder)
        return self._found.setdefault(folder, HandDetectionFiles(folder))

    def lens(self, grasp: MarkedGrasp) -> Lens:
        """Return the camera of a grasp: as given, else that with which it was worked on last, else a guess."""
        known = self.stated_lens if self.stated_lens.is_set else self.store.settings.lens(grasp.mark.mark)
        return known or Lens(guess_focal=True)

    def shape(self, grasp: MarkedGrasp) -> jobs.RequestedMesh | None:
        """Return the object's mesh as it was stated for a grasp; None where it was not."""
        known = self.store.settings.of(grasp.mark.mark)
        return jobs.RequestedMesh(known["mesh"], known.get("size_mm")) if known.get("mesh") else None

    def progress(self, grasp: MarkedGrasp) -> str:
        """Return how far a grasp is: "not begun", "drawn", or the verdict on the result of its current labels."""
        record, own = jobs.result_folder(self.out, grasp.name) / "result.json", self._own(grasp)
        outcome = self.store.settings.of(grasp.mark.mark).get("outcome")
        whole = outcome is not None and not outcome.get("first") and outcome["of"]
        if whole and record.is_file() and whole == self._inputs(grasp, self._basis(grasp, own)):
            return str(self._describe(record)["verdict"])
        return "drawn" if own else "not begun"

    def state_shape(self, grasp: Grasp, shape: jobs.RequestedMesh) -> None:
        """Store the object's mesh for a grasp."""
        self.store.settings.put(grasp.mark.mark, asdict(shape))

    def set(self, grasp: Grasp, settings: object) -> None:
        """Store some settings of the page. Raises ``RefusedError``."""
        checked = grasp_settings.check_settings(settings, grasp_settings.PAGE_SETTINGS)
        self.store.settings.put(grasp.mark.mark, checked)

    def state(self, grasp: Grasp) -> dict[str, object]:
        """Return a grasp's key frames and settings, the inputs of drafts now, the suggested frame, and its result.

        The progress of its job is in it, too.
        """
        newest = self.store.keyframes.newest(grasp.mark.mark, grasp.mark.annotator)  # before the frames, as with marks
        own, key = self._own(grasp), grasp.mark.mark
        job, basis = self.background.job(key), self._basis(grasp, own)
        keys, number = ("frame", "joints", "outlines", "hidden"), grasp.footage.number
        keyframes = [{key: getattr(one, key) for key in keys} | {"number": number(one.frame)} for one in own]
        sure = self.store.drafts.confidence(grasp.mark.mark, {word for *_, word in basis["masks"]})
        drawn, known, inputs = self.labels(grasp).drawn, self.store.settings.of(key), self._inputs(grasp, basis)
        outcome = known.get("outcome")
        solved = outcome is not None and outcome["of"] == inputs
        met = discount_confidence(sure, self._iou_of_result(grasp), drawn) if solved else sure
        wanted = suggest_frame(met, drawn, *grasp.extent)
        return {
            "grasp": grasp.mark.mark,
            "newest": newest,
            "extent": grasp.extent,
            "side": grasp.side,
            "size": grasp.footage.size,
            "fewest": MIN_CLICKED_JOINTS,
            "keyframes": keyframes,
            "basis": basis,
            "wanted": wanted,
            "found": bool(self.found(grasp).joints),
            "drafts": self.store.drafts.newest(grasp.mark.mark),
            "job": None if job is None else job.status(),
            "settings": {name: value for name, value in known.items() if name in grasp_settings.PAGE_SETTINGS},
            "result": self._result(grasp, outcome, solved, wanted),
        }

    def change(self, grasp: Grasp, content: Json) -> None:
        """Make a change of a key frame. Raises ``RefusedError``."""
        frame, size = content.get("frame"), grasp.footage.size
        if type(frame) is not int or not 0 <= frame < grasp.footage.frames:
            raise RefusedError(f"frame must be 0 to {grasp.footage.frames - 1} (got {shorten_value(frame)})")
        change = history.read_change(content, KEYFRAME_SETTABLE_FIELDS)
        blank = blank_keyframe(grasp.mark.task, grasp.mark.annotator, grasp.mark.mark, frame)
        self.store.keyframes.apply(change, blank, lambda old, sets: apply_keyframe_change(old, sets, size))

    def undo(self, grasp: Grasp, tab: str, change: str) -> dict[str, object]:
        """Undo a tab's last change of a grasp's key frames, and return its frame. Raises ``RefusedError``."""
        undone = self.store.keyframes.undo(grasp.mark.mark, grasp.mark.annotator, tab, change)
        return {"undone": undone is not None, "frame": None if undone is None else undone.frame}

    def labels(self, grasp: Grasp) -> Labels:
        """Return the labels of a grasp, without the footage's checksum."""
        (first, last), footage = grasp.extent, grasp.footage
        frames = {one.frame: one.labels() for one in self._own(grasp) if first <= one.frame <= last}
        video = (grasp.task.path or Path(grasp.task.video)).name
        return Labels(video, footage.size, grasp.side, footage.fps, first, last, frames)

    def whole_labels(self, grasp: Grasp) -> Labels:
        """Return the labels of a grasp with the checksum of its footage, as in a label file."""
        return replace(self.labels(grasp), sha256=footage_checksum(grasp.path))

    def take(self, grasp: Grasp, labels: Labels) -> None:
        """Replace the labels of a grasp by those of a file. Raises ``RefusedError``."""
        (width, height), tab = grasp.footage.size, str(uuid4())
        if labels.size != (width, height):
            raise RefusedError(f"labels of {labels.size[0]} x {labels.size[1]} pixels, footage of {width} x {height}")

        def replaced(old: KeyFrame, sets: Json) -> KeyFrame:
            blank = blank_keyframe(old.task, old.annotator, old.grasp, old.frame)
            return apply_keyframe_change(blank, sets, labels.size)

        for n, frame in labels.frames.items():
            blank = blank_keyframe(grasp.mark.task, grasp.mark.annotator, grasp.mark.mark, n)
            change = history.Change(str(uuid4()), tab, change_from_labels(frame))
            self.store.keyframes.apply(change, blank, replaced)

    def propagate(self, grasp: Grasp) -> None:
        """Start to update drafts that are out of date. Raises ``RefusedError`` for insufficient labels."""
        self.store.settings.put_lens(grasp.mark.mark, self.lens(grasp))
        basis, value = self._basis(grasp, self._own(grasp)), self.labels(grasp)
        if not any(basis.values()):
            raise RefusedError("nothing to fill in yet: click joints, or draw a polygon around the object, on a frame")
        self._check_joints(grasp, value)
        self._start(grasp, "propagate", lambda job: self._draft(grasp, value, basis, job))

    def make(self, grasp: Grasp) -> None:
        """Start to write the input files of a clip. Raises ``RefusedError`` for insufficient labels."""
        value = self.labels(grasp)
        self._check_enough(grasp, value)
        self._start(grasp, "files", lambda job: self.write(grasp, value, job))

    def reconstruct(self, grasp: Grasp, content: Json) -> None:
        """Start to write the files, make a clip of them and reconstruct it. Raises ``RefusedError``."""
        shape = jobs.parse_requested_mesh(content)
        if error := mesh_error(shape):
            raise RefusedError(error)
        self.state_shape(grasp, shape)
        self._check_enough(grasp, self.labels(grasp))

        def work(job: BackgroundJob) -> str:
            value, basis = self.labels(grasp), self._basis(grasp, self._own(grasp))
            filled = FilledFrames(self._filled, grasp.mark.mark, _words_by_frame(basis["masks"]))
            if sum(n not in filled for n in range(value.first, value.last + 1)) > 2 * FIRST_MASKS:
                self._solve(grasp, shape, job, first=True)
                job.message = "a first result is there; filling in all frames"
                self._draft(grasp, value, basis, job)
            said = self._solve(grasp, shape, job)
            self._draw_report_later(grasp)
            return said

        self._start(grasp, "reconstruct", work)

    def solve(self, grasp: Grasp, shape: jobs.RequestedMesh, job: BackgroundJob) -> str:
        """Write the files, make a clip of them, reconstruct it and draw its report; return the outcome as text.

        Raises ``GetagripError``, ``CancelledError``.
        """
        said = self._solve(grasp, shape, job)
        job.message = "drawing the report"
        self.draw_report(grasp, job)
        return said

    def _solve(self, grasp: Grasp, shape: jobs.RequestedMesh, job: BackgroundJob, first: bool = False) -> str:
        """Do the same without the report; for a ``first`` result with masks of ``FIRST_MASKS`` frames."""
        from getagrip.studio.store.export_clip import new_clip_call

        value = self.labels(grasp)
        self._check_enough(grasp, value)
        job.message = f"masks of {FIRST_MASKS} frames for a first result" if first else "writing the files"
        jobs.return_freed_memory()  # of what was filled in: each step has its own peak
        made = self._make(grasp, value, job, first)
        jobs.return_freed_memory()
        confidence = made.confidence
        new_clip = new_clip_call(value, self.out / grasp.name, str(grasp.path), self._segments(grasp))
        said = jobs.reconstruct_grasp_files(new_clip, shape, self.out, grasp.name, job, self.depth, self.views)
        result, number = jobs.result_folder(self.out, grasp.name), grasp.footage.number
        met = discount_confidence(confidence, self._iou_of_result(grasp), value.drawn)
        wanted = suggest_frame(met, value.drawn, *grasp.extent)
        boxes = boxes_of_polygons({n: one.object or () for n, one in value.frames.items()})
        step = next_step(
            result, grasp.path, self.out, shape,
            None if wanted is None else number(wanted), [*map(number, lost_frames(confidence))],
            (number(value.first), number(value.last)), boxes.get(value.first),
        )  # fmt: skip
        text = "\n".join(filter(None, (said, step)))
        outcome = {"of": made.of, **asdict(shape), "said": text, "first": first}
        self.store.settings.put(grasp.mark.mark, {"outcome": outcome})
        return text

    def is_solved(self, grasp: Grasp, shape: jobs.RequestedMesh) -> bool:
        """Return whether a grasp has a result of its current labels with a mesh."""
        written = self.out / f"labels-{grasp.name}.json"
        result = jobs.result_folder(self.out, grasp.name) / "result.json"
        outcome = self.store.settings.of(grasp.mark.mark).get("outcome")
        if outcome is not None:
            now = {"of": self._inputs(grasp, self._basis(grasp, self._own(grasp))), **asdict(shape)}
            return result.is_file() and now.items() <= outcome.items() and not outcome.get("first")
        if not (written.is_file() and result.is_file()) or result.stat().st_mtime < written.stat().st_mtime:
            return False
        now = json.loads(json.dumps(labels_to_json(self.whole_labels(grasp))))
        return bool(files.read_any_json(written) == now)

    def result_file(self, grasp: Grasp, name: str) -> bytes:
        """Return a file of the report of a grasp's result.

        Files that this process has not written may be hostile, and are replaced. Raises ``RefusedError`` without a
        result, ``GetagripError`` for a malformed one, or a link in its place.
        """
        result = jobs.result_folder(self.out, grasp.name)
        if not (result / "result.json").is_file():
            raise RefusedError("there is no result of this grasp yet")
        files.folder_inside(self.out, jobs.RESULTS_FOLDER, grasp.name)
        with self._reporting:
            found = jobs.report_files(result)
            if name not in found or _report_checksum(found[name]) not in self._reports:
                self._draw(result, BackgroundJob("report"))
                found = jobs.report_files(result)
        return found[name]

    def draw_report(self, grasp: Grasp, job: BackgroundJob) -> None:
        """Write the report of a grasp's result. Raises ``GetagripError``, ``CancelledError``."""
        with self._reporting:
            self._draw(jobs.result_folder(self.out, grasp.name), job)

    def _draw(self, result: Path, job: BackgroundJob) -> None:
        jobs.draw_report(result, job)
        self._reports |= {*map(_report_checksum, jobs.report_files(result).values())}

    def _draw_report_later(self, grasp: Grasp) -> None:
        """Write a report once nothing else is to be done; other work on the grasp cancels it."""

        def work(job: BackgroundJob) -> str:
            self.draw_report(grasp, job)
            return ""

        self.background.start(f"report {grasp.mark.mark}", "report", work)

    def write(self, grasp: Grasp, value: Labels, job: BackgroundJob) -> str:
        """Write ``labels-<name>.json``, and ``<name>/`` with hand and masks; return the command that makes a clip.

        A whole interaction also gets ``segments-<name>.json``. Raises ``RefusedError`` where segments overlap.
        """
        return self._make(grasp, value, job).command

    def _make(self, grasp: Grasp, value: Labels, job: BackgroundJob, first: bool = False) -> _Written:
        from getagrip.studio.store.export_clip import clip_command, write_labelled_clip_files

        self.out.mkdir(parents=True, exist_ok=True)
        lens, settings, out = self.lens(grasp), self.store.settings, self.out / grasp.name
        settings.put_lens(grasp.mark.mark, lens)
        basis = self._basis(grasp, self._own(grasp))
        of, words = self._inputs(grasp, basis), _words_by_frame(basis["masks"])
        of_code = _basis_checksum(of, __version__)
        if (path := self._segments(grasp)) is not None and grasp.whole is not None:
            files.write_json(path, {grasp.task.key: grasp.whole.listed().fields})
        whole = replace(value, sha256=footage_checksum(grasp.path))
        write_label_file(whole, self.out / f"labels-{grasp.name}.json")
        frames = FIRST_MASKS if first else value.last - value.first + 1
        command = clip_command(replace(value, video=str(grasp.path)), out, self._segments(grasp))
        known = settings.of(grasp.mark.mark).get("written")
        if known is not None and known["of"] == of_code:
            confidence = {int(n): float(sure) for n, sure in known["confidence"].items()}
            if _has_clip_files(out, sum(sure > 0.0 for sure in confidence.values())):
                return _Written(of, command, confidence)
        with closing(open_footage(grasp.path)) as footage:
            made = write_labelled_clip_files(
                value, _cancellable(footage, job), lens, out, overwrite=True,
                done=lambda masks: job.report(masks, frames),
                found=self.found(grasp), name=footage.name, filled=FilledFrames(self._filled, grasp.mark.mark, words),
                sparse=FIRST_MASKS if first else None,
            )  # fmt: skip
        sure = {str(n): float(x) for n, x in made.confidence.items()}
        settings.put(grasp.mark.mark, {"written": {"of": "" if first else of_code, "confidence": sure}})
        return _Written(of, command, made.confidence)

    def _inputs(self, grasp: MarkedGrasp, basis: Basis) -> str:
        """Return a checksum of all that the files of a clip are made of."""
        whole = grasp.whole
        segments = [] if whole is None else [(one.start, one.end, one.side, one.state) for _, one in whole.finished]
        about = grasp.extent, grasp.side, segments, whole is not None and whole.still
        return _basis_checksum(basis, asdict(self.lens(grasp)), *about)

    def _iou_of_result(self, grasp: Grasp) -> dict[int, float]:
        """Return the IOU of a grasp's result with the masks, by frame."""
        result = jobs.result_folder(self.out, grasp.name)
        record = result / "result.json"
        if not record.is_file():
            return {}
        if (known := self._iou.get(result)) is None or known[0] != record.stat().st_mtime_ns:
            known = self._iou[result] = record.stat().st_mtime_ns, jobs.iou_by_frame(result)
        names = _frame_names(grasp)
        return {names[name]: x for name, x in known[1].items() if name in names}

    def _result(self, grasp: Grasp, outcome: Json | None, solved: bool, wanted: int | None) -> dict[str, object] | None:
        """Return what is known of a grasp's result, and whether it is of the ``current`` labels; None without one.

        The steps that it asks for have frames as the page counts them, and their numbers.
        """
        record = jobs.result_folder(self.out, grasp.name) / "result.json"
        if not record.is_file():
            return None
        names, number = _frame_names(grasp), grasp.footage.number

        def here(steps: list[Json]) -> list[Json]:
            out = []
            for step in steps:
                frames = [names[name] for name in step.get("frames", ()) if name in names]
                if step["do"] == "draw" and wanted is not None:
                    frames = [wanted]
                out.append(step | {"frames": frames, "numbers": [*map(number, frames)]})
            return [step for step in out if step["frames"] or step["do"] not in ("draw", "cut")]

        about = self._describe(record)
        found = [one | {"steps": here(one["steps"])} for one in about["findings"]]
        said = "" if outcome is None else outcome["said"]
        first = outcome is not None and outcome.get("first", False)
        shown = {"current": solved, "first": first, "said": said, **about}
        return shown | {"findings": found, "steps": here(about["steps"])}

    def outlines(self, grasp: Grasp, rank: int, first: int) -> dict[str, object]:
        """Return the outlines of a grasp's result, or a candidate of it, in some frames from ``first`` on.

        ``made`` is the time of the result [us]. Raises ``RefusedError`` without a result, ``GetagripError`` for one
        that does not read, or an unknown candidate.
        """
        result = jobs.result_folder(self.out, grasp.name)
        if not (result / "result.json").is_file():
            raise RefusedError("there is no result of this grasp yet")
        files.folder_inside(self.out, jobs.RESULTS_FOLDER, grasp.name)
        made = (result / "result.json").stat().st_mtime_ns // 1000
        if self._outlines is None or self._outlines[0] != (result, made):
            self._outlines = (result, made), ResultOutlines(result)
        known, names = self._outlines[1], {n: name for name, n in _frame_names(grasp).items()}
        some = [n for n in range(first, first + OUTLINED_FRAMES) if names.get(n) in known.rows]
        frames = {n: known.of(names[n], rank, grasp.footage.size[0]) for n in some}
        return {"made": made, "candidate": rank, "frames": frames}

    def take_candidate(self, grasp: Grasp, content: Json) -> None:
        """Start to make a candidate of a grasp's result the result. Raises ``RefusedError``."""
        rank, outcome = content.get("candidate"), self.store.settings.of(grasp.mark.mark).get("outcome")
        if type(rank) is not int or outcome is None:
            raise RefusedError(f"candidate must be one of the result's (got {shorten_value(rank)})")

        def take(job: BackgroundJob) -> str:
            job.message = f"taking candidate {rank + 1}"
            folder = files.folder_inside(self.out, jobs.RESULTS_FOLDER) / grasp.name
            take_candidate(folder, rank)
            self._draw_report_later(grasp)
            text = f"Candidate {rank + 1} is the result now; what was the result before is candidate {rank + 1}."
            self.store.settings.put(grasp.mark.mark, {"outcome": outcome | {"said": text}})
            return text

        self._start(grasp, "candidate", take)

    def _describe(self, record: Path) -> dict[str, Any]:
        """Return when a result was ``made`` [us], and what is said of it; read again only where it changed."""
        made = record.stat().st_mtime_ns // 1000
        if (known := self._verdicts.get(record)) is None or known[0] != made:
            known = self._verdicts[record] = made, describe_result(record.parent)
        return {"made": made, **known[1]}

    def _segments(self, grasp: Grasp) -> Path | None:
        """Return the segment file of a whole interaction; None for a single grasp."""
        return None if grasp.whole is None else self.out / f"segments-{grasp.name}.json"

    def close(self) -> None:
        """Cancel all work."""
        self.background.close()

    def _start(self, grasp: Grasp, what: str, work: Work) -> None:
        """Start a job; its errors name frames by the footage's own numbers, as the page does."""

        def numbered(found: re.Match[str]) -> str:
            n = int(found[1])
            return f"frame {grasp.footage.number(n) if n < grasp.footage.frames else n}"

        def renumbered(job: BackgroundJob) -> str:
            try:
                return work(job)
            except UsageError as error:
                raise UsageError(re.sub(r"frame ([0-9]{1,9})", numbered, str(error))) from error

        self.background.cancel(f"report {grasp.mark.mark}")
        self.background.start(grasp.mark.mark, what, renumbered)

    def _own(self, grasp: MarkedGrasp) -> list[KeyFrame]:
        return self.store.keyframes.standing(grasp.mark.mark, grasp.mark.annotator)

    def _basis(self, grasp: MarkedGrasp, own: Sequence[KeyFrame]) -> Basis:
        """Return the current inputs of drafts of each kind; empty without labels."""
        first, last = grasp.extent
        frames = [(one, one.labels()) for one in own if first <= one.frame <= last]
        masks = {  # motion at a click depends on the interval
            one.frame: [
                *([shape.tolist() for shape in getattr(labelled, kind) or ()] for kind in MIN_SHAPE_POINTS),
                None if labelled.object is not None else [first, last],
            ]
            for one, labelled in frames
            if labelled.object is not None or labelled.on
        }
        hand = {one.frame: one.joints for one, labelled in frames if labelled.joints is not None}
        spans, found = keyframe_spans(masks, first, last) if masks else (), self.found(grasp)
        hands = (
            [(first, last, _basis_checksum(first, last, hand, grasp.side, asdict(self.lens(grasp))))] if hand else []
        )
        if not hand and found.joints:
            hands = [(first, last, found.word)]
        drawn = [(one.first, one.last, _basis_checksum({n: masks[n] for n in one.keys}, found.word)) for one in spans]
        return {"masks": drawn, "hand": hands}

    def _check_enough(self, grasp: Grasp, value: Labels) -> None:
        """Raise ``RefusedError`` if the labels do not suffice for a clip."""
        self._check_joints(grasp, value)
        if not (value.clicks or self.found(grasp).path.is_file()) or not value.label_maps():
            raise RefusedError("a clip needs a hand, found or clicked on one frame, and the object drawn on one")

    def _check_joints(self, grasp: Grasp, labels: Labels) -> None:
        """Raise ``RefusedError`` for a frame with too few joints."""
        for n, joints in labels.clicks.items():
            count = int(np.isfinite(joints).all(axis=1).sum())
            if count < MIN_CLICKED_JOINTS:
                what = f"frame {grasp.footage.number(n)} has {count} joints"
                raise RefusedError(f"{what}: click {MIN_CLICKED_JOINTS} at least, or delete them")

    def _draft(self, grasp: Grasp, labels: Labels, basis: Basis, job: BackgroundJob) -> str:
        """Update the drafts whose inputs have changed."""
        from getagrip.studio.masks import polygon_drafts

        drafts, key, frames = self.store.drafts, grasp.mark.mark, labels.last - labels.first + 1
        words = {kind: _words_by_frame(rows) for kind, rows in basis.items()}
        made = {kind: drafts.bases(key, kind) for kind in basis}
        known = {kind: {n for n, word in rows.items() if made[kind].get(n) == word} for kind, rows in words.items()}
        wrong: UsageError | None = None
        with closing(open_footage(grasp.path)) as footage:
            image = _cancellable(footage, job)
            if len(known["hand"]) < len(words["hand"]):
                K, _ = compute_intrinsics(self.lens(grasp), labels.size)
                try:
                    if labels.clicks:
                        hands = polygon_drafts.draft_fitted_hand(labels, K, image)
                    else:
                        hands = polygon_drafts.draft_detected_hand(labels, self.found(grasp))
                    drafts.put(key, "hand", words["hand"][labels.first], hands)
                except UsageError as error:  # masks are drafted nevertheless
                    wrong = error
            if len(known["masks"]) < len(words["masks"]):
                seen = self.found(grasp).mask
                keep = lambda made: self._filled.put(key, words["masks"][made.frame], made)  # noqa: E731
                for n, content in polygon_drafts.draft_masks(labels, image, known["masks"], seen, keep):
                    drafts.put(key, "masks", words["masks"][n], {n: content | {"number": footage.number(n)}})
                    job.report(n - labels.first + 1, frames)
        if wrong is not None:
            raise wrong
        return ""


def _cancellable(footage: Footage, job: BackgroundJob) -> Images:
    """Return a function that reads frames until the job is cancelled: filling in reads many before one is done."""

    def image(n: int) -> UInt8[ndarray, "H W 3"]:
        job.report(job.done, job.total)
        return footage.image(n)

    return image


def _words_by_frame(rows: Sequence[tuple[int, int, str]]) -> dict[int, str]:
    """Return the checksums of rows of ``Basis``, by frame."""
    return {n: word for first, last, word in rows for n in range(first, last + 1)}


def _frame_names(grasp: Grasp) -> dict[str, int]:
    """Return the frames of a grasp by their names."""
    return {grasp.footage.name(n): n for n in range(grasp.extent[0], grasp.extent[1] + 1)}


def _has_clip_files(folder: Path, masks: int) -> bool:
    """Return whether a folder has a hand file and a number of masks."""
    return (folder / "hand.npz").is_file() and len([*(folder / "masks").glob("*.png")]) == masks


def _report_checksum(content: bytes) -> str:
    return sha256(content).hexdigest()


def _basis_checksum(*content: object) -> str:
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
