"""``getagrip demo --video``: from the pixels of a rendered video to 3D, each stage beside the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.cli.draft import Draft
from getagrip.geometry.lens import Lens

if TYPE_CHECKING:
    from getagrip.clip import Clip
    from getagrip.result import Reconstruction
    from getagrip.synthetic.scene import Scene
    from getagrip.synthetic.video import RenderedVideo

N_VIDEO_FRAMES = 90
JOINTS_CAPTION = "joints of the hand"


def run_demo_video(category: str, seed: int, out: Path, models: Path | None, frames: int = N_VIDEO_FRAMES) -> int:
    """Render a video, draft it from a box in its first frame, and print the errors of hands, masks and object.

    A video of an earlier call is used again; the draft is made anew. Returns the exit status of ``draft``.
    """
    import shutil

    from getagrip.clip import read_clip
    from getagrip.io import files
    from getagrip.io.terminal import console, progress_bar
    from getagrip.result import read_result
    from getagrip.synthetic.scene import make_scene
    from getagrip.synthetic.scene_options import SceneOptions
    from getagrip.synthetic.video import describe_rendered_video, write_rendered_video

    screen, scene = console(), make_scene(category, seed, SceneOptions(frames=frames))
    rendered, drafted = out / "video", out / "draft"
    if rendered.exists():
        video = describe_rendered_video(scene, rendered)
    else:
        with progress_bar() as bar:
            task = bar.add_task("render the video", total=float(frames))
            video = write_rendered_video(scene, rendered, seed, lambda: bar.advance(task))
    screen.print(f"video    {video.video}: rendered, {frames} frames; from here on only its pixels are used, the")
    screen.print("         camera, the mesh and its size, and a box about the object in the first frame")
    screen.print(f"         {video.command()}", soft_wrap=True)
    if drafted.exists():
        files.refuse_link(drafted)
        shutil.rmtree(drafted)
    status = _draft_of(video, drafted, models).run()
    if status:
        return status
    (clip_folder,) = (path.parent for path in (drafted / "clips").glob("*/clip.json"))
    result_folder = drafted / "results" / clip_folder.name
    errors = measure_draft(scene, read_clip(clip_folder), read_result(result_folder)[0])
    screen.print(
        "\n".join(
            ["", "beside the truth, medians over frames:", *(f"  {what}: {error}" for what, error in errors.items())]
        )
    )
    screen.print(f"report   {result_folder / 'report.html'}")
    return 0


def _draft_of(video: RenderedVideo, out: Path, models: Path | None) -> Draft:
    return Draft(
        video=video.video,
        object=str(video.mesh),
        size_mm=video.size_mm,
        object_box=video.box,
        lens=Lens(K=video.K),
        no_page=True,
        models=models,
        out=out,
    )


def measure_draft(scene: Scene, clip: Clip, result: Reconstruction) -> dict[str, str]:
    """Measure a draft's hands, masks and object against the scene that its video shows, medians over frames, in words.

    Frames of the clip are named by their number in the video, from 1.
    """
    import numpy as np

    from getagrip.clip import read_masks
    from getagrip.geometry import se3
    from getagrip.synthetic.scene import ground_truth_masks
    from getagrip.synthetic.video import VIDEO_SIZE_PX, at_video_size

    truth, shown = scene.clip.truth, at_video_size(scene, VIDEO_SIZE_PX)
    assert truth is not None
    assert scene.clip.hand.joints is not None
    rows = np.array([int(name) - 1 for name in clip.frames])
    found, true = read_masks(clip), ground_truth_masks(shown)
    overlap = [
        (found.object[n] & true.object[row]).sum() / max((found.object[n] | true.object[row]).sum(), 1)
        for n, row in enumerate(rows)
    ]
    errors = {"hand found in": f"{len(clip)} of {len(scene.clip)} frames"}
    if clip.hand.joints is not None:
        joints = se3.transform(clip.hand.T_cam_hand, clip.hand.joints)
        true_joints = se3.transform(truth.T_cam_hand[rows], scene.clip.hand.joints[rows])
        off = np.linalg.norm(joints - true_joints, axis=-1).mean(axis=-1)
        errors[JOINTS_CAPTION] = f"{1e3 * np.median(off):.0f} mm"
    errors["masks, IOU"] = f"{np.median(overlap):.2f}"
    at = np.array([int(name) - 1 for name in result.frames])
    points = se3.transform(result.T_cam_obj, result.scale * scene.object.vertices)
    true_points = se3.transform(truth.T_cam_obj[at], scene.object.vertices)
    off = np.linalg.norm(points - true_points, axis=-1).mean(axis=-1)
    middle = true_points.mean(axis=1)
    shift = np.sum((points.mean(axis=1) - middle) * middle, axis=-1) / np.linalg.norm(middle, axis=-1)
    turned = np.degrees(se3.angle_between(result.T_cam_obj[:, :3, :3], truth.T_cam_obj[at, :3, :3]))
    share = 100.0 * np.median(off) / scene.object.diameter
    errors["object, distance of its vertices"] = f"{1e3 * np.median(off):.1f} mm, {share:.1f} % of its diameter"
    errors["object, along the ray"] = f"{round(1e3 * float(np.median(shift)), 1) + 0.0:+.1f} mm"
    errors["object, rotation"] = f"{np.median(turned):.1f} degrees"
    return errors
