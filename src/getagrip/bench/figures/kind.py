"""The base of all kinds of figures: draw a matplotlib figure from results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from tyro.conf import arg

from getagrip.errors import GetagripError, UsageError
from getagrip.fitting.methods import label_of
from getagrip.provenance import assumptions
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stored_results import StoredResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Fail = Callable[[Exception], None]
"""Called with the error of a result that is left out."""
Count = Annotated[int, arg(metavar="N")]
Millimetres = Annotated[float, arg(metavar="MM")]
MAX_FIGURE_FRAMES = 12
FIGURE_DPI_RANGE = 40, 600


@dataclass(frozen=True, kw_only=True)
class FigureKind:
    """A kind of figure; its fields are the options, its docstring is the help."""

    draws_truth: ClassVar[bool] = False
    """True if the figure also accepts a clip, whose ground truth it draws."""
    dpi: Annotated[int, arg(metavar="N")] = 130
    """Pixels an inch."""

    def draw(self, results: Sequence[StoredResult], fail: Fail) -> Figure:
        """Draw the figure. Raises ``GetagripError`` where no result can be shown."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise ``UsageError`` for options out of range."""
        if not FIGURE_DPI_RANGE[0] <= self.dpi <= FIGURE_DPI_RANGE[1]:
            raise UsageError(f"--dpi must be {FIGURE_DPI_RANGE[0]} to {FIGURE_DPI_RANGE[1]} (got {self.dpi})")
        frames = getattr(self, "frames", 1)
        if not 1 <= frames <= MAX_FIGURE_FRAMES:
            raise UsageError(f"--frames must be 1 to {MAX_FIGURE_FRAMES} (got {frames})")


def require_one_result(results: Sequence[StoredResult], kind: str) -> View:
    """Read the only result of a figure. Raises ``UsageError`` for any other number of results."""
    if len(results) != 1:
        first = ", ".join(str(value.folder) for value in results[:2])
        raise UsageError(f"RESULT must be one for the figure {kind!r} (got {len(results)}: {first}, ...)")
    return results[0].read()


def read_readable_results(results: Sequence[StoredResult], fail: Fail) -> list[tuple[StoredResult, View]]:
    """Read results; errors go to ``fail``. Raises the first error where all are unreadable."""
    out: list[tuple[StoredResult, View]] = []
    errors = list[Exception]()
    for value in results:
        try:
            out.append((value, value.read()))
        except (GetagripError, OSError) as error:
            errors.append(error)
    if errors and not out:
        raise errors[0]
    for each in errors:
        fail(each)
    return out


def evenly_spaced_indices(count: int, total: int) -> list[int]:
    """Return at most ``count`` evenly spaced indices from 0 to ``total`` - 1."""
    return [int(n) for n in np.unique(np.linspace(0, total - 1, count).round())]


def summarise_view(view: View) -> str:
    """Summarise method, object and hand, number of frames, and assumptions in a line."""
    label = "ground truth" if view.of_truth else label_of(view.result.method)
    return "  ·  ".join([label, *describe_view(view)])


def describe_view(view: View) -> list[str]:
    """Describe object and hand, number of frames, and assumptions."""
    clip = view.clip
    return [f"{clip.category} in a {clip.side} hand", view.frames_in_words, *list_assumptions(view)]


def list_assumptions(view: View) -> list[str]:
    """Describe the assumptions; empty without any."""
    keys = list(assumptions(view.clip.provenance))
    known = ["scale"] * (view.clip.scale == "free") + ["shape"] * (view.result.warp is not None) + keys
    return [f"guessed: {', '.join(known)}"] if known else []


def describe_findings(view: View) -> list[str]:
    """Describe the number of findings of a result (docs/checks.md); empty without any."""
    count, serious = len(view.result.findings), sum(finding.serious for finding in view.result.findings)
    words = f"{count} finding{'s' if count > 1 else ''}" + (f", {serious} serious" if serious else "")
    return [words] if count else []
