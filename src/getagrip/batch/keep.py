"""``--keep``: mark the results of which a share is right, in the hand or in the camera. Nothing is deleted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from getagrip.errors import UsageError
from getagrip.probability import Probability

if TYPE_CHECKING:
    from getagrip.fitting.options import Options
    from getagrip.pages import IndexRow
    from getagrip.result import Reconstruction

MIN_KEEP_SHARE, MAX_KEEP_SHARE = 0.5, 0.98
"""Shares that results are calibrated for (``checks.keeping``)."""
MAX_NAMED_RESULTS = 20
"""Most results that are named in a line: the summary has them all."""


@dataclass(frozen=True)
class KeepOptions:
    """Which results are kept. Raises ``UsageError``."""

    keep: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint="(default: no result is marked)")] = None
    """Mark each result as kept or dropped, such that at least this share of the kept ones (0.5 to 0.98) is right.
    Nothing is deleted. Calibrated with simulated and with real errors of hands."""
    keep_in: Literal["hand", "camera"] = "hand"
    """Frame in which kept results must be right."""

    def __post_init__(self) -> None:
        if self.keep is not None and not MIN_KEEP_SHARE <= self.keep <= MAX_KEEP_SHARE:
            raise UsageError(f"--keep must be {MIN_KEEP_SHARE:g} to {MAX_KEEP_SHARE:g} (got {self.keep:g})")

    def check(self, options: Options) -> None:
        """Raise ``UsageError`` where results of these options have no probability: all of them would be dropped."""
        if self.keep is not None:
            from getagrip.fitting.judge import uncalibrated_reason

            if why := uncalibrated_reason(options, ()):
                raise UsageError(f"--keep needs the probability that results are right, and {why}")

    def verdict(self, in_hand: Probability | None, in_camera: Probability | None) -> str:
        """Return "kept" or "dropped"; empty where nothing is marked. Results without a probability are dropped."""
        return self.mark(*(None if right is None else right.keep for right in (in_hand, in_camera)))

    def mark(self, in_hand: float | None, in_camera: float | None) -> str:
        """Return the verdict by the largest shares that a result is kept for."""
        if self.keep is None:
            return ""
        share = in_hand if self.keep_in == "hand" else in_camera
        return "kept" if share is not None and share >= self.keep else "dropped"

    def marked(self, row: IndexRow, result: Reconstruction) -> IndexRow:
        """Return a row of the index with a flag where its result is dropped."""
        dropped = self.verdict(result.probability_right, result.probability_right_in_camera) == "dropped"
        return replace(row, flags=(*row.flags, "dropped")) if dropped else row

    def summary(self, verdicts: Mapping[str, str]) -> str:
        """Sum up the verdicts of results by name, in a line."""
        dropped = sorted(name for name, verdict in verdicts.items() if verdict == "dropped")
        kept = len(verdicts) - len(dropped)
        more = f" and {len(dropped) - MAX_NAMED_RESULTS} more" if len(dropped) > MAX_NAMED_RESULTS else ""
        named = f"; dropped: {', '.join(dropped[:MAX_NAMED_RESULTS])}{more}" if dropped else ""
        share = f"{kept} of {len(verdicts)} ({100.0 * kept / max(len(verdicts), 1):.0f} %) are kept"
        return f"{share}: at least {100.0 * (self.keep or 0.0):.3g} % of such are right in the {self.keep_in}{named}"


NO_KEEP_FILTER = KeepOptions()
"""No mark."""
