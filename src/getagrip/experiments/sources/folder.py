"""A folder of clips."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.errors import UsageError
from getagrip.experiments.sources.source import ClipSource, Sample, Split

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.share import Share


@dataclass(frozen=True)
class ClipFolder(ClipSource):
    """A folder of clips, or a clip: ``dataset`` is its path. It has no splits."""

    split: Split = "all"

    def __post_init__(self) -> None:
        if self.split != "all":
            raise UsageError(f"--split: got {self.split} for a folder of clips, expected all")

    @property
    def title(self) -> str:
        return "a folder of clips"  # its path is private

    @property
    def contact_mm(self) -> float:
        """That by which the clips were cut, as the list beside them says: 0 mm on ARCTIC, 10 mm on HOI4D."""
        from getagrip.grasps import lists

        path = Path(self.dataset) / lists.FILE
        cut = lists.read_cut(path) if path.is_file() else None
        contact = cut.get("contact") if isinstance(cut, dict) else None
        return super().contact_mm if contact is None else 1e3 * lists.metres(path, "cut.contact", contact)

    def samples(self, clips: Path, debug: bool, share: Share | None = None) -> tuple[list[Sample], list[Outcome]]:
        from getagrip.batch.plan import by_name

        found, failed = by_name([Path(self.dataset)])
        return [Sample(name, path) for name, path in sorted(found.items())], failed
