"""The server of ``getagrip view``: entries, worst first, with the results of each side by side, frame by frame.

Every path begins with a secret, new at each start, which other users of the machine and pages of other sites do not
know. A method of ``ViewerLibrary`` and whole numbers follow: no path names a file. A site that gives this machine's
address to its own name (DNS rebinding) is recognised by that name (``Host``), a request from a page of another site by
the browser's ``Sec-Fetch-Site``.
"""

from __future__ import annotations

import errno
import ipaddress
import json
import re
import secrets
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from http import HTTPStatus
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.clip import read_available_masks, read_clip
from getagrip.clip.clip import frame_indices
from getagrip.errors import GetagripError, UsageError
from getagrip.fitting.methods import label_of
from getagrip.geometry.camera import Crops
from getagrip.geometry.mesh import Mesh
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.metrics.evaluate import read_result_and_clip
from getagrip.metrics.evaluate.results import Evaluation
from getagrip.report.pages import scene_data
from getagrip.report.pages.candidates import compare_candidates
from getagrip.report.pages.result_page import (
    RESULT_PAGE_SCRIPTS,
    build_document,
    describe_result,
    gap_plot,
    pack_arrays,
    timeline_data,
)
from getagrip.report.pages.scene_data import FRAME_PICTURE_PX, VIEW_PICTURE_PX, draw_page_frame
from getagrip.report.pictures.contact_colours import decimate_view, subdivide_object, surface_gap
from getagrip.report.pictures.panels import input_windows, seen_points
from getagrip.report.pictures.result_view import View, candidate_view, candidate_views
from getagrip.report.pictures.stored_results import (
    WINDOW_MARGIN_FACTOR,
    WINDOW_SMOOTHING_S,
    StoredResult,
    at_common_frames,
    distinct_path_parts,
    ground_truth_view,
    hand_only_view,
    smooth_track,
)
from getagrip.report.serving import LOOPBACK, SCRIPTED_PAGE_HEADERS, QuietHandler, QuietServer
from getagrip.result import Reconstruction, read_result, read_result_record

N_SAMPLED_FRAMES = 20
"""Frames whose masks are read when a column is opened; candidates are compared in these frames."""
GAP_BATCH_FRAMES = 25
"""Frames whose gap is measured without interruption by other requests or the server's end."""
GROUND_TRUTH_LABEL, HAND_ONLY_LABEL = "ground truth", "the hand alone: no result and no ground truth"


@dataclass(frozen=True, eq=False)
class ViewerColumn:
    """A result or a clip with its label; ``record`` is the content of ``result.json``, empty for a clip."""

    label: str
    view: View
    record: Json


@dataclass(frozen=True)
class ViewerEntry:
    """A line of the list.

    Attributes:
        label: text of the line.
        results: folders of the results of one clip; empty for an entry that shows a clip itself.
        clip: folder of the clip that the entry shows.
        clips: a clip, or the folder of the clips, of the results; None: the clips that the results name.
    """

    label: str
    results: tuple[Path, ...] = ()
    clip: Path | None = None
    clips: Path | None = None

    def read(self) -> list[ViewerColumn]:
        """Read a column for each result, at their common frames, without masks. Raises ``InputError``."""
        if self.clip is not None:
            clip = read_clip(self.clip)
            if clip.truth is None:
                return [ViewerColumn(HAND_ONLY_LABEL, hand_only_view(clip), {})]
            return [ViewerColumn(GROUND_TRUTH_LABEL, ground_truth_view(self.clip), {})]
        stored = [StoredResult(folder, self.clips) for folder in self.results]
        read = [(one, View.of(*read_result_and_clip(one.folder, one.clips), None)) for one in stored]
        views, names = at_common_frames(read), label_views([view for _, view in read], distinct_path_parts(stored))
        return [ViewerColumn(*each) for each in zip(names, views, map(read_result_record, self.results), strict=True)]


@dataclass(frozen=True, eq=False)
class OpenColumn:
    """An open column: its view has a decimated mesh and no masks, which are read with the frames."""

    column: ViewerColumn
    view: View
    surface: Mesh

    @staticmethod
    def of(column: ViewerColumn) -> OpenColumn:
        view = decimate_view(column.view)
        return OpenColumn(column, view, subdivide_object(view))

    def about(self) -> Json:
        """Return the column's data that all frames share."""
        metrics = {k: float(v) for k, v in self.column.record.get("metrics", {}).items() if isinstance(v, int | float)}
        arrays, packed = pack_arrays(scene_data.constant_arrays(candidate_views(self.view), self.surface))
        known = Evaluation.recorded(self.view.clip, self.view.result.method, metrics)
        said = describe_result(self.view, self.column.label, known, self.column.record)
        more = {"result": bool(self.column.record), "masked": self.at(self.sampled[:1]).masks is not None}
        return {**said, **more, "arrays": arrays, "packed": packed}

    def frame(self, rank: int, n: int) -> dict[str, object]:
        """Return frame ``n`` with the candidate ``rank``."""
        view = candidate_view(self.at(np.array([n])), rank)
        arrays, packed = pack_arrays(scene_data.per_frame_arrays(view, self.surface))
        each = zip(view.in_each_view().values(), self.windows_of_views, strict=True)
        views = [draw_page_frame(seen, 0, windows, n, iou=_iou_of_frame(seen)) for seen, windows in each]
        return {**draw_page_frame(view, 0, self.windows, n), "views": views, "arrays": arrays, "packed": packed}

    def at(self, index: Int[ndarray, "n"], with_hand: bool = False) -> View:
        """Return the view at some frames, with masks of the object and, if ``with_hand``, of the hand."""
        some = self.view.at([self.view.result.frames[n] for n in index])
        return replace(some, masks=read_available_masks(some.clip, with_hand))

    @cached_property
    def sampled(self) -> Int[ndarray, "n"]:
        """Indices of ``N_SAMPLED_FRAMES`` frames, evenly sampled."""
        return frame_indices(len(self.view.clip), N_SAMPLED_FRAMES)

    @cached_property
    def windows(self) -> Crops:
        """Square windows of one size around hand and masks, one a frame, which follow the hand smoothly."""
        return self._windows_around(self.view, self.at(self.sampled), FRAME_PICTURE_PX)

    @cached_property
    def windows_of_views(self) -> list[Crops]:
        """Windows of each further view, in the order of the cameras."""
        some = self.at(self.sampled)
        whole = [self.view.in_view(camera, with_masks=False) for camera in self.view.cameras]
        each = zip(whole, some.in_each_view().values(), strict=True)
        return [self._windows_around(view, sampled, VIEW_PICTURE_PX) for view, sampled in each]

    def _windows_around(self, view: View, some: View, size: int) -> Crops:
        """Return windows of all frames of a view, of which ``some`` has the sampled frames with their masks."""
        crops = input_windows([some], np.arange(len(some.clip)), size)
        hand = np.array([np.mean(seen_points(view, n, view.hand(n)), axis=0) for n in range(len(view.clip))])
        aside, every = crops.corner - hand[self.sampled], np.arange(len(hand))
        moved = np.stack([np.interp(every, self.sampled, aside[:, k]) for k in range(2)], axis=1)
        middle = smooth_track(hand + moved + crops.side / 2.0, WINDOW_SMOOTHING_S * view.clip.fps)
        side = WINDOW_MARGIN_FACTOR * crops.side
        return Crops(middle - side / 2.0, side, size)


def _iou_of_frame(seen: View) -> float | None:
    """Compute the IOU of the only frame of a view; None without a pose of the object."""
    return float(seen.measured_iou()[0]) if seen.posed else None


class ViewerLibrary:
    """The entries of a page.

    One thread draws all frames, one after the other, and another measures gaps and candidates, so that few large images
    are in memory at once.
    """

    def __init__(self, entries: Sequence[ViewerEntry], fail: Callable[[Exception], None]) -> None:
        """Open the first readable entry; errors of the entries before it go to ``fail``."""
        self.entries = tuple(entries)
        self._frames, self._measured = ThreadPoolExecutor(1), ThreadPoolExecutor(1)
        self._opened = lru_cache(maxsize=2)(lambda n: [OpenColumn.of(column) for column in self.entries[n].read()])
        self.first = next((n for n in range(len(entries)) if self._can_be_read(n, fail)), None)

    def _can_be_read(self, n: int, fail: Callable[[Exception], None]) -> bool:
        try:
            return bool(self._opened(n))
        except (GetagripError, OSError) as error:
            fail(error)
            return False

    def page(self) -> bytes:
        """Return the HTML page, which requests all other data."""
        data = {"entries": [entry.label for entry in self.entries], "first": self.first}
        return build_document("getagrip view", "viewer.html", RESULT_PAGE_SCRIPTS, data, asks=True).encode()

    def entry(self, n: int) -> dict[str, object]:
        """Return the data of entry ``n`` that all frames share."""

        def made() -> dict[str, object]:
            columns = self._opened(n)
            view = columns[0].view
            return {**timeline_data(view, np.arange(len(view.clip))), "columns": [column.about() for column in columns]}

        return self._frames.submit(made).result()

    def frame(self, n: int, column: int, rank: int, frame: int) -> dict[str, object]:
        """Return a frame of a column, with the candidate ``rank`` in place of the result."""
        return self._frames.submit(lambda: self._opened(n)[column].frame(rank, frame)).result()

    def gap(self, n: int, column: int) -> dict[str, object]:
        """Return the curve of the gap of hand and object, which is slow to compute; empty without poses."""
        view = self._shown(n, column).view
        if not view.posed:
            return {}
        names = view.result.frames
        parts = [view.at(names[first : first + GAP_BATCH_FRAMES]) for first in range(0, len(names), GAP_BATCH_FRAMES)]
        return gap_plot(np.concatenate([self._measured.submit(surface_gap, part).result() for part in parts]))

    def candidates(self, n: int, column: int) -> dict[str, object]:
        """Return the evidence for and against the candidates of a column."""
        shown = self._shown(n, column)
        return self._measured.submit(lambda: compare_candidates(shown.at(shown.sampled, with_hand=True))).result()

    def _shown(self, n: int, column: int) -> OpenColumn:
        return self._frames.submit(lambda: self._opened(n)[column]).result()


def label_views(views: Sequence[View], folders: Sequence[str]) -> list[str]:
    """Name results by their methods, and by their folders where several have the same method."""
    named = [label_of(v.result.method) for v in views]
    both = zip(named, folders, strict=True)
    return [label if named.count(label) == 1 else f"{label} ({folder})" for label, folder in both]


def group_entries(
    results: Sequence[Path], clip_folders: Sequence[Path], clips: Path | None, fail: Callable[[Exception], None]
) -> list[ViewerEntry]:
    """Group results by clip and inputs, worst first (``entry_severity_key``), followed by clips.

    Errors of unreadable results go to ``fail``.
    """
    groups: dict[tuple[str, str], list[tuple[Path, Reconstruction]]] = {}
    for folder in dict.fromkeys(path.resolve() for path in results):
        try:
            result, record = read_result(folder)
            groups.setdefault((result.clip, record["input_sha256"]), []).append((folder, result))
        except (GetagripError, OSError) as error:
            fail(error)
    ranked = sorted(groups.values(), key=lambda group: entry_severity_key([result for _, result in group]))
    found = [ViewerEntry(_label_entry(group), tuple(folder for folder, _ in group), clips=clips) for group in ranked]
    found += [ViewerEntry(folder.resolve().name, clip=folder) for folder in clip_folders]
    twice = {label for label, count in Counter(entry.label for entry in found).items() if count > 1}
    return [replace(e, label=f"{n + 1}. {e.label}") if e.label in twice else e for n, e in enumerate(found)]


def entry_severity_key(results: Sequence[Reconstruction]) -> tuple[bool, float]:
    """Return a key that sorts the worst first: results with serious findings, then by the lowest mean IOU."""
    serious = any(finding.serious for result in results for finding in result.findings)
    return not serious, min(_mean_iou(result) for result in results)


def _label_entry(group: Sequence[tuple[Path, Reconstruction]]) -> str:
    results = [result for _, result in group]
    overlap = f"IOU {100 * min(_mean_iou(result) for result in results):.0f} %"
    serious = {finding.check for result in results for finding in result.findings if finding.serious}
    several = [f"{len(group)} results"] if len(group) > 1 else []
    return ", ".join([results[0].clip, overlap, *several, *sorted(serious)])


def _mean_iou(result: Reconstruction) -> float:
    return float(np.nan_to_num(result.mean_iou))


VIEWER_PORT = 8770
"""Default port of the page."""
VIEWER_ROUTES: dict[str, tuple[Callable[..., dict[str, object]], int]] = {
    "entry": (ViewerLibrary.entry, 1),
    "frame": (ViewerLibrary.frame, 4),
    "gap": (ViewerLibrary.gap, 2),
    "candidates": (ViewerLibrary.candidates, 2),
}
"""Method and number of arguments for each path."""


class ViewerServer(QuietServer):
    """The server of one library."""

    def __init__(self, library: ViewerLibrary, port: int | None = None, host: str = LOOPBACK) -> None:
        """Listen on a port, 0 for any free one; by default on ``VIEWER_PORT`` or, if that is taken, on any free one.

        Raises ``UsageError`` for a port in use or an address of another machine.
        """
        self.library, self.host, self.secret = library, host, secrets.token_urlsafe(16)
        try:
            super().__init__((host, VIEWER_PORT if port is None else port), _ViewerHandler)
        except (OSError, OverflowError) as error:
            if port is None and isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
                super().__init__((host, 0), _ViewerHandler)
            else:
                got = f"{VIEWER_PORT if port is None else port}, {host}: {error}"
                raise UsageError(f"--port, --host must be a free port of this machine (got {got})") from error

    @property
    def url(self) -> str:
        """Address of the page, with its secret."""
        return f"http://{self.host}:{self.server_port}/{self.secret}/"

    def admits(self, host: str) -> bool:
        """Return whether a request's ``Host`` is an IP address, localhost or the address that the user chose."""
        name = re.sub(r":\d{1,5}$", "", host)
        if name in (self.host, "localhost"):
            return True
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return True


class _ViewerHandler(QuietHandler):
    server: ViewerServer

    def do_GET(self) -> None:
        """Answer with the page or its data; errors become one line of JSON, never a traceback."""
        try:
            if not self.server.admits(self.headers.get("Host") or ""):
                self._refuse("requests to another host are refused", HTTPStatus.FORBIDDEN)
            elif (rest := self._below_secret()) is None:
                self._refuse("this page opens only at the whole address that getagrip view has printed")
            elif rest == "":
                self.send(self.server.library.page(), "text/html; charset=utf-8", SCRIPTED_PAGE_HEADERS)
            elif self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
                self._refuse("requests from other sites are refused")
            else:
                self._part(rest)
        except ConnectionError:
            self.close_connection = True
        except GetagripError as error:
            self._refuse(str(error), HTTPStatus.UNPROCESSABLE_ENTITY)
        except Exception as error:  # without an answer the page would wait for ever
            self._refuse(f"{type(error).__name__}: {error}", HTTPStatus.INTERNAL_SERVER_ERROR)

    def _below_secret(self) -> str | None:
        first, _, rest = self.path.partition("?")[0].removeprefix("/").partition("/")
        return rest if secrets.compare_digest(first.encode(), self.server.secret.encode()) else None

    def _part(self, path: str) -> None:
        name, *numbers = path.split("/")
        method, count = VIEWER_ROUTES.get(name, (None, 0))
        if method is None or len(numbers) != count or not all(re.fullmatch("[0-9]{1,6}", one) for one in numbers):
            self._refuse("no such page", HTTPStatus.NOT_FOUND)
            return
        try:
            content = method(self.server.library, *map(int, numbers))
        except IndexError:
            self._refuse("no such page", HTTPStatus.NOT_FOUND)
            return
        self.send_json(json.loads(files.to_json(content)))

    def _refuse(self, why: str, status: HTTPStatus = HTTPStatus.FORBIDDEN) -> None:
        self.close_connection = True
        self.send_json({"error": why}, status)
