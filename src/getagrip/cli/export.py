"""``getagrip export`` and ``replay``: results in other programs' formats, and in a simulation of the grasp."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from getagrip.cli.command import ClipsFolder, Command, Results, failed_path_outcome
from getagrip.cli.evaluate import list_result_folders
from getagrip.errors import InputError, UsageError, unknown_choice_error
from getagrip.io import files, plugins
from getagrip.io.options import Flag, OptionalFile, OptionalFolder
from getagrip.io.terminal import format_count, print_note, print_result

if TYPE_CHECKING:
    from getagrip.export import Scene
    from getagrip.result import Reconstruction


@dataclass
class Failures:
    """Failures, which are printed and do not end the work on other results."""

    debug: bool
    any: bool = False

    @contextmanager
    def printed(self, path: Path) -> Iterator[None]:
        """Print an exception of the block as the failure of ``path``."""
        from getagrip.batch.clips import print_outcome

        try:
            yield
        except Exception as error:
            self.any = True
            print_outcome(failed_path_outcome(path, error), self.debug)


def _result_folders(paths: Results, failures: Failures) -> list[tuple[Path, Path]]:
    """List each path with the results in it."""
    found = list[tuple[Path, Path]]()
    for path in paths:
        with failures.printed(path):
            found += [(path, folder) for folder in list_result_folders(path)]
    return found


def _read_scene(folder: Path, clips: Path | None) -> tuple[Reconstruction, Scene]:
    from getagrip.export import Scene
    from getagrip.metrics.evaluate.results import clip_of
    from getagrip.result import read_result

    result, record = read_result(folder)
    return result, Scene.of(result, clip_of(folder, result, record, clips))


def _plugin_formats(_: str) -> str:
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
    only_right: Flag = False
    """Leave out results that look wrong or uncertain; with --overwrite their earlier exports are removed. Without
    --only-right they are exported and named, and about.json says what each looks like."""
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
        EXPORT_FORMATS[self.to]  # which raises UsageError for a plug-in that cannot be loaded
        if not self.results:
            raise UsageError("missing RESULT: name at least one result")

    def run(self) -> int:
        """Export results, each into its own folder or as an episode; return 1 if any failed, else 0."""
        from getagrip.export import export
        from getagrip.export.lerobot_dataset import LerobotDataset

        dataset = LerobotDataset.of(self.out) if self.one_dataset and self.out is not None else None
        failures = Failures(self.debug)
        found = _result_folders(self.results, failures)
        if dataset is not None:
            names = {folder: _clip_name(folder) for _, folder in found}
            tests = dataset.tests({*names.values()}, self.test_share)
            found.sort(key=lambda one: names[one[1]] in tests)  # so that each split is one range of episodes
        for path, folder in found:
            with failures.printed(path):
                if self.out is None and folder != path:
                    files.refuse_link(folder)
                _, scene = _read_scene(folder, self.clips)
                target = folder / f"export-{self.to}" if self.out is None else self.out / folder.resolve().name
                if scene.verdict != "right":
                    _flag(scene, self.only_right, target, self.overwrite and dataset is None)
                    if self.only_right:
                        continue
                scene = scene if self.fps is None else scene.even(self.fps)
                if dataset is not None:
                    known, split = scene.name in dataset.clips, "test" if scene.name in tests else "train"
                    episode = "there already" if known else f"episode {dataset.add(scene, split)}, {split}"
                    print_result(f"{scene.name}: {episode}")
                    continue
                with plugins.convert_base_exceptions():
                    made = export(scene, target, self.to, self.overwrite)
                print_result(str(made))
        return int(failures.any)


def _flag(scene: Scene, left_out: bool, target: Path, overwrite: bool) -> None:
    """Print that a result does not look right; if it is left out, remove or name an earlier export of it."""
    from getagrip.export import remove_export

    serious = scene.findings_serious
    why = f", with {format_count(serious, 'serious finding')}" if serious else ""
    looks = f"looks {scene.verdict}" if scene.verdict == "wrong" else "is uncertain"
    earlier = ""
    if left_out and target.is_dir():
        removed = overwrite and remove_export(target)
        earlier = "; an earlier export is removed" if removed else f"; an earlier export stays in {target}"
    print_note(f"{scene.name} {looks}{why}{': left out' if left_out else ''}{earlier}")


def _clip_name(folder: Path) -> str:
    """Return the clip of a result; empty for an unreadable record, which ``run`` reports."""
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
        super().check()
        if not self.results:
            raise UsageError("missing RESULT: name at least one result")
        plugins.import_extra("mujoco", "mujoco", "replay")

    def run(self) -> int:
        """Simulate results and print the share of frames in which the object stays; return 1 if any failed, else 0."""
        failures, simulated = Failures(self.debug), list[dict[str, object]]()
        for path, folder in _result_folders(self.results, failures):
            with failures.printed(path):
                if folder != path:
                    files.refuse_link(folder)
                simulated.append(self._replay(folder))
        if self.json is not None:
            files.write_json(self.json, simulated)
        return int(failures.any)

    def _replay(self, folder: Path) -> dict[str, object]:
        """Simulate a result, print and record the outcome, and return it for ``--json``."""
        from getagrip.export.replay import MAX_STABLE_DISPLACEMENT_M, simulate_replay
        from getagrip.metrics.evaluate.metric import REPLAY_STABILITY

        result, scene = _read_scene(folder, self.clips)
        made = simulate_replay(scene)
        fields = files.read_json(folder / "result.json")
        metrics = {**(fields.get("metrics") or {}), REPLAY_STABILITY.name: made.stays}
        files.write_json(folder / "result.json", fields | {"metrics": metrics})
        near = f"{made.free.sum()} frames within {1e3 * MAX_STABLE_DISPLACEMENT_M:g} mm"
        share = f"{REPLAY_STABILITY.text(made.stays)} % of {near}"
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
