"""A folder of clips."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from tyro.conf import Positional, arg

from getagrip.errors import UsageError
from getagrip.experiments.sources.source import ClipSource, Sample

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.share import Share


@dataclass(frozen=True, kw_only=True)
class ClipFolder(ClipSource):
    """Clips of your own, with ground truth or without."""

    dataset: ClassVar[str] = "clips"
    folder: Annotated[Positional[Path], arg(metavar="DIR")]
    """A folder of clips, a clip, or a pattern in quotes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.split not in (None, "all"):
            raise UsageError(f"--split {self.split} cannot be used with a folder of clips, which has no splits")

    @property
    def title(self) -> str:
        return "a folder of clips"  # its path is private

    @property
    def contact_mm(self) -> float:
        """That by which the clips were cut, as the list beside them says: 0 mm on ARCTIC, 10 mm on HOI4D."""
        from getagrip.grasps import lists

        path = self.folder / lists.FILE
        cut = lists.read_cut(path) if path.is_file() else None
        contact = cut.get("contact") if isinstance(cut, dict) else None
        return super().contact_mm if contact is None else 1e3 * lists.metres(path, "cut.contact", contact)

    def samples(self, clips: Path, debug: bool, share: Share | None = None) -> tuple[list[Sample], list[Outcome]]:
        from getagrip.batch.plan import by_name

        found, failed = by_name([self.folder])
        return [Sample(name, path) for name, path in sorted(found.items())], failed
