"""``getagrip demo``: a synthetic clip, from hands, masks and a mesh to the page of its result."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.cli.command import Command
from getagrip.io.options import Flag, Folder, OptionalFolder

if TYPE_CHECKING:
    from getagrip.clip import Clip

DEMO_CATEGORY, DEMO_SEED = "mug", 2
N_DEMO_THREADS = 2
"""Number of threads above which the time hardly falls."""


@dataclass(frozen=True, kw_only=True)
class Demo(Command):
    """Make a clip, reconstruct it, evaluate it, and draw a report."""

    out: Folder = Path("out/demo")
    """Folder of the clip, the result, report.png and report.html."""
    video: Flag = False
    """Begin at pixels: render a video, find hand and object in it as draft does, and print the errors of each stage.
    This needs getagrip doctor --fetch hands."""
    models: OptionalFolder = None
    """With --video: folder of the hand models (default: the cache)."""

    def run(self) -> int:
        """Write the clip to ``out/clips/``, and the result to ``out/<clip name>/``.

        An earlier demo's clip is used again, its result and report are replaced. Raises ``UsageError`` for other files
        at these places.
        """
        if self.video:
            from getagrip.cli.demo_video import run_demo_video

            return run_demo_video(DEMO_CATEGORY, DEMO_SEED, self.out, self.models)
        from getagrip.clip import input_sha256, read_masks
        from getagrip.compiling import COMPILATION_MESSAGE, compile_once
        from getagrip.io import files
        from getagrip.io.terminal import console, progress_bar
        from getagrip.metrics.evaluate import evaluate, results_table
        from getagrip.reconstruct import reconstruct
        from getagrip.report.pages import write_page
        from getagrip.report.pictures.result_picture import write_report
        from getagrip.report.pictures.result_view import View
        from getagrip.result import read_result_record, write_result

        screen = console()
        compile_once(lambda: screen.print(COMPILATION_MESSAGE))
        with progress_bar() as bar:
            steps = bar.add_task("make a clip", total=4.0)
            clip = _make_demo_clip(files.folder_inside(self.out, "clips"))
            masks = read_masks(clip)
            screen.print(f"clip     {clip.origin}: a {clip.category} in a {clip.side} hand, {len(clip)} frames")

            bar.update(steps, completed=1.0, description="reconstruct")

            def shown(stage: str, part: float) -> None:
                bar.update(steps, completed=1.0 + part, description=stage)

            result = reconstruct(clip, masks, progress=shown, threads=N_DEMO_THREADS)
            screen.print(f"found    in {result.seconds['total']:.2f} s; {result.message}")

            bar.update(steps, completed=2.0, description="evaluate")
            evaluation = evaluate(result, clip, masks)
            folder = self.out / clip.name
            write_result(result, folder, input_sha256(clip.origin), evaluation.metrics, clip.origin, overwrite=True)
            screen.print(f"result   {folder}")

            bar.update(steps, completed=3.0, description="draw the report")
            report = write_report(result, clip, masks, self.out / "report.png", evaluation.metrics)
            view, record = View.of(result, clip, masks), read_result_record(folder)
            page = write_page(view, evaluation, record, self.out / "report.html")
            screen.print(f"report   {report} and, to be opened in a browser, {page}\n")
        screen.print(results_table([evaluation]))
        return 0


def _make_demo_clip(folder: Path) -> Clip:
    """Return the demo's clip, made unless an earlier demo has written it."""
    from getagrip.clip import read_clip, write_clip
    from getagrip.synthetic import scene_options
    from getagrip.synthetic.noise import perturbed
    from getagrip.synthetic.scene import clip_name, ground_truth_masks, make_scene, render_pictures

    options = scene_options.DEMO_SCENE_OPTIONS
    made = folder / clip_name(DEMO_CATEGORY, DEMO_SEED, options)
    if not made.exists():
        scene = make_scene(DEMO_CATEGORY, DEMO_SEED, options)
        write_clip(*perturbed(scene.clip, ground_truth_masks(scene), options, DEMO_SEED), made, render_pictures(scene))
    return read_clip(made)
