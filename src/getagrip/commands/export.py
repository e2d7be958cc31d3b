"""``getagrip export``: results in other programs' formats."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from getagrip.batch.clips import print_outcome
from getagrip.batch.job import failure
from getagrip.commands.evaluate import results_in
from getagrip.errors import InputError
from getagrip.evaluation.results import clip_of
from getagrip.export import Scene, export
from getagrip.io import files
from getagrip.io.terminal import say
from getagrip.result import read_result


def export_results(
    paths: Sequence[Path], to: str, out: Path | None, clips: Path | None, overwrite: bool, debug: bool
) -> int:
    """Export results, each into ``out/<name of its folder>``, or into a folder of its own; 1 if any failed, else 0."""
    failed = False
    for path in paths:
        try:
            for folder in results_in(path):
                if out is None and folder != path:
                    files.refuse_link(folder)
                result, record = read_result(folder)
                scene = Scene.of(result, clip_of(folder, result, record, clips))
                target = folder / f"export-{to}" if out is None else out / folder.resolve().name
                say(str(export(scene, target, to, overwrite)))
        except Exception as error:  # one result's trouble must not end the others
            failed = True
            print_outcome(failure("" if isinstance(error, InputError) else str(path), error), debug)
    return int(failed)
