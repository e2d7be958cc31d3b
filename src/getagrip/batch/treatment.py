"""How a call treats its clips: options of ``getagrip reconstruct``, light to load."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from tyro.conf import arg

from getagrip.batch.share import Share
from getagrip.errors import UsageError
from getagrip.io.arguments import Flag


@dataclass(frozen=True)
class Batch:
    """How a call treats its clips. Raises ``UsageError``."""

    threads: Annotated[int, arg(metavar="N")] = 1
    """Threads for each clip, to get a single clip sooner; many clips are faster with --workers. Results are
    bit-equal."""
    overwrite: Flag = False
    """Make valid results again, too."""
    strict: Flag = False
    """Exit with 1 also if a check has a serious finding (the result is probably worthless), or a result is less
    probable than --min-probability."""
    min_probability: Annotated[float, arg(metavar="P")] = 0.5
    """With --strict, the least probability that poses are right in the hand, 0 to 1. Results without a probability
    pass, if no finding is serious."""
    share: Annotated[Share, arg(name="")] = field(default_factory=Share)

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_probability <= 1.0:
            raise UsageError(f"--min-probability must be 0 to 1 (got {self.min_probability:g})")
        if self.threads < 1:
            raise UsageError(f"--threads must be 1 or more (got {self.threads})")
