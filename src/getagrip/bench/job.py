"""Hands of several estimators for the same clips, on the frames that all of them have (the paper's Table 4).

The base of every benchmark: a trial of each clip, in any process, and the page of their scores.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.batch.job import Outcome, failed_outcome
from getagrip.batch.ledger import LedgerEntry
from getagrip.bench.ablations import Ablation, Setting
from getagrip.bench.inputs.perturbations import Change
from getagrip.bench.sources import Sample
from getagrip.clip import Clip, HandTrack, Masks, read_clip
from getagrip.clip.read_arrays import check_in_view, check_intrinsics, read_hand
from getagrip.errors import InputError, UsageError
from getagrip.io import arrays, files
from getagrip.io.files import Json, is_portable_name, shorten_value
from getagrip.io.terminal import console

if TYPE_CHECKING:
    from rich.table import Table

    from getagrip.bench.comparison import ComparisonTable


@dataclass(frozen=True)
class ClipScores:
    """The scores of a clip; ``failed_outcome`` says why there are none."""

    name: str
    failure: str = field(default="", kw_only=True)
    trace: str = field(default="", kw_only=True)
    again: str = field(default="", kw_only=True)
    """Why it was made again, where what was there is no longer good."""


S = TypeVar("S", bound=ClipScores)


@dataclass(frozen=True)
class Trial(Generic[S]):
    """A clip of a benchmark, and what is done with it."""

    sample: Sample
    results: Path
    """The folder that keeps what is made, by its name in it."""
    overwrite: bool

    @property
    def name(self) -> str:
        """The clip's."""
        return self.sample.name

    def scores(self) -> S:
        """Do it, as far as that has not been done by the same code; the clip is there. Raises any error."""
        raise NotImplementedError

    def failed(self, why: str, trace: str = "") -> S:
        """Make the scores of a clip that could not be done."""
        raise NotImplementedError


def run_trial(trial: Trial[S]) -> S:
    """Score a clip, which is made where it is not there yet; failures are returned, not raised. Raises nothing."""
    sample = trial.sample
    try:
        if sample.make is not None and not sample.folder.exists():
            sample.make(sample.folder)
        return trial.scores()
    except Exception as error:  # one clip's trouble must not end the others
        outcome = failed_outcome(sample.name, error)
        return trial.failed(outcome.message, outcome.trace)


def failure_of(trial: Trial[S], why: str) -> S:
    """Make the scores of a clip that no process could do."""
    return trial.failed(why)


class Benchmark(Generic[S]):
    """A benchmark: the trial of every clip, and the page of the scores.

    Made before anything is read: calls are checked.
    """

    def trials(self, samples: Sequence[Sample], results: Path, overwrite: bool) -> list[Trial[S]]:
        """Make a trial for each clip."""
        raise NotImplementedError

    def page(self, scores: Sequence[S]) -> BenchmarkPage | None:
        """Make the page of all clips' scores; None where there are none."""
        raise NotImplementedError

    def failures(self, scores: S) -> list[Outcome]:
        """Return the failures of a clip."""
        return [Outcome(scores.name, "failed", scores.failure, scores.trace)] if scores.failure else []

    def line(self, scores: S) -> str:
        """Describe the trial of a clip in words; empty where that needs none."""
        return f"{scores.name}: done again, since {scores.again}" if scores.again else ""

    def entry(self, scores: S) -> LedgerEntry:
        """Make the ledger's entry of a clip."""
        return LedgerEntry("", "failed" if scores.failure else "done", scores.failure)


@dataclass(frozen=True)
class BenchmarkPage:
    """Tables on the screen and as files."""

    name: str
    """How the files' names begin."""
    shown: str | Table
    texts: Mapping[str, str]
    """By the end of a file's name, as ".md"."""
    rows: Mapping[str, Sequence[Sequence[object]]]
    """Rows of CSV files, the heading first, unrounded; by the end of a file's name."""
    content: Json
    """Every number, for --json."""
    plotted: tuple[ComparisonTable, str] | None = None
    """Table of a plot, and its title."""

    def write(self, out: Path, json: Path | None) -> list[Path]:
        """Show it, and write its files into a folder, and ``json``; returns them."""
        if isinstance(self.shown, str):
            print(self.shown, end="")
        else:
            console().print(self.shown)
        written = []
        for end, lines in self.rows.items():
            written.append(out / f"{self.name}{end}")
            files.write_csv(written[-1], lines)
        for end, text in self.texts.items():
            written.append(out / f"{self.name}{end}")
            files.write_text(written[-1], text)
        if self.plotted is not None:
            from getagrip.bench.comparison import plot_ablation

            written.append(out / f"{self.name}.png")
            plot_ablation(*self.plotted, written[-1])
        if json is not None:
            files.write_json(json, self.content)
            written.append(json)
        return written


MIN_COMMON_FRAMES = 2
"""Frames that all sources must have."""


@dataclass(frozen=True)
class HandSource:
    """A folder that holds the hands of clips by their names: as clips ``NAME/``, or as hand files ``NAME.npz``."""

    name: str
    folder: Path

    @staticmethod
    def of(text: str) -> HandSource:
        """Parse ``NAME=FOLDER``. Raises ``UsageError``."""
        name, equals, folder = text.partition("=")
        if not (equals and folder and is_portable_name(name)):
            raise UsageError(f"--hands must be NAME=FOLDER (got {text!r})")
        if not Path(folder).is_dir():
            raise UsageError(f"--hands must be a folder with clips, or with a .npz for each (got {text!r})")
        return HandSource(name, Path(folder))

    def file(self, clip: str) -> Path:
        """Return the file with the hands of a clip. Raises ``InputError`` where there is none."""
        places = [self.folder / clip / "hand.npz", self.folder / f"{clip}.npz"]
        found = next((place for place in places if place.is_file()), None)
        if found is None:
            raise InputError(
                self.folder, "", f"no {clip}/hand.npz and no {clip}.npz", f"{self.name}'s hands of the clip"
            )
        return found

    def read(self, clip: Clip) -> SourceHands:
        """Read its hands of a clip. Raises ``InputError`` where there are none, or where they are not of this clip."""
        path = self.file(clip.name)
        if path.name == "hand.npz":
            other = read_clip(path.parent)
            for key in ("side", "size"):
                if getattr(other, key) != getattr(clip, key):
                    raise InputError(
                        path.parent / "clip.json", key, shorten_value(getattr(other, key)), f"{getattr(clip, key)}"
                    )
            return SourceHands(path, other.hand, other.frames, other.K)
        about = arrays.read(path, {"frames", "K", "side"}.__contains__)
        side = about.get("side")
        if side is not None and str(side) != clip.side:
            raise InputError(path, "side", shorten_value(side.tolist()), clip.side)
        numbers, K = arrays.frame_numbers(path, about), None
        frames = clip.frames if numbers is None else _frame_names(numbers, clip)
        if "K" in about:
            K = np.tile(arrays.floats(path, about, "K", (3, 3)), (len(frames), 1, 1))
            check_intrinsics(path, K, clip.size)
        return SourceHands(path, read_hand(path, len(frames)), frames, K)


@dataclass(frozen=True)
class SourceHands:
    """The hands of a clip by one source."""

    file: Path
    track: HandTrack
    frames: Sequence[str]
    """Names of the frames that it has."""
    K: Float[ndarray, "T 3 3"] | None
    """The camera that they are before; None: the clip's."""

    def in_clip(self, clip: Clip) -> Clip:
        """Return the clip with these hands instead of its own. Raises ``InputError`` where they do not fit."""
        if clip.truth is not None and not np.array_equal(clip.hand.faces, self.track.faces):
            expected = "the ground truth's hand, whose vertices true contact is measured at"
            raise InputError(self.file, "faces", f"a hand of {self.track.vertices.shape[1]} vertices", expected)
        rows = np.array([self.frames.index(name) for name in clip.frames])
        hand = self.track.take(rows)
        K = clip.K if self.K is None else self.K[rows]
        check_in_view(self.file, hand, K, clip.size)
        return replace(clip, hand=hand, K=K)


@dataclass(frozen=True)
class WithHands(Change):
    """The clip with the hands of a source, at the frames that all sources have."""

    other_hands: ClassVar[bool] = True
    source: HandSource
    sources: tuple[HandSource, ...]

    def __call__(self, clip: Clip, masks: Masks, seed: int) -> tuple[Clip, Masks]:
        found = {source: source.read(clip) for source in self.sources}
        common = reduce(set.intersection, ({*hands.frames} for hands in found.values()), {*clip.frames})
        if len(common) < MIN_COMMON_FRAMES:
            got = f"{len(common)} of the {len(clip)} frames of {clip.name} in {' and '.join(s.name for s in found)}"
            raise InputError(
                found[self.source].file, "frames", got, f"{MIN_COMMON_FRAMES} frames at least that all of them have"
            )
        index = np.array([n for n, name in enumerate(clip.frames) if name in common])
        return found[self.source].in_clip(clip.take(index)), masks.take(index)

    def inputs(self, clip: str) -> Mapping[str, Path]:
        return {source.name: source.file(clip) for source in self.sources}


def hand_source_ablation(sources: Sequence[HandSource]) -> Ablation:
    """Make hand sources the settings of an ablation; the first is what the others are compared with.

    Raises ``UsageError`` where two have the same name.
    """
    names = [source.name for source in sources]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"--hands must be different names (got {twice} twice)")
    settings = tuple(Setting(source.name, change=WithHands(source, tuple(sources))) for source in sources)
    return Ablation("Hands, on the frames that all of them have", names[0], settings)


def _frame_names(numbers: tuple[int, ...], clip: Clip) -> tuple[str, ...]:
    """Return the clip's names of the numbered frames of a hand file; numbers stand for frames that it does not have."""
    name_of = {int(name): name for name in clip.frames if name.isdecimal()}
    return tuple(name_of.get(number, f"{number}") for number in numbers)
