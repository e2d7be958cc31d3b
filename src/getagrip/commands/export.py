"""``getagrip export``: results in other programs' formats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from getagrip.commands.command import ClipsFolder, Command, Results
from getagrip.errors import InputError, UsageError, unknown
from getagrip.io import plugins
from getagrip.io.arguments import Flag, OptionalFolder


def _others(_: str) -> str:
    """Return the formats of other packages, for the help."""
    others = plugins.names("exports")
    return f"(required; of other packages: {', '.join(others)})" if others else "(required)"


@dataclass(frozen=True, kw_only=True)
class Export(Command):
    """Write results in other programs' formats: poses, animated scenes, benchmark files."""

    results: Results
    """Result folders, or folders of results."""
    to: Annotated[str, arg(metavar="FORMAT", help_behavior_hint=_others)] = ""
    """csv: a table of poses; npz: arrays; obj: posed meshes, one per frame; glb: glTF, animated, for Blender and
    browsers; bop: files of the BOP benchmark; usd: a USD stage, animated; mujoco: an MJCF scene to
    replay and to simulate; lerobot: a dataset; spider: keypoint trajectories; dex-retargeting: joints and object
    poses, z up."""
    out: OptionalFolder = None
    """Folder of the exports, each in a folder named as its result's. Otherwise RESULT/export-FORMAT."""
    one_dataset: Flag = False
    """With --to lerobot: --out is a dataset, made or continued, and each result an episode; clips in it are kept."""
    clips: ClipsFolder = None
    """A clip, or the folder that holds the clips by name."""
    overwrite: Flag = False
    """Replace exports that are there already."""

    def check(self) -> None:
        from getagrip.export import FORMATS

        super().check()
        if not self.to:
            raise UsageError(f"missing --to; choose from {', '.join(FORMATS)}")
        if self.to not in FORMATS:
            raise unknown("--to", self.to, FORMATS)
        if self.one_dataset and (self.to != "lerobot" or self.out is None):
            raise UsageError("--one-dataset cannot be used without --to lerobot and --out")
        FORMATS[self.to]  # which raises where it cannot be loaded
        if not self.results:
            raise UsageError("missing RESULT: name at least one result")

    def run(self) -> int:
        """Export results, each into a folder of its own; 1 if any failed, else 0."""
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failure
        from getagrip.commands.evaluate import results_in
        from getagrip.evaluation.results import clip_of
        from getagrip.export import Scene, export
        from getagrip.export.lerobot_dataset import Dataset
        from getagrip.io import files
        from getagrip.io.terminal import say
        from getagrip.result import read_result

        failed, dataset = False, Dataset.of(self.out) if self.one_dataset and self.out is not None else None
        for path in self.results:
            try:
                for folder in results_in(path):
                    if self.out is None and folder != path:
                        files.refuse_link(folder)
                    result, record = read_result(folder)
                    scene = Scene.of(result, clip_of(folder, result, record, self.clips))
                    if dataset is not None:
                        there = scene.name in dataset.clips
                        say(f"{scene.name}: {'there already' if there else f'episode {dataset.add(scene)}'}")
                        continue
                    target = folder / f"export-{self.to}" if self.out is None else self.out / folder.resolve().name
                    say(str(export(scene, target, self.to, self.overwrite)))
            except Exception as error:  # one result's trouble must not end the others
                failed = True
                print_outcome(failure("" if isinstance(error, InputError) else str(path), error), self.debug)
        return int(failed)
