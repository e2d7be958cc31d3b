"""``getagrip export``: results in other programs' formats.

``getagrip replay``: how long the simulated hand holds the object.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from getagrip.cli.command import ClipsFolder, Command, Results
from getagrip.errors import InputError, UsageError, unknown_choice_error
from getagrip.io import plugins
from getagrip.io.options import Flag, OptionalFile, OptionalFolder

if TYPE_CHECKING:
    from pathlib import Path


def _plugin_formats(_: str) -> str:
    """Return the formats of other packages, for the help."""
    others = plugins.plugin_names("exports")
    return f"(required; of other packages: {', '.join(others)})" if others else "(required)"


@dataclass(frozen=True, kw_only=True)
class Export(Command):
    """Write results in other programs' formats: poses, animated scenes, benchmark files."""

    results: Results
    """Result folders, or folders of results."""
    to: Annotated[str, arg(metavar="FORMAT", help_behavior_hint=_plugin_formats)] = ""
    """csv: a table of poses; npz: arrays; obj: posed meshes, one per frame; glb: glTF, animated, for Blender and
    browsers; bop: files of the BOP benchmark; usd: a USD stage, animated; mujoco: an MJCF scene to
    replay and to simulate; lerobot: a dataset; mcap: a log for Foxglove; spider: keypoint trajectories;
    dex-retargeting: joints and object poses, z up."""
    out: OptionalFolder = None
    """Folder of the exports, each in a folder named as its result's. Otherwise RESULT/export-FORMAT."""
    one_dataset: Flag = False
    """With --to lerobot: --out is a dataset, made or continued, and each result an episode; clips in it are kept."""
    test_share: float = 0.0
    """With --one-dataset: share of the clips that are for tests, chosen by their names; the others are for training."""
    fps: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="(default: as the clip)")] = None
    """Resample to this rate, evenly [frames per second]: poses are interpolated, images are the nearest ones."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    overwrite: Flag = False
    """Replace exports that are there already."""

    def check(self) -> None:
        from getagrip.export import EXPORT_FORMATS

        super().check()
        if not self.to:
            raise UsageError(f"missing --to; choose from {', '.join(EXPORT_FORMATS)}")
        if self.to not in EXPORT_FORMATS:
            raise unknown_choice_error("--to", self.to, EXPORT_FORMATS)
        if self.one_dataset and (self.to != "lerobot" or self.out is None):
            raise UsageError("--one-dataset cannot be used without --to lerobot and --out")
        if not 0.0 <= self.test_share <= 1.0:
            raise UsageError(f"--test-share must be 0 to 1 (got {self.test_share:g})")
        if self.test_share and not self.one_dataset:
            raise UsageError("--test-share cannot be used without --one-dataset")
        if self.fps is not None and not 0.1 <= self.fps <= 1000.0:
            raise UsageError(f"--fps must be 0.1 to 1000 frames per second (got {self.fps:g})")
        EXPORT_FORMATS[self.to]  # which raises where it cannot be loaded
        if not self.results:
            raise UsageError("missing RESULT: name at least one result")

    def run(self) -> int:
        """Export results, each into a folder of its own; 1 if any failed, else 0."""
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failed_outcome
        from getagrip.cli.evaluate import list_result_folders
        from getagrip.export import Scene, export
        from getagrip.export.lerobot_dataset import LerobotDataset
        from getagrip.io import files, plugins
        from getagrip.io.terminal import print_result
        from getagrip.metrics.evaluate.results import clip_of
        from getagrip.result import read_result

        dataset = LerobotDataset.of(self.out) if self.one_dataset and self.out is not None else None
        found, failed = list[tuple[Path, Path]](), False

        def trouble(path: Path, error: Exception) -> None:
            nonlocal failed
            failed = True
            print_outcome(failed_outcome("" if isinstance(error, InputError) else str(path), error), self.debug)

        for path in self.results:
            try:
                found += [(path, folder) for folder in list_result_folders(path)]
            except Exception as error:  # one result's trouble must not end the others
                trouble(path, error)
        if dataset is not None:
            names = {folder: _clip_name(folder) for _, folder in found}
            tests = dataset.tests({*names.values()}, self.test_share)
            found.sort(key=lambda one: names[one[1]] in tests)  # so that each split is one range of episodes
        for path, folder in found:
            try:
                if self.out is None and folder != path:
                    files.refuse_link(folder)
                result, record = read_result(folder)
                scene = Scene.of(result, clip_of(folder, result, record, self.clips))
                scene = scene if self.fps is None else scene.even(self.fps)
                if dataset is not None:
                    there, split = scene.name in dataset.clips, "test" if scene.name in tests else "train"
                    said = "there already" if there else f"episode {dataset.add(scene, split)}, {split}"
                    print_result(f"{scene.name}: {said}")
                    continue
                target = folder / f"export-{self.to}" if self.out is None else self.out / folder.resolve().name
                with plugins.convert_base_exceptions():
                    made = export(scene, target, self.to, self.overwrite)
                print_result(str(made))
            except Exception as error:
                trouble(path, error)
        return int(failed)


def _clip_name(folder: Path) -> str:
    """Return the clip of a result; empty where its record cannot be read, which is said later."""
    from getagrip.result import read_result_record

    try:
        return str(read_result_record(folder)["clip"])
    except (InputError, OSError):
        return ""


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
        from getagrip.io import plugins

        super().check()
        if not self.results:
            raise UsageError("missing RESULT: name at least one result")
        plugins.import_extra("mujoco", "mujoco", "replay")

    def run(self) -> int:
        """Simulate results and print in which share of the frames the object stays; 1 if any failed, else 0."""
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failed_outcome
        from getagrip.cli.evaluate import list_result_folders
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
        from getagrip.export import Scene
        from getagrip.export.replay import MAX_STABLE_DISPLACEMENT_M, simulate_replay
        from getagrip.io import files
        from getagrip.io.terminal import print_result
        from getagrip.metrics.evaluate.metric import REPLAY_STABILITY
        from getagrip.metrics.evaluate.results import clip_of
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
