"""The answers of a served page: the entries, the worst first, and the results of each side by side, frame by frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.clip import masks_of_some, read_clip
from getagrip.clip.sampling import frame_indices
from getagrip.errors import GetagripError
from getagrip.evaluation import read_with_clip
from getagrip.evaluation.results import Evaluation
from getagrip.fitting.methods import label_of
from getagrip.geometry.camera import Crops, project
from getagrip.geometry.mesh import Mesh
from getagrip.io.files import Json
from getagrip.pages import motion
from getagrip.pages.document import document, pack
from getagrip.pages.evidence import compared
from getagrip.pages.frames import PICTURE, drawn
from getagrip.pages.report import SCRIPTS, described, gap_plot, over_time
from getagrip.pictures.shown import View, candidate
from getagrip.pictures.stills import ROOM, STEADY, smoothed
from getagrip.pictures.stored_results import StoredResult, at_common_frames, distinct, hand_alone, true_view
from getagrip.pictures.tiles import input_windows
from getagrip.pictures.touched import coarse, finer, gap
from getagrip.result import Reconstruction, read_record, read_result

SAMPLED = 20
"""Frames whose masks are read before any is shown; candidates are compared in them."""
AT_ONCE = 25
"""Frames whose gap is measured before others may be, or the server ends."""
TRUTH, ALONE = "ground truth", "the hand alone: no result and no ground truth"


@dataclass(frozen=True, eq=False)
class Shown:
    """A column that is open: its view has a simplified mesh and no masks, which are read with the frames."""

    column: Column
    view: View
    surface: Mesh

    @staticmethod
    def of(column: Column) -> Shown:
        """Open a column."""
        view = coarse(column.view)
        return Shown(column, view, finer(view))

    def about(self) -> Json:
        """Return what is the same in all frames."""
        metrics = {k: float(v) for k, v in self.column.record.get("metrics", {}).items() if isinstance(v, int | float)}
        arrays, packed = pack(motion.fixed(self.view, self.surface))
        known = Evaluation.recorded(self.view.clip, self.view.result.method, metrics)
        said = described(self.view, self.column.label, known, self.column.record)
        more = {"result": bool(self.column.record), "masked": self.at(self.sampled[:1]).masks is not None}
        return {**said, **more, "arrays": arrays, "packed": packed}

    def frame(self, rank: int, n: int) -> dict[str, object]:
        """Return a frame with one of the candidates."""
        view = candidate(self.at(np.array([n])), rank)
        arrays, packed = pack(motion.moving(view, self.surface))
        return {**drawn(view, 0, self.windows, n), "arrays": arrays, "packed": packed}

    def at(self, index: Int[ndarray, "n"], with_hand: bool = False) -> View:
        """Return some frames, with the masks of the object, and of the hand if wanted."""
        some = self.view.at([self.view.result.frames[n] for n in index])
        return replace(some, masks=masks_of_some(some.clip, with_hand))

    @cached_property
    def sampled(self) -> Int[ndarray, "n"]:
        """The frames ``SAMPLED``."""
        return frame_indices(len(self.view.clip), SAMPLED)

    @cached_property
    def windows(self) -> Crops:
        """Square windows around hand and masks in each frame, of one size; they follow the hand smoothly."""
        some = self.at(self.sampled)
        crops = input_windows([some], np.arange(len(some.clip)), PICTURE)
        hand = np.array([np.mean(project(K, self.view.hand(n)), axis=0) for n, K in enumerate(self.view.clip.K)])
        aside, every = crops.corner - hand[self.sampled], np.arange(len(hand))
        moved = np.stack([np.interp(every, self.sampled, aside[:, k]) for k in range(2)], axis=1)
        middle = smoothed(hand + moved + crops.side / 2.0, STEADY * self.view.clip.fps)
        side = ROOM * crops.side
        return Crops(middle - side / 2.0, side, PICTURE)


class Library:
    """The entries of a page.

    One thread makes all frames, one after the other, and another measures what takes time: few large images are in
    memory at once.
    """

    def __init__(self, entries: Sequence[Entry], fail: Callable[[Exception], None]) -> None:
        """Open the first entry that can be read; the errors of those before it go to ``fail``."""
        self.entries = tuple(entries)
        self._frames, self._measured = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
        self._opened = lru_cache(maxsize=2)(lambda n: [Shown.of(column) for column in self.entries[n].read()])
        self.first = next((n for n in range(len(entries)) if self._can_be_read(n, fail)), None)

    def _can_be_read(self, n: int, fail: Callable[[Exception], None]) -> bool:
        try:
            return bool(self._opened(n))
        except (GetagripError, OSError) as error:
            fail(error)
            return False

    def page(self) -> bytes:
        """Return the HTML page, which requests everything else."""
        data = {"entries": [entry.label for entry in self.entries], "first": self.first}
        return document("getagrip view", "viewer.html", SCRIPTS, data, asks=True).encode()

    def entry(self, n: int) -> dict[str, object]:
        """Return all that is the same in all frames of an entry."""

        def made() -> dict[str, object]:
            columns = self._opened(n)
            view = columns[0].view
            return {**over_time(view, np.arange(len(view.clip))), "columns": [column.about() for column in columns]}

        return self._frames.submit(made).result()

    def frame(self, n: int, column: int, rank: int, frame: int) -> dict[str, object]:
        """Return a frame of a column, with one of the candidates in the result's place."""
        return self._frames.submit(lambda: self._opened(n)[column].frame(rank, frame)).result()

    def gap(self, n: int, column: int) -> dict[str, object]:
        """Return the curve of a column that is slow to compute."""
        view = self._shown(n, column).view
        if not view.posed:
            return {}
        names = view.result.frames
        parts = [view.at(names[first : first + AT_ONCE]) for first in range(0, len(names), AT_ONCE)]
        return gap_plot(np.concatenate([self._measured.submit(gap, part).result() for part in parts]))

    def candidates(self, n: int, column: int) -> dict[str, object]:
        """Return the evidence for and against the candidates of a column."""
        shown = self._shown(n, column)
        return self._measured.submit(lambda: compared(shown.at(shown.sampled, with_hand=True))).result()

    def _shown(self, n: int, column: int) -> Shown:
        return self._frames.submit(lambda: self._opened(n)[column]).result()


@dataclass(frozen=True, eq=False)
class Column:
    """A result or a clip, and what it is called; ``record`` is the content of its ``result.json``."""

    label: str
    view: View
    record: Json


@dataclass(frozen=True)
class Entry:
    """A line of the list.

    Attributes:
        label: what the list calls it.
        results: folders of the results of one clip; none where a clip itself is shown.
        clip: folder of the clip that is shown itself.
        clips: where the clips of results are; None: where the results say.
    """

    label: str
    results: tuple[Path, ...] = ()
    clip: Path | None = None
    clips: Path | None = None

    def read(self) -> list[Column]:
        """Read a column for each result, at the frames that all of them have, without masks. Raises ``InputError``."""
        if self.clip is not None:
            clip = read_clip(self.clip)
            return [
                Column(ALONE, hand_alone(clip), {}) if clip.truth is None else Column(TRUTH, true_view(self.clip), {})
            ]
        stored = [StoredResult(folder, self.clips) for folder in self.results]
        read = [(one, View.of(*read_with_clip(one.folder, one.clips), None)) for one in stored]
        views, names = at_common_frames(read), labels([view for _, view in read], distinct(stored))
        return [Column(*each) for each in zip(names, views, map(read_record, self.results), strict=True)]


def labels(views: Sequence[View], folders: Sequence[str]) -> list[str]:
    """Return the results' methods; where these agree, also the folders that tell the results apart."""
    named = [label_of(v.result.method) for v in views]
    return [
        label if named.count(label) == 1 else f"{label} ({folder})"
        for label, folder in zip(named, folders, strict=True)
    ]


def entries(
    results: Sequence[Path], clip_folders: Sequence[Path], clips: Path | None, fail: Callable[[Exception], None]
) -> list[Entry]:
    """Group results of the same clip and inputs: the serious ones first, then by mean IOU; clips follow.

    Those that cannot be read go to ``fail``.
    """
    groups: dict[tuple[str, str], list[tuple[Path, Reconstruction]]] = {}
    for folder in dict.fromkeys(path.resolve() for path in results):
        try:
            result, record = read_result(folder)
            groups.setdefault((result.clip, record["input_sha256"]), []).append((folder, result))
        except (GetagripError, OSError) as error:
            fail(error)
    ranked = sorted(groups.values(), key=lambda group: badness([result for _, result in group]))
    found = [Entry(_label(group), tuple(folder for folder, _ in group), clips=clips) for group in ranked]
    found += [Entry(folder.resolve().name, clip=folder) for folder in clip_folders]
    twice = {label for label, count in Counter(entry.label for entry in found).items() if count > 1}
    return [replace(e, label=f"{n + 1}. {e.label}") if e.label in twice else e for n, e in enumerate(found)]


def badness(results: Sequence[Reconstruction]) -> tuple[bool, float]:
    """Return a key that sorts the worst first: whether nothing serious is found, then the lowest mean IOU."""
    serious = any(finding.serious for result in results for finding in result.findings)
    return not serious, min(_iou(result) for result in results)


def _label(group: Sequence[tuple[Path, Reconstruction]]) -> str:
    results = [result for _, result in group]
    overlap = f"IOU {100 * min(_iou(result) for result in results):.0f} %"
    serious = {finding.check for result in results for finding in result.findings if finding.serious}
    several = [f"{len(group)} results"] if len(group) > 1 else []
    return ", ".join([results[0].clip, overlap, *several, *sorted(serious)])


def _iou(result: Reconstruction) -> float:
    return float(np.nan_to_num(result.mean_iou))
