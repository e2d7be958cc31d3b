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
        extras.load("mujoco", "mujoco", "replay")

    def run(self) -> int:
        """Simulate results and print in which share of the frames the object stays; 1 if any failed, else 0."""
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failure
        from getagrip.commands.evaluate import results_in
        from getagrip.io import files

        failed, simulated = False, list[dict[str, object]]()
        for path in self.results:
            try:
                for folder in results_in(path):
                    if folder != path:
                        files.refuse_link(folder)
                    simulated.append(self._replayed(folder))
            except Exception as error:  # one result's trouble must not end the others
                failed = True
                print_outcome(failure("" if isinstance(error, InputError) else str(path), error), self.debug)
        if self.json is not None:
            files.write_json(self.json, simulated)
        return int(failed)

    def _replayed(self, folder: Path) -> dict[str, object]:
        """Simulate a result, and record and return what came of it."""
        from getagrip.evaluation.metric import REPLAY
        from getagrip.evaluation.results import clip_of
        from getagrip.export import Scene
        from getagrip.export.replay import STAYS, replay
        from getagrip.io import files
        from getagrip.io.terminal import say
        from getagrip.result import read_result

        result, record = read_result(folder)
        made = replay(Scene.of(result, clip_of(folder, result, record, self.clips)))
        path = folder / "result.json"
        fields = files.read_json(path)
        files.write_json(path, fields | {"metrics": {**(fields.get("metrics") or {}), REPLAY.name: made.stays}})
        share = f"{REPLAY.text(made.stays)} % of {made.free.sum()} frames within {1e3 * STAYS:g} mm"
        say(f"{result.clip}: stays in the hand in {share} ({made.assumed}: guesses)")
        return {
            "clip": result.clip,
            "method": result.method,
            REPLAY.name: made.stays,
            "displacement_m": made.displacement,
            "free": made.free,
            "T_stage_obj": made.T_stage_obj,
            "assumed": made.assumed,
        }
