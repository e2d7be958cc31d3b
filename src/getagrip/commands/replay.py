"""``getagrip replay``: how long the simulated hand holds the object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from getagrip.commands.command import ClipsFolder, Command, Results
from getagrip.errors import InputError, UsageError
from getagrip.io.arguments import OptionalFile

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class ReplayResults(Command):
    """Simulate results in MuJoCo: the hand moves as it was reconstructed, the object is let go. Print where it stays.

    Friction, mass and softness are assumed.
    """

    results: Results
    """Result folders, or folders of results. The share of the frames goes into each result.json, for the report."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    json: OptionalFile = None
    """Write the displacement and the simulated pose of each frame here."""

    def check(self) -> None:
        from getagrip.io import extras

        super().check()
        if not self.results:
            raise UsageError("missing RESULT: name at least one result")
        extras.import_extra("mujoco", "mujoco", "replay")

    def run(self) -> int:
        """Simulate results and print in which share of the frames the object stays; 1 if any failed, else 0."""
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failed_outcome
        from getagrip.commands.evaluate import list_result_folders
        from getagrip.io import files

        failed, simulated = False, list[dict[str, object]]()
        for path in self.results:
            try:
                for folder in list_result_folders(path):
                    if folder != path:
                        files.refuse_link(folder)
                    simulated.append(self._replayed(folder))
            except Exception as error:  # one result's trouble must not end the others
                failed = True
                print_outcome(failed_outcome("" if isinstance(error, InputError) else str(path), error), self.debug)
        if self.json is not None:
            files.write_json(self.json, simulated)
        return int(failed)

    def _replayed(self, folder: Path) -> dict[str, object]:
        """Simulate a result, and record and return what came of it."""
        from getagrip.evaluation.metric import REPLAY_STABILITY
        from getagrip.evaluation.results import clip_of
        from getagrip.export import Scene
        from getagrip.export.replay import MAX_STABLE_DISPLACEMENT_M, simulate_replay
        from getagrip.io import files
        from getagrip.io.terminal import print_result
        from getagrip.result import read_result

        result, record = read_result(folder)
        made = simulate_replay(Scene.of(result, clip_of(folder, result, record, self.clips)))
        path = folder / "result.json"
        fields = files.read_json(path)
        files.write_json(
            path, fields | {"metrics": {**(fields.get("metrics") or {}), REPLAY_STABILITY.name: made.stays}}
        )
        share = f"{REPLAY_STABILITY.text(made.stays)} % of {made.free.sum()} frames within {1e3 * MAX_STABLE_DISPLACEMENT_M:g} mm"
        print_result(f"{result.clip}: stays in the hand in {share} ({made.assumed}: guesses)")
        return {
            "clip": result.clip,
            "method": result.method,
            REPLAY_STABILITY.name: made.stays,
            "displacement_m": made.displacement,
            "free": made.free,
            "T_stage_obj": made.T_stage_obj,
            "assumed": made.assumed,
        }
