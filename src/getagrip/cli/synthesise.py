"""``getagrip synthesise``: a synthetic clip with ground truth, as a clip's folder or as a rendered video."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from getagrip.cli.command import Command
from getagrip.errors import UsageError
from getagrip.io.options import Flag, Folder

MAX_SYNTHETIC_FRAMES = 3000


@dataclass(frozen=True, kw_only=True)
class Synthesise(Command):
    """Make a synthetic clip with ground truth: a hand that moves an object, from a folder's data or as a video."""

    kind: Annotated[Positional[str], arg(metavar="KIND")]
    """The category of the object, such as mug or bottle; a wrong one lists all."""
    seed: int = 0
    """Seed of the shape, the grasp, the motion and the look."""
    frames: int = 90
    """Number of frames, 30 a second."""
    out: Folder = Path("out/synthetic")
    """Folder in which the clip is written."""
    video: Flag = False
    """Also render a video of it, with skin, forearm, textured object, table and light: DIR/<name>/video.mp4."""

    def run(self) -> int:
        """Write the clip to ``OUT/<clip name>``. Raises ``UsageError`` for an unknown kind or a folder that exists."""
        from getagrip.clip import write_clip
        from getagrip.io.terminal import print_result, progress_bar
        from getagrip.synthetic.scene import ground_truth_masks, make_scene, render_pictures
        from getagrip.synthetic.scene_options import SceneOptions
        from getagrip.synthetic.video import write_rendered_video

        if not 2 <= self.frames <= MAX_SYNTHETIC_FRAMES:
            raise UsageError(f"--frames: got {self.frames}, expected 2 to {MAX_SYNTHETIC_FRAMES}")
        scene = make_scene(self.kind, self.seed, SceneOptions(frames=self.frames))
        folder = write_clip(scene.clip, ground_truth_masks(scene), self.out / scene.clip.name, render_pictures(scene))
        print_result(
            f"clip     {folder}: a {scene.clip.category} in a {scene.clip.side} hand, {len(scene.clip)} frames"
        )
        if self.video:
            with progress_bar() as bar:
                task = bar.add_task("render the video", total=float(len(scene.clip)))
                there = self.out / f"{scene.clip.name}-video"
                made = write_rendered_video(scene, there, self.seed, lambda: bar.advance(task))
            print_result(f"video    {made.video}; from it to a result:\n{made.command()}")
        return 0
