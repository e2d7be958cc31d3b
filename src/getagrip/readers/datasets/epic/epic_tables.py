"""EPIC-KITCHENS' tables, stable grasps (EPIC-Grasps) and actions (EPIC-100), and candidates of stable grasps from both.

Frame numbers are those of EPIC-KITCHENS' images, from 1. Whatever the rate of a video, images were extracted at 60
frames per second from videos with two-digit numbers (``P01_01``: EPIC-KITCHENS-55), and at 50 from videos with three
digits (``P01_101``: the extension of EPIC-100).

Candidates are the first step of EPIC-Grasps' annotation: VISOR's contacts of a hand with an object of a category, and
their extent by EPIC-100's actions. The extent begins with the third-last action that begins by the first contact, and
ends with the third action that ends from the last contact on. This rule reproduces nearly all of EPIC-Grasps' bounds.
"""

from __future__ import annotations

import csv
import io
import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from getagrip.errors import InputError, UsageError
from getagrip.hands.model import Side
from getagrip.io.files import printable, read_bytes, shorten_value
from getagrip.readers.datasets.epic.visor import SIDE_BY_HAND_NAME, FrameMapping, VisorFrame

EPIC_CATEGORIES = ("bottle", "bowl", "can", "cup", "glass", "mug", "pan", "plate", "saucepan")
"""Object categories of EPIC-Grasps."""
MAX_EPIC_TABLE_BYTES = 64 * 2**20
"""Maximum size of a table."""
MAX_FRAME_NUMBER = 10_000_000
"""Maximum frame number: two days at 50 frames per second."""
EPIC_VIDEO_PATTERN = re.compile(r"(P\d{2})_(\d{2,3})")
"""Names of videos: a person (and kitchen), then the recording."""


@dataclass(frozen=True)
class EpicGrasp:
    """A stable grasp of EPIC-Grasps. Frames are EPIC's numbers, first and last included."""

    example: int
    """Number of the grasp, 0 to 2430; five numbers are missing."""
    video: str
    side: Side
    category: str
    entity: str
    """VISOR's name of the object, as "olive oil bottle"."""
    start: int
    end: int
    start_bound: int
    end_bound: int
    """Last frame of the rough extent shown to the annotators."""
    contact: int | None
    """A frame of contact between hand and object, by VISOR."""
    note: str = ""
    """Corrections, in words."""
    masks: int | None = None
    """Number of masks of hand and object in the grasp's frames (``n_unfiltered_masks``), if stated."""
    film: str = ""
    """Name in lists of timelines (``mp4_name`` without suffix), if stated."""

    @property
    def name(self) -> str:
        """Name of the grasp's clip."""
        return f"{self.video}_{self.side}_{self.category}_{self.start}_{self.end}"

    @property
    def frames(self) -> int:
        """Number of the video's frames in the grasp."""
        return self.end - self.start + 1


@dataclass(frozen=True)
class Action:
    """A labelled action of EPIC-100."""

    video: str
    start: int
    stop: int
    narration: str
    noun: str


def numbering_rate(video: str) -> float:
    """Return the number of EPIC's frames per second of a video: 50 or 60, whatever the rate of the file."""
    return 50.0 if len(video.partition("_")[2]) == 3 else 60.0


def subject_of(video: str) -> str:
    """Return the person who recorded a video."""
    return video.partition("_")[0]


def errata_beside(path: Path) -> Path | None:
    """Return the published errata beside EPIC-Grasps' table; None if missing."""
    errata = path.with_name(f"{path.stem}_errata.csv")
    return errata if errata.is_file() else None


def chosen_errata(path: Path, wanted: bool, file: Path | None) -> Path | None:
    """Return the errata for a table: the user's file, or the file beside the table; None without errata.

    Raises ``UsageError`` for a user's file if errata are not ``wanted``.
    """
    if file is not None and not wanted:
        raise UsageError("--errata-file cannot be used with --no-errata")
    return (file or errata_beside(path)) if wanted else None


def read_grasps(path: Path, errata: Path | None = None) -> list[EpicGrasp]:
    """Read the stable grasps of EPIC-Grasps' CSV, corrected by errata.

    If ``st`` and ``ed`` of a row disagree with its ``duration`` (in one row), the frames in its ``fmt`` are used, which
    must agree with it. Raises ``InputError`` with the line and the column.
    """
    rows = _read_epic_table(path, ("vid", "st", "ed", "st_bound", "ed_bound", "contact", "handside", "cat", "hos_name",
                         "duration", "example", "fmt"), optional=("n_unfiltered_masks", "mp4_name"))  # fmt: skip
    grasps = {row.text("fmt"): _parse_epic_grasp(row, row.text("handside"), "handside") for row in rows}
    if len(grasps) < len(rows):
        raise InputError(path, "fmt", "the same grasp twice", "each once")
    if errata is not None:
        for row in _read_epic_table(errata, ("ACTION", "old_fmt", "correct_handside")):
            old = grasps.pop(row.text("old_fmt"), None)
            if old is None:
                raise InputError(errata, row.key("old_fmt"), shorten_value(row.text("old_fmt")), f"fmt in {path.name}")
            if row.text("ACTION") == "REMAKE":
                side = _parse_epic_side(row, row.text("correct_handside"), "correct_handside")
                grasps[row.text("old_fmt")] = replace(old, side=side, note=f"errata: the {side} hand, not {old.side}")
            elif row.text("ACTION") != "DELETE":
                raise InputError(errata, row.key("ACTION"), shorten_value(row.text("ACTION")), "REMAKE or DELETE")
    return sorted(grasps.values(), key=lambda grasp: grasp.example)


def _parse_epic_grasp(row: _TableRow, side: str, column: str) -> EpicGrasp:
    start, end, duration = row.frame("st"), row.frame("ed"), row.whole("duration", 1, MAX_FRAME_NUMBER)
    note = ""
    if end - start + 1 != duration:
        named = re.search(r"_(\d{1,8})_(\d{1,8})$", row.text("fmt"))
        first, last = (int(named[1]), int(named[2])) if named else (start, end)
        if last - first + 1 != duration:
            raise row.wrong("duration", f"{end - start + 1}, from st {start} to ed {end}")
        note = f"st and ed say {start} to {end}, duration and fmt {first} to {last}: the latter"
        start, end = first, last
    if end < start:
        raise row.wrong("ed", f"at least st, {start}")
    category = row.text("cat")
    if category not in EPIC_CATEGORIES:
        raise row.wrong("cat", f"one of {', '.join(EPIC_CATEGORIES)}")
    contact = row.whole("contact", -1, MAX_FRAME_NUMBER)
    return EpicGrasp(
        example=row.whole("example", 0, MAX_FRAME_NUMBER),
        video=row.video("vid"),
        side=_parse_epic_side(row, side, column),
        category=category,
        entity=row.text("hos_name"),
        start=start,
        end=end,
        start_bound=row.frame("st_bound"),
        end_bound=row.frame("ed_bound"),
        contact=None if contact < 0 else contact,
        note=note,
        masks=row.whole("n_unfiltered_masks", 0, MAX_FRAME_NUMBER) if row.cells["n_unfiltered_masks"].strip() else None,
        film=row.cells["mp4_name"].strip().removesuffix(".mp4"),
    )


def _parse_epic_side(row: _TableRow, value: str, column: str) -> Side:
    if value not in SIDE_BY_HAND_NAME:
        raise row.wrong(column, " or ".join(SIDE_BY_HAND_NAME))
    return SIDE_BY_HAND_NAME[value]


def read_actions(paths: Sequence[Path]) -> dict[str, list[Action]]:
    """Read the actions of EPIC-100's CSVs by video, in order of start.

    The files are ``EPIC_100_train.csv`` and ``EPIC_100_validation.csv``. Raises ``InputError`` with the line and the
    column.
    """
    actions: dict[str, list[Action]] = {}
    for path in paths:
        for row in _read_epic_table(path, ("video_id", "start_frame", "stop_frame", "narration", "noun")):
            start, stop = row.whole("start_frame", 0, MAX_FRAME_NUMBER), row.frame("stop_frame")
            if stop < start:
                raise row.wrong("stop_frame", f"at least start_frame, {start}")
            action = Action(row.video("video_id"), start, stop, row.text("narration"), row.text("noun"))
            actions.setdefault(action.video, []).append(action)
    return {video: sorted(found, key=lambda action: action.start) for video, found in actions.items()}


@dataclass(frozen=True)
class _TableRow:
    """A line of a table."""

    path: Path
    line: int
    cells: dict[str, str]

    def key(self, column: str) -> str:
        return f"line {self.line}, {column}"

    def wrong(self, column: str, expected: str) -> InputError:
        return InputError(self.path, self.key(column), shorten_value(self.cells[column]), expected)

    def text(self, column: str) -> str:
        text = self.cells[column].strip()
        if not text or not text.isprintable() or len(text) > 2000:
            raise self.wrong(column, "a text")
        return text

    def whole(self, column: str, least: int, most: int) -> int:
        text = self.cells[column].strip()
        if not re.fullmatch(r"-?[0-9]{1,9}", text) or not least <= int(text) <= most:
            raise self.wrong(column, f"a whole number from {least} to {most}")
        return int(text)

    def frame(self, column: str) -> int:
        return self.whole(column, 1, MAX_FRAME_NUMBER)

    def video(self, column: str) -> str:
        if not EPIC_VIDEO_PATTERN.fullmatch(self.cells[column]):
            raise self.wrong(column, "a video of EPIC-KITCHENS, as P01_01")
        return self.cells[column]


def _read_epic_table(path: Path, columns: Sequence[str], optional: Sequence[str] = ()) -> list[_TableRow]:
    """Read some columns of a CSV; missing ``optional`` columns are empty."""
    try:
        text = read_bytes(path, MAX_EPIC_TABLE_BYTES).decode("utf-8-sig")
        lines = csv.reader(io.StringIO(text, newline=""), strict=True)
        heads = next(lines, [])
        missing = [column for column in columns if heads.count(column) != 1]
        if missing:
            raise InputError(path, printable(missing[0]), f"{heads.count(missing[0])} columns of this name", "one")
        where = {column: heads.index(column) for column in (*columns, *optional) if column in heads}
        empty = dict.fromkeys(optional, "")
        rows = []
        for cells in lines:
            if not cells:
                continue
            if len(cells) != len(heads):
                raise InputError(path, f"line {lines.line_num}", f"{len(cells)} cells", f"{len(heads)}, as in line 1")
            rows.append(_TableRow(path, lines.line_num, empty | {column: cells[n] for column, n in where.items()}))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, "", f"invalid CSV ({error})", "a CSV file in UTF-8") from error
    if not rows:
        raise InputError(path, "", "no rows", "one at least")
    return rows


N_EXTENT_ACTIONS = 3
"""Number of actions on either side of a contact in the extent."""


@dataclass(frozen=True)
class Contact:
    """An annotated contact of a hand with an object of a category, in one frame."""

    frame: int
    """EPIC's frame number."""
    side: Side
    category: str
    entity: str
    """VISOR's name of the object."""


@dataclass(frozen=True)
class Candidate:
    """Contacts of a hand with one object in consecutive annotated frames, and their rough extent."""

    video: str
    side: Side
    category: str
    entity: str
    contacts: tuple[int, ...]
    """EPIC's frame numbers, rising."""
    start_bound: int
    end_bound: int
    narrations: tuple[str, ...]
    """Actions within the extent that name the category."""

    @property
    def seconds(self) -> float:
        """Duration of the extent [s]."""
        return (self.end_bound - self.start_bound + 1) / numbering_rate(self.video)

    @property
    def name(self) -> str:
        """Name in EPIC-Grasps' form: extent, first and last contact, hand, category."""
        frames = (self.start_bound, *dict.fromkeys((self.contacts[0], self.contacts[-1])), self.end_bound)
        return "_".join(map(str, (self.video, *frames, self.side, self.category)))


def category_of(entity: str) -> str | None:
    """Return the category at the end of an object's name ("olive oil bottle": bottle); None for other objects."""
    last = re.split(r"[^a-z]+", entity.lower().strip())[-1]
    return last if last in EPIC_CATEGORIES else None


def contacts(frames: Iterable[VisorFrame], mapping: FrameMapping) -> list[list[Contact]]:
    """Return the contacts in every frame with annotated hands, in order of time. A glove's contact is its hand's."""
    out: dict[int, list[Contact]] = {}
    for frame in frames:
        by_id = {a.id: a for a in frame.annotations}
        hands = [a for a in frame.annotations if a.hands]
        if not hands:
            continue
        found = out.setdefault(mapping.number(frame), [])
        for hand in hands:
            touched = by_id.get(hand.touches) if hand.touches else None
            category = None if touched is None or touched.hands else category_of(touched.name)
            if touched is not None and category is not None:
                found += [Contact(mapping.number(frame), side, category, touched.name) for side in hand.hands]
    return [out[number] for number in sorted(out)]


def find_candidates(video: str, touching: Sequence[Sequence[Contact]], actions: Sequence[Action]) -> list[Candidate]:
    """Find the candidates of a video, in order of time, from ``contacts`` and its actions in order of start.

    Contacts without an action before and after are skipped, since they have no extent.
    """
    runs: list[list[Contact]] = []
    open_runs: dict[tuple[Side, str], list[Contact]] = {}
    for now in touching:
        going_on: dict[tuple[Side, str], list[Contact]] = {}
        for contact in now:
            key = contact.side, contact.entity
            if key in going_on:  # the contact of both hand and glove
                continue
            going_on[key] = open_runs.get(key, [])
            if not going_on[key]:
                runs.append(going_on[key])
            going_on[key].append(contact)
        open_runs = going_on
    starts, stops = sorted(a.start for a in actions), sorted(a.stop for a in actions)
    found = []
    for run in runs:
        first, last = run[0], run[-1]
        before, after = bisect_right(starts, first.frame), bisect_left(stops, last.frame)
        if before == 0 or after == len(stops):
            continue
        bounds = starts[max(before - N_EXTENT_ACTIONS, 0)], stops[min(after + N_EXTENT_ACTIONS, len(stops)) - 1]
        within = [a for a in actions if a.start <= bounds[1] and a.stop >= bounds[0]]
        named = [a.narration for a in within if _action_names_category(a, first)]
        frames = tuple(contact.frame for contact in run)
        found.append(Candidate(video, first.side, first.category, first.entity, frames, *bounds, tuple(named)))
    return sorted(found, key=lambda candidate: candidate.contacts)


def _action_names_category(action: Action, contact: Contact) -> bool:
    """Return whether an action's noun, as "bottle:oil", or narration names the object's category."""
    words = re.split(r"[^a-z]+", f"{action.noun} {action.narration}".lower())
    return not {contact.category, f"{contact.category}s", f"{contact.category}es"}.isdisjoint(words)
