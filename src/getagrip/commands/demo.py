"""``getagrip demo``: the whole way on a synthetic clip, from hands, masks and a mesh to a page that plays it."""

from __future__ import annotations

from pathlib import Path

from getagrip.clip import Clip, input_sha256, read_clip, read_masks, write_clip
from getagrip.datasets.synthetic.noise import perturbed
from getagrip.datasets.synthetic.scene import clip_name, ground_truth_masks, make_scene, pictures
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.evaluation import evaluate, results_table
from getagrip.fitting.reconstruct import reconstruct
from getagrip.io import files
from getagrip.io.terminal import console, progress_bar
from getagrip.pages import write_page
from getagrip.pictures.report import write_report
from getagrip.pictures.shown import View
from getagrip.result import read_record, write_result

CATEGORY, SEED = "mug", 2
CLIP = SceneOptions(hand_jitter_deg=0.5, hand_jitter_mm=0.5, mask_ragged_px=0.7)
"""Small noise on hands and masks; everything else as usual: 30 frames, 1-DoF motion with a small residual."""
THREADS = 2
"""More gain little."""


def run(out: Path) -> None:
    """Make a clip, reconstruct it, print its metrics against the ground truth, and draw
    ``out/report.png`` and ``out/report.html``.

    The clip goes to ``out/clips/``, the result to ``out/<clip name>/``. What an earlier demo left there is used again
    (the clip) or replaced (result and report). Raises ``UsageError`` where something else is in the way.
    """
    screen = console()
    with progress_bar() as bar:
        steps = bar.add_task("make a clip", total=4.0)
        clip = _clip(files.folder_inside(out, "clips"))
        masks = read_masks(clip)
        screen.print(f"clip     {clip.origin}: a {clip.category} in a {clip.side} hand, {len(clip)} frames")

        bar.update(steps, completed=1.0, description="reconstruct")

        def shown(stage: str, part: float) -> None:
            bar.update(steps, completed=1.0 + part, description=stage)

        result = reconstruct(clip, masks, progress=shown, threads=THREADS)
        screen.print(f"found    in {result.seconds['total']:.2f} s; {result.status}")

        bar.update(steps, completed=2.0, description="evaluate")
        evaluation = evaluate(result, clip, masks)
        folder = out / clip.name
        write_result(result, folder, input_sha256(clip.origin), evaluation["metrics"], clip.origin, overwrite=True)
        screen.print(f"result   {folder}")

        bar.update(steps, completed=3.0, description="draw the report")
        report = write_report(result, clip, masks, out / "report.png", evaluation["metrics"])
        page = write_page(View.of(result, clip, masks), evaluation, read_record(folder), out / "report.html")
        screen.print(f"report   {report} and, to be opened in a browser, {page}\n")
    screen.print(results_table([evaluation]))


def _clip(folder: Path) -> Clip:
    """The demo's clip, made and written unless it is there from an earlier time."""
    there = folder / clip_name(CATEGORY, SEED, CLIP)
    if not there.exists():
        scene = make_scene(CATEGORY, SEED, CLIP)
        write_clip(*perturbed(scene.clip, ground_truth_masks(scene), CLIP, SEED), there, pictures(scene))
    return read_clip(there)
