"""``getagrip reconstruct``: find the clips of paths and patterns, reconstruct them, and print a line for each."""

from __future__ import annotations

import glob
import os
import shlex
import sqlite3
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.batch.engine import Engine
from getagrip.batch.job import (
    Job,
    Outcome,
    StreamedJob,
    failed_outcome,
    lost_outcome,
    preload_solver,
    reconstruct_one,
    reconstruct_streamed,
)
from getagrip.batch.ledger import Ledger, ledger_folder
from getagrip.batch.scheduling import WHOLE_SHARD, Shard
from getagrip.batch.summary import failed_path_entry, outcome_entry, write_summary
from getagrip.clip import read_name
from getagrip.errors import GetagripError, InputError, UsageError, escape_unprintable
from getagrip.io import files
from getagrip.io.storage import ARCHIVE_SUFFIX, Place, RemotePath, parse_place
from getagrip.io.terminal import print_note, print_result
from getagrip.result.findings import describe_looks

if TYPE_CHECKING:
    from getagrip.batch.scheduling import BatchOptions, KeepOptions
    from getagrip.fitting.options import Options

RESERVED_NAMES = ("index.html", "summary.csv", "ledger.sqlite", "ledger.sqlite-wal", "ledger.sqlite-shm", "clips")
"""Files beside the results in their folder; clips may not have these names."""
FOLDS_CASE = sys.platform in ("win32", "darwin")
"""Default file systems ignore the case of file names."""


class ClipPlan:
    """The clips of a call in the order in which they were found, in a database on disk: there may be millions."""

    def __init__(self, paths: Sequence[Place], shard: Shard = WHOLE_SHARD) -> None:
        """Find the clips of ``paths`` in a shard; a clip that is named twice counts once."""
        self.failed: list[Outcome] = []
        """Paths without a clip, and clips with the same name: their results would share a folder."""
        self.remote = any(isinstance(path, RemotePath) for path in paths)
        """True if some clips lie in an object store."""
        self._db = sqlite3.connect("")  # in memory, and in a temporary file once it exceeds SQLite's cache
        self._db.execute("CREATE TABLE found (place INTEGER PRIMARY KEY, name TEXT, file TEXT, folder BLOB)")
        for name, clip in _named_clips(paths, self.failed):
            if name not in shard:
                continue
            if name in RESERVED_NAMES:
                self._fail(name, clip, f"another name; {', '.join(RESERVED_NAMES)} are taken")
                continue
            row = (name, name.casefold() if FOLDS_CASE else name, os.fsencode(str(clip)))
            self._db.execute("INSERT INTO found (name, file, folder) VALUES (?, ?, ?)", row)
        self._db.execute("CREATE INDEX by_file ON found (file)")
        self._remove_namesakes()

    def _fail(self, name: str, clip: Place, expected: str) -> None:
        error = InputError(str(clip), "name", files.shorten_value(name), expected)
        self.failed.append(_path_failure(name, clip, error))

    def _remove_namesakes(self) -> None:
        """Remove repetitions of a clip, and all clips that share a name."""
        shared = "SELECT file, min(name) FROM found GROUP BY file HAVING count(*) > 1"
        for file, name in self._db.execute(shared).fetchall():
            clips = dict[Place, tuple[int, Place]]()
            for n, folder in self._db.execute("SELECT place, folder FROM found WHERE file = ? ORDER BY place", (file,)):
                clip = parse_place(os.fsdecode(folder))
                clips.setdefault(clip.resolve() if isinstance(clip, Path) else clip, (n, clip))
            (kept, first), *others = clips.values()
            self._db.execute("DELETE FROM found WHERE file = ? AND (? OR place != ?)", (file, bool(others), kept))
            alike = [clip for _, clip in others]
            for clip, other in zip([first, *alike], [*alike[:1], *[first] * len(alike)], strict=False):
                self._fail(name, clip, f"a name of its own: {other} has the same, and so would their results")

    def __len__(self) -> int:
        (count,) = self._db.execute("SELECT count(*) FROM found").fetchone()
        return int(count)

    def __iter__(self) -> Iterator[tuple[str, Place]]:
        """Yield the name and the folder of each clip."""
        for name, folder in self._db.execute("SELECT name, folder FROM found ORDER BY place"):
            yield name, parse_place(os.fsdecode(folder))

    def __enter__(self) -> ClipPlan:
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()


def clips_by_name(paths: Sequence[Path]) -> tuple[dict[str, Path], list[Outcome]]:
    """Return the folder of each clip by name, and the outcomes of paths without a clip and of clips that share a name.

    A path is a clip, a folder of clips, or a pattern.
    """
    with ClipPlan(paths) as plan:
        return {name: clip for name, clip in plan if isinstance(clip, Path)}, plan.failed


def _path_failure(name: str, clip: Place, error: Exception) -> Outcome:
    whole = clip.absolute() if isinstance(clip, Path) else clip
    return replace(failed_outcome(name, error), path=escape_unprintable(str(whole)))


def _named_clips(paths: Sequence[Place], failed: list[Outcome]) -> Iterator[tuple[str, Place]]:
    """Yield the name and the folder of each clip; other paths are appended to ``failed``."""
    for path in paths:
        try:
            if isinstance(path, RemotePath):
                yield from _clips_in_store(path, failed)
                continue
            for clip in clips_in(path):
                try:
                    yield read_name(clip), clip
                except InputError as error:
                    failed.append(_path_failure(clip.name, clip, error))
        except (InputError, OSError) as error:
            failed.append(_path_failure("", path, error))


def clips_in(path: Path) -> Iterator[Path]:
    """Yield the clip folders of a path: a clip, a folder of clips, or a pattern. Raises ``InputError`` for none."""
    if path.name == "clip.json" or (path / "clip.json").exists():
        yield path.parent if path.name == "clip.json" else path
        return
    if not path.exists() and glob.has_magic(str(path)):
        folders, lack = sorted(glob.iglob(str(path), recursive=True)), "a pattern that no clip matches"
    elif path.is_dir():
        folders, lack = [str(path)], "no clip.json in it or in its folders"
    elif path.suffix == ARCHIVE_SUFFIX and path.is_file():
        address = f"local://{path.absolute()}"
        expected = f"a clip, or a folder of clips; reconstruct reads archives at addresses only, this one at {address}"
        raise InputError(path, "", "an archive", expected)
    else:
        raise InputError(path, "", "no such folder", "a clip, or a folder of clips")
    found = False
    for folder in folders:
        for clip in _clips_in_folder(Path(folder)):
            yield clip
            found = True
    if not found:
        raise InputError(path, "", lack, "a clip, or a folder of clips")


def _clips_in_store(path: RemotePath, failed: list[Outcome]) -> Iterator[tuple[str, RemotePath]]:
    """Yield the clips of an address: a clip, a folder of clips, or a pattern. No clip is read yet.

    A clip gets the name of its folder or archive, since reading all names would take long.
    """
    try:
        found = _folders_in_store(path)
    except UsageError:
        raise
    except GetagripError as error:  # the store cannot be reached
        raise UsageError(f"CLIP: {error}") from error
    if not found:
        raise InputError(path.url, "", "no folder or archive in it", "a clip, a folder of clips, or a pattern")
    for clip in found:
        name = clip.name.removesuffix(ARCHIVE_SUFFIX)
        if files.is_portable_name(name):
            yield name, clip
        else:
            got = f"the name {files.shorten_value(clip.name)}"
            failed.append(_path_failure("", clip, InputError(clip.url, "", got, "a name that can name a folder")))


def _folders_in_store(path: RemotePath) -> list[RemotePath]:
    if glob.has_magic(path.url):
        return path.matches()
    if path.name.endswith(ARCHIVE_SUFFIX):
        return [path]
    if path.name == "clip.json":
        return [path.parent]
    children = path.children()
    if ("clip.json", False) in children:
        return [path]
    return [path / name for name, is_folder in children if is_folder or name.endswith(ARCHIVE_SUFFIX)]


def _clips_in_folder(path: Path) -> Iterator[Path]:
    """Yield the folder itself if it is a clip, else the clips in it, sorted."""
    if (path / "clip.json").exists():
        yield path
    elif path.is_dir():
        yield from (path / name for name in sorted(os.listdir(path)) if (path / name / "clip.json").exists())


def reconstruct_clips(paths: Sequence[Place], out: Place, options: Options, batch: BatchOptions, debug: bool) -> int:
    """Reconstruct clips into ``out/<clip name>/`` and print their outcomes. Returns 1 if a clip failed, else 0.

    ``batch.strict`` also returns 1 for a serious finding or an improbable result. Calls may share a folder, at the
    same time too: its ledger assigns the clips. A summary of several clips is written, also after an interrupt. Raises
    ``UsageError`` without paths, or where ``--keep`` would drop every result; ``GetagripError`` where the ledger
    cannot be written.
    """
    if not paths:
        raise UsageError("missing CLIP: name at least one clip")
    batch.keep.check(options)
    share = batch.share
    with ClipPlan(paths, share.shard) as plan:
        for outcome in plan.failed:
            print_outcome(outcome, debug)
        if not len(plan) or (share.fail_fast and plan.failed):
            return 1 if plan.failed else 0
        with Ledger(ledger_folder(out, share.ledger)) as ledger:
            if ledger.path.parent != out:
                print_note(f"{out}: its ledger is {ledger.path}")
            for folder in files.remove_stale_folders(out) if isinstance(out, Path) else ():
                print_note(f"{folder}: removed, unfinished work of a process that has died")
            ledger.expect((name for name, _ in plan), map(failed_path_entry, plan.failed))
            many = len(plan) + len(plan.failed) > 1
            try:
                tally = _run_jobs(plan, ledger, out, options, batch, debug)
            except KeyboardInterrupt:
                if many:
                    _summarise(ledger, out, batch.keep)
                where = [str(out), *(["--ledger", str(share.ledger)] if share.ledger else [])]
                print_note(f"progress: getagrip status {shlex.join(where)}")
                raise
            if many:
                _summarise(ledger, out, batch.keep)
    tally.counts["failed"] += len(plan.failed)
    if len(tally) > 1:
        tally.print()
    if tally.verdicts and batch.keep.keep is not None:
        print(batch.keep.summary(tally.verdicts))
    if sys.stdout.isatty() and tally.counts["done"] + tally.counts["kept"]:
        print(f"look at it with: getagrip view {shlex.quote(str(out))}, or getagrip report")
    return 1 if tally.counts["failed"] or (batch.strict and not tally.passes(batch.min_probability)) else 0


def _summarise(ledger: Ledger, out: Place, keep: KeepOptions) -> None:
    for path in write_summary(ledger, out, keep):
        print_result(str(path))


class _Tally:
    """Counts of a call's clips by outcome."""

    def __init__(self) -> None:
        self.counts = Counter[str]()
        self.flagged: list[str] = []
        """Names of clips with serious findings."""
        self.right: dict[str, float] = {}
        self.right_in_camera: dict[str, float] = {}
        """Probability that the result is right, by clip."""
        self.looks: dict[str, str] = {}
        """Probable appearance of drafts and of results with an assumed mesh, by clip."""
        self.extrapolated: set[str] = set()
        """Names of results of an assumed mesh whose probability is not calibrated for it."""
        self.verdicts: dict[str, str] = {}
        """Verdict of ``--keep``, by clip: kept or dropped."""

    def add(self, outcome: Outcome, keep: KeepOptions) -> None:
        if outcome.state != "failed":
            self.verdicts[outcome.name] = keep.verdict(outcome.probability_right, outcome.probability_right_in_camera)
        self.counts[outcome.state] += 1
        self.flagged += [outcome.name] * any(finding.serious for finding in outcome.findings)
        if outcome.probability_right is not None:
            self.right[outcome.name] = outcome.probability_right.value
            if outcome.probability_right.by_eye:
                self.extrapolated.add(outcome.name)
            if looks := describe_looks(outcome.probability_right, outcome.probability_looks_right):
                self.looks[outcome.name] = looks.partition(" (")[0]
        if outcome.probability_right_in_camera is not None:
            self.right_in_camera[outcome.name] = outcome.probability_right_in_camera.value

    def __len__(self) -> int:
        return self.counts.total()

    def passes(self, min_probability: float) -> bool:
        return not self.flagged and all(right >= min_probability for right in self.right.values())

    def print(self) -> None:
        print(f"{self.counts['done']} done, {self.counts['kept']} already done, {self.counts['failed']} failed")
        if self.flagged:
            print(f"{len(self.flagged)} with serious findings: {', '.join(sorted(self.flagged))}")
        for by_eye, count in sorted(Counter(self.looks.values()).items()):
            named = ", ".join(name for name in self.looks if self.looks[name] == by_eye)
            print(f"{count} of {len(self.looks)} by eye: {by_eye}: {named}")
        for where, right in (("hand", self.right), ("camera", self.right_in_camera)):
            if known := {name: value for name, value in right.items() if name not in self.extrapolated}:
                print(expected_right_message(known, f"right in the {where}"))


def _run_jobs(plan: ClipPlan, ledger: Ledger, out: Place, options: Options, batch: BatchOptions, debug: bool) -> _Tally:
    """Reconstruct the clips and print their outcomes."""
    streamed = isinstance(out, RemotePath) or plan.remote
    make: Callable[..., Job | StreamedJob] = StreamedJob if streamed else Job
    work: Callable[..., Outcome] = reconstruct_streamed if streamed else reconstruct_one
    per_clip = {"options": options, "overwrite": batch.overwrite, "threads": batch.threads}
    jobs = (make(name, clip, out / name, **per_clip) for name, clip in plan)
    engine: Engine[Job | StreamedJob, Outcome] = Engine(
        work=work, lost=lost_outcome, entry=partial(outcome_entry, method=options.method, seed=options.seed),
        options=asdict(options), prepare=preload_solver,
    )  # fmt: skip
    tally = _Tally()
    with closing(batch.share.ended(engine, jobs, len(plan), ledger, "clips", stages=True)) as outcomes:
        for outcome in outcomes:
            print_outcome(outcome, debug)
            tally.add(outcome, batch.keep)
            if batch.share.fail_fast and outcome.state == "failed":
                print_note("--fail-fast: the other clips are skipped")
                break
    return tally


def expected_right_message(right: Mapping[str, float], what: str = "right in the hand") -> str:
    """Describe the expected number of right results and the probably wrong ones, from probabilities by name."""
    wrong = sorted((name for name in right if right[name] < 0.5), key=lambda name: right[name])
    named = f"; likely wrong, worst first: {', '.join(wrong)}" if wrong else ""
    return f"about {sum(right.values()):.0f} of {len(right)} are {what}, by their probabilities{named}"


def print_outcome(outcome: Outcome, debug: bool) -> None:
    """Print one line for a clip and one for each finding: failures on stderr, the rest on stdout."""
    failed = outcome.state == "failed"
    parts = ["failed"] * failed + [outcome.name] * bool(outcome.name) + [outcome.message]
    print(escape_unprintable(": ".join(parts)), file=sys.stderr if failed else sys.stdout)
    for finding in outcome.findings:
        print(f"  {finding}")
    if failed and debug:
        print(escape_unprintable(outcome.trace, "\n"), file=sys.stderr)
