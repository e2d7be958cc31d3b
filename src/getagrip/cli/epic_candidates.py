"""``getagrip epic candidates``: intervals of EPIC-KITCHENS that may hold further stable grasps."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from getagrip.cli.command import Command
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.options import File, Folder, OptionalFile
from getagrip.io.terminal import format_count, progress_bar

if TYPE_CHECKING:
    from getagrip.readers.datasets.epic import epic_tables

Category = Literal["bottle", "bowl", "can", "cup", "glass", "mug", "pan", "plate", "saucepan"]
CANDIDATE_COLUMNS = ("vid", "st_bound", "ed_bound", "contact", "handside", "cat", "hos_name", "mp4_name")
"""Columns of the table of candidates: EPIC-Grasps' columns except those for the annotator."""


@dataclass(frozen=True, kw_only=True)
class EpicCandidates(Command):
    """List candidates of stable grasps in EPIC-KITCHENS: intervals in which, by VISOR, a hand touches an object."""

    visor: Folder
    """Folder with VISOR's sparse annotations and its frame_mapping.json, at any depth."""
    actions: Annotated[tuple[Path, ...], arg(metavar="CSV...")]
    """EPIC-100's action labels: EPIC_100_train.csv, EPIC_100_validation.csv."""
    categories: Annotated[tuple[Category, ...], arg(help_behavior_hint="(default: all)")] = ()
    """Kinds of objects."""
    out: File
    """Table to write (CSV)."""
    json: OptionalFile = None
    """Write all data of the candidates here."""

    def check(self) -> None:
        files.check_file("--out", self.out)
        if self.json is not None:
            files.check_file("--json", self.json)

    def run(self) -> int:
        """Write candidates of stable grasps as a table and as JSON; return 1 if a video could not be read, else 0.

        Raises ``UsageError`` without labels, ``InputError`` for malformed labels and a folder without VISOR's files.
        """
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failed_outcome
        from getagrip.readers.datasets.epic import epic_tables, visor

        if not self.actions:
            raise UsageError("missing --actions: name EPIC_100_train.csv or EPIC_100_validation.csv, or both")
        actions = epic_tables.read_actions(self.actions)
        found, failed, unlabelled = list[epic_tables.Candidate](), 0, 0
        videos, mapping = visor.find_visor_files(self.visor), visor.find_mapping(self.visor)
        if mapping is None:
            print(visor.NO_FRAME_MAPPING_NOTE, file=sys.stderr)
        with progress_bar() as bar:
            task = bar.add_task("videos", total=len(videos))
            for video, paths in videos.items():
                try:
                    sparse = [path for path in paths if not visor.is_dense(path)]  # dense annotations lack contacts
                    frames = (frame for path in sparse for frame in visor.read_frames(path))
                    touching = epic_tables.contacts(frames, visor.read_mapping(mapping, video))
                    found += epic_tables.find_candidates(video, touching, actions.get(video, []))
                    unlabelled += video not in actions
                except InputError as error:
                    print_outcome(failed_outcome(video, error), self.debug)
                    failed += 1
                bar.advance(task)
        chosen = [candidate for candidate in found if not self.categories or candidate.category in self.categories]
        _write_candidates(self.out, chosen)
        if self.json is not None:
            rows = [asdict(candidate) | {"seconds": candidate.seconds, "name": candidate.name} for candidate in chosen]
            files.write_json(self.json, rows)
        for category, count in sorted(Counter(candidate.category for candidate in chosen).items()):
            print(f"{category}: {count}")
        if unlabelled:
            print(f"{unlabelled} of {len(videos)} videos have no labelled actions: skipped", file=sys.stderr)
        print(
            f"{self.out}: {format_count(len(chosen), 'candidate')} from {format_count(len(videos) - failed, 'video')}"
        )
        return 1 if failed else 0


def _write_candidates(path: Path, found: Sequence[epic_tables.Candidate]) -> None:
    """Write candidates as a table with ``CANDIDATE_COLUMNS``, with the contact -1 for several, as in EPIC-Grasps."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows: list[Sequence[object]] = [CANDIDATE_COLUMNS]
    for one in found:
        contact = one.contacts[0] if len(one.contacts) == 1 else -1
        named = f"{one.side} hand", one.category, one.entity, f"{one.name}.mp4"
        rows.append((one.video, one.start_bound, one.end_bound, contact, *named))
    files.write_csv(path, rows)
