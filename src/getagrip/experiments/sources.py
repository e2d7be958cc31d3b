"""Which clips a benchmark is made of: folders, or made-up clips that are made when they are needed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from getagrip.batch.job import Outcome, by_name
from getagrip.clip import write_clip
from getagrip.clip.sampling import frame_indices
from getagrip.errors import UsageError
from getagrip.experiments.trials import Sample
from getagrip.io import files

if TYPE_CHECKING:
    from getagrip.datasets.synthetic.scene import Options
    from getagrip.datasets.synthetic.splits import Preset
    from getagrip.datasets.synthetic.splits import Split as SyntheticSplit

Split = Literal["train", "test", "all"]
NAMED = ("synthetic", "dexycb")


@dataclass(frozen=True)
class Source:
    """What the user asks for."""

    dataset: str
    """``synthetic``, ``dexycb``, or a folder of clips."""
    clips: Path
    """Where clips are made."""
    split: Split | None = None
    """None: the test split of the named datasets, all of a folder's clips."""
    count: int | None = None
    """So many clips, spread evenly."""
    preset: Preset = "clean"
    """What is known of made-up clips."""
    root: Path | None = None
    """Where DexYCB is."""
    meshes: Path | None = None
    """Where the YCB models are."""

    @property
    def named(self) -> bool:
        """Whether the dataset is one that the package knows."""
        return self.dataset in NAMED

    @property
    def part(self) -> Split:
        """The split, where the user names none."""
        return self.split or ("test" if self.named else "all")


def samples(source: Source, debug: bool) -> tuple[list[Sample], list[Outcome]]:
    """The clips, and what became of folders that are none.

    Raises ``UsageError`` where an option is wrong or missing, or where the folder of the clips has those of another
    source; ``InputError`` where there are no clips.
    """
    if source.count is not None and source.count < 1:
        raise UsageError(f"--clips: got {source.count}, expected 1 or more")
    if source.dataset != "dexycb" and (source.root is not None or source.meshes is not None):
        raise UsageError(f"--root and --meshes: got them for {source.dataset}, expected them for dexycb only")
    if source.dataset != "synthetic" and source.preset != "clean":
        raise UsageError(f"--preset: got {source.preset} for {source.dataset}, expected it for synthetic only")
    if source.dataset == "synthetic":
        _bind(source, {"preset": source.preset})
        found, bad = _synthetic(source), list[Outcome]()
    elif source.dataset == "dexycb":
        _bind(source, {"root": _resolved(source.root), "meshes": _resolved(source.meshes)})
        found, bad = _dexycb(source, debug)
    else:
        found, bad = _folder(Path(source.dataset), source.part)
    if source.count is not None and source.count < len(found):
        found = [found[n] for n in frame_indices(len(found), source.count)]
    return found, bad


def _bind(source: Source, what: dict[str, str | None]) -> None:
    """Note whose clips are made in a folder, so that no other source takes them for its own."""
    note, wanted = source.clips / "source.json", {"dataset": source.dataset, **what}
    if not note.exists():
        source.clips.mkdir(parents=True, exist_ok=True)
        files.write_json(note, wanted)
    elif files.read_json(note) != wanted:
        raise UsageError(
            f"--out: {source.clips} holds clips of another dataset, as {note.name} there says; name another"
        )


def _resolved(path: Path | None) -> str | None:
    return None if path is None else str(path.resolve())


def _folder(folder: Path, part: Split) -> tuple[list[Sample], list[Outcome]]:
    """The clips of a folder."""
    if part != "all":
        raise UsageError(f"--split: got {part} for a folder of clips, expected all")
    found, bad = by_name([folder])
    return [Sample(name, path) for name, path in sorted(found.items())], bad


def _dexycb(source: Source, debug: bool) -> tuple[list[Sample], list[Outcome]]:
    """DexYCB's grasps, imported where that is not done yet; of every three subjects the first is for training."""
    from getagrip.batch.imports import import_dexycb
    from getagrip.datasets.dexycb.clips import subject_of

    if source.root is None:
        raise UsageError("--root: say where DexYCB is")
    done = source.clips / "imported"
    if not done.exists() and import_dexycb(source.root, source.meshes, source.clips, debug) == 0:
        done.touch()  # else what failed is tried again next time
    found, bad = by_name([source.clips])
    subjects = sorted({subject_of(name) for name in found})
    train = subjects[::3]
    wanted = {"train": train, "test": [s for s in subjects if s not in train], "all": subjects}[source.part]
    return [Sample(name, path) for name, path in sorted(found.items()) if subject_of(name) in wanted], bad


def _synthetic(source: Source) -> list[Sample]:
    """Made-up clips, made by whoever needs them first."""
    from getagrip.datasets.synthetic.scene import clip_name
    from getagrip.datasets.synthetic.splits import split

    parts: tuple[SyntheticSplit, ...] = ("train", "test") if source.part == "all" else (source.part,)
    out = []
    for part in parts:
        for category, seed, options in split(part, source.preset):
            name = clip_name(category, seed, options)
            out.append(Sample(name, source.clips / name, partial(_synthesise, category, seed, options)))
    return out


def _synthesise(category: str, seed: int, options: Options, folder: Path) -> None:
    """Make a clip."""
    from getagrip.datasets.synthetic.scene import synthesise

    write_clip(*synthesise(category, seed, options), folder)
