"""What a source of clips is, and a note of which one made the clips of a folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from getagrip.errors import UsageError

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.share import Share

Split = Literal["train", "validation", "all"]


@dataclass(frozen=True)
class Sample:
    """A clip of a benchmark."""

    name: str
    folder: Path
    make: Callable[[Path], None] | None = None
    """Makes the folder where it is not there."""


@dataclass(frozen=True)
class ClipSource:
    """Where the clips of a benchmark come from. The fields of a subclass are options of ``getagrip bench``."""

    dataset: str
    """What the user calls it."""
    split: Split = "validation"
    only: frozenset[str] | None = None
    """Names of the clips to use, and to import, of ``split`` "all"; None: all."""

    @property
    def title(self) -> str:
        """The clips, for the head of a page."""
        part = "both splits" if self.split == "all" else f"{self.split} split"
        return f"{self.description}, {part if self.only is None else 'clips by name'}"

    @property
    def description(self) -> str:
        """The dataset, whatever the split."""
        return self.dataset

    @property
    def contact_mm(self) -> float:
        """Within how much of the hand's surface points of the object are in contact, unless the user says [mm]."""
        return 10.0

    def samples(self, clips: Path, debug: bool, share: Share | None = None) -> tuple[list[Sample], list[Outcome]]:
        """The clips, and what became of folders that are none. Clips that must be made go to the folder ``clips``,
        all of them, whatever the shard of ``share``, which says who makes those of recordings; by
        default as that of a call without options.

        Raises ``UsageError`` where an option is wrong or missing, or where ``clips`` holds those of another source;
        ``InputError`` where there are no clips.
        """
        raise NotImplementedError

    def claim(self, clips: Path) -> None:
        """Note that this source makes the clips of a folder, so that no other source takes them for its own.

        Raises ``UsageError`` where another one does, or this one with other options.
        """
        from getagrip.io import files

        options = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("split", "only")}
        mine = {name: str(value.resolve()) if isinstance(value, Path) else value for name, value in options.items()}
        note = files.folder_inside(clips.parent, clips.name) / "source.json"
        if not note.exists():
            with files.new_file(note) as part:
                files.write_json(part, mine)
        elif files.read_json(note) != mine:
            raise UsageError(f"--out: {clips} holds clips of another dataset, as {note.name} there says; name another")
