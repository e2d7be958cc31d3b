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
            [
                "",
                "beside the truth, up to the object's symmetries:",
                *(f"  {what}: {error}" for what, error in errors.items()),
            ]
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
    """Measure a draft's hands, masks and object against the scene that its video shows, by ``measure``, in words.

    Frames of the clip are named by their number in the video, from 1.
    """
    from getagrip.bench.pixels.pixel_errors import PixelTruth, measure
    from getagrip.clip import read_masks
    from getagrip.geometry import se3
    from getagrip.synthetic.scene import ground_truth_masks
    from getagrip.synthetic.video import VIDEO_SIZE_PX, at_video_size

    truth, joints = scene.clip.truth, scene.clip.hand.joints
    assert truth is not None
    assert joints is not None
    names = tuple(f"{n + 1:06d}" for n in range(len(scene.clip)))
    masks = ground_truth_masks(at_video_size(scene, VIDEO_SIZE_PX)).object
    true = PixelTruth(names, scene.object, truth.T_cam_obj, se3.transform(truth.T_cam_hand, joints), masks)
    found = measure(true, clip, result, read_masks(clip))
    errors = {"hand found in": f"{len(clip)} of {len(scene.clip)} frames"}
    if found.hand_found is not None:
        errors[JOINTS_CAPTION] = f"{found.hand_found.joints_mm:.0f} mm"
    errors["masks, IOU"] = f"{found.mask_iou:.2f}"
    thing = found.object
    errors["object, distance of its vertices"] = f"{thing.add_mm:.1f} mm, {thing.add_percent:.1f} % of its diameter"
    errors["object, along the ray"] = f"{round(thing.along_mm, 1) + 0.0:+.1f} mm"
    errors["object, rotation"] = f"{thing.rotation_deg:.1f} degrees"
    return errors
