"""The interface of a source of clips, with a record of the source in its folder; and the source of your own clips."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.options import expand_user_path, one_of, parsed_argument

if TYPE_CHECKING:
    from getagrip.batch.job import Outcome
    from getagrip.batch.scheduling import SchedulingOptions
    from getagrip.bench.ablations import Ablation
    from getagrip.bench.tables import PublishedResults

Split = Literal["train", "validation", "all"]


@dataclass(frozen=True)
class Sample:
    """A clip of a benchmark."""

    name: str
    folder: Path
    make: Callable[[Path], None] | None = None
    """Makes a missing folder."""


def read_clip_names(path: Path) -> frozenset[str]:
    """Read the names of clips in a text file, one a line. Raises ``InputError``."""
    lines = files.read_bytes(path, files.MAX_JSON_BYTES).decode("utf-8", "replace").splitlines()
    names = frozenset(filter(None, map(str.strip, lines)))
    bad = next((name for name in names if not files.is_portable_name(name)), None)
    if bad is not None or not names:
        got = "no names" if bad is None else f"the name {files.shorten_value(bad)}"
        raise InputError(path, "", got, "names of clips, one a line")
    return names


def _parse_clip_names(text: str) -> frozenset[str]:
    return read_clip_names(Path(expand_user_path(text)))


@dataclass(frozen=True, kw_only=True)
class ClipSource:
    """The source of a benchmark's clips. The fields of a subclass are options of its ``getagrip bench``."""

    dataset: ClassVar[str]
    """Name of the dataset for users."""
    every_frame: ClassVar[bool] = False
    """True if all frames of the clips are fitted, whatever the user's options."""
    in_order: ClassVar[bool] = False
    """True if the clips are in a mixed order, of which ``--clips N`` takes the first N; else it takes N evenly."""
    split: Annotated[
        Split | None,
        one_of("train", "validation", "all"),
        arg(help_behavior_hint="(default: validation; all of a folder)"),
    ] = None
    """Part of a dataset: train is for tuning, validation for choosing."""
    only: Annotated[
        frozenset[str] | None,
        parsed_argument("FILE", _parse_clip_names, frozenset),
        arg(metavar="FILE", help_behavior_hint=""),
    ] = None
    """Use the clips that FILE names, one per line; only these are imported from a dataset."""

    def __post_init__(self) -> None:
        if self.split is not None and self.only is not None:
            raise UsageError(f"--split {self.split} cannot be used with --only, which names the clips")

    @property
    def part(self) -> Split:
        """Split to use."""
        return self.split or ("validation" if self.only is None else "all")

    @property
    def title(self) -> str:
        """Dataset and split, for the head of a page."""
        part = "both splits" if self.part == "all" else f"{self.part} split"
        return f"{self.description}, {part if self.only is None else 'clips by name'}"

    @property
    def description(self) -> str:
        """Dataset, without the split."""
        return self.dataset

    @property
    def contact_mm(self) -> float:
        """Default distance from the hand's surface within which points of the object are in contact [mm]."""
        return 10.0

    @property
    def columns(self) -> tuple[Literal["paper", "motion", "recall"], ...]:
        """Default columns of the tables."""
        return ("paper",)

    @property
    def compared(self) -> Ablation | None:
        """Settings to compare instead of methods."""
        return None

    @property
    def published(self) -> Mapping[str, PublishedResults]:
        """Published results on the parts of the dataset, by system."""
        return {}

    def part_of(self, clip: str, category: str) -> str:
        """Return the part (category, sequence) of a clip; each part has a table."""
        return category

    def samples(
        self, clips: Path, debug: bool, share: SchedulingOptions | None = None
    ) -> tuple[list[Sample], list[Outcome]]:
        """Return the clips, and the outcomes of folders without a clip.

        Missing clips are made in the folder ``clips``, all of them, whatever the shard of ``share``; imports are
        scheduled by ``share`` (None: the defaults).

        Raises ``UsageError`` for a wrong or missing option, or where ``clips`` holds clips of another source;
        ``InputError`` without clips.
        """
        raise NotImplementedError

    def claim(self, clips: Path) -> None:
        """Note in a folder that this source makes its clips.

        Raises ``UsageError`` where another source does, or this one with other options.
        """
        options = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("split", "only")}
        mine = {"dataset": self.dataset}
        mine |= {name: str(value.resolve()) if isinstance(value, Path) else value for name, value in options.items()}
        record = files.folder_inside(clips.parent, clips.name) / "source.json"
        if not record.exists():
            with files.new_file(record) as part:
                files.write_json(part, mine)
        elif files.read_json(record) != mine:
            raise UsageError(f"--out cannot be used with {self.dataset}: {clips} holds clips of another dataset")


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
        """Contact distance by which the clips were cut, from the list of grasps: 0 mm on ARCTIC, 10 mm on HOI4D."""
        from getagrip.stable_grasps import grasp_lists

        path = self.folder / grasp_lists.GRASP_LIST_FILE
        cut = grasp_lists.read_cut(path) if path.is_file() else None
        contact = cut.get("contact") if isinstance(cut, dict) else None
        if contact is None:
            return super().contact_mm
        return 1e3 * grasp_lists.parse_contact_distance(path, "cut.contact", contact)

    def samples(
        self, clips: Path, debug: bool, share: SchedulingOptions | None = None
    ) -> tuple[list[Sample], list[Outcome]]:
        from getagrip.batch.clips import clips_by_name

        found, failed = clips_by_name([self.folder])
        return [Sample(name, path) for name, path in sorted(found.items())], failed
