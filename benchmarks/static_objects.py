"""Measure where static objects are found in the world, by masks from a moving head: HOT3D's test sample.

    python -m benchmarks.static_objects HOT3D [--write]

HOT3D is a folder as for ``getagrip import hot3d``. Of each recording, the objects whose surface stays within 3 mm of
where it was in the first frame, in all frames: by the search for static segments of timelines, with masks rendered
from the true poses, the object's size known or free. The head's motion is taken as it was
recorded, and scaled about its first place: the camera then looks at the object from where it would be, the object at
the same place of the image. ``--write`` puts the table into docs/results-timelines.md.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from benchmarks import page
from getagrip.clip import Clip, Masks, Segment
from getagrip.clip.sampling import frame_indices
from getagrip.datasets.cutting import frame_masks, known_clip
from getagrip.datasets.hot3d.reader import Objects, tracks
from getagrip.datasets.hot3d.recording import Recording, find, read_recording
from getagrip.datasets.synthetic.noise import Noise, perturbed
from getagrip.experiments.stamp import stamp
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.geometry.fisheye import pinhole
from getagrip.geometry.mesh_files import read_mesh
from getagrip.grasps.states import STILL
from getagrip.metrics.pose import ObjectTrack, PoseErrors, best_symmetry, pose_errors
from getagrip.metrics.symmetry import Symmetries, find_symmetries
from getagrip.timelines.footage import Footage
from getagrip.timelines.static_pose import FRAMES, static_hypotheses

TIMES = (0.0, 1.0, 4.0, 16.0)
"""The head's displacement is scaled by these."""
RAGGED = 1.0
"""Masks are also taken with boundaries that are off by this, root mean square [px]."""
SHRUNK = 2
"""Images are so many times smaller than the cameras': 512 x 640 and 704 x 704 pixels."""
CASES = ((0.0, "known"), (RAGGED, "known"), (0.0, "free"), (RAGGED, "free"))
"""How far masks are off, and what is known of the size."""
SECTION = "hot3d-static"


@dataclass(frozen=True)
class Found:
    """One object, from one motion of the head, by one kind of masks."""

    name: str
    times: float
    case: tuple[float, str]
    """Of ``CASES``."""
    moved: float
    """The camera's largest distance from its first place [m]."""
    parallax: float
    """The largest angle between two directions from the object to the camera [rad]."""
    errors: PoseErrors
    """In the world."""
    scale: float
    """Of the object that was found; the true one is 1."""
    seconds: float

    @property
    def share(self) -> float:
        """ADD in diameters."""
        return float(self.errors.add.mean() / self.errors.diameter)


def scaled(T_world_cam: Float[ndarray, "N 4 4"], times: float, at: Float[ndarray, "3"]) -> Float[ndarray, "N 4 4"]:
    """A motion of the camera, its displacement scaled about the first place; the point ``at`` stays in the image."""
    places = T_world_cam[:, :3, 3]
    moved = places[0] + times * (places - places[0])
    before, after = ((at - p) / np.linalg.norm(at - p, axis=1, keepdims=True) for p in (places, moved))
    axis = np.cross(before, after)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, np.sum(before * after, axis=1, keepdims=True))
    R = se3.exp_so3(axis * angle / np.maximum(sine, 1e-12))
    return np.asarray(se3.rigid(R @ T_world_cam[:, :3, :3], moved))


def still(recording: Recording, objects: Objects) -> Iterator[str]:
    """The objects with a mesh that stay where they are."""
    for uid, mesh in objects.read(recording, print).items():
        poses = recording.objects[uid]
        posed = se3.transform(poses.T_world_obj[poses.known], mesh.vertices[None])
        if np.linalg.norm(posed - posed[0], axis=2).mean(axis=1).max() < STILL:
            yield uid


def views(recording: Recording, objects: Objects, uid: str, times: float, folder: Path) -> tuple[Clip, Masks]:
    """An object in the frames that are fitted, the head's motion scaled."""
    poses, lens = recording.objects[uid], recording.camera.fisheye
    width, height = lens.size
    view = pinhole(lens, lens.f / SHRUNK, (height // SHRUNK, width // SHRUNK), quarter_turns=1)
    centre = se3.transform(poses.T_world_obj[0], objects.read(recording, lambda _: None)[uid].centre[None])[0]
    moved = scaled(recording.camera.T_world_cam, times, centre)
    camera = replace(recording.camera, T_world_cam=moved, pinhole=view)
    only = replace(recording, camera=camera)
    track = next(t for t in tracks(folder, only, objects, lambda _: None) if t.provenance["object_uid"] == uid)
    track = track.take(frame_indices(len(track), FRAMES))
    return known_clip(track), Masks.of(frame_masks(track, row) for row in range(len(track)))


def measured(
    clip: Clip, masks: Masks, symmetries: Symmetries, name: str, times: float, case: tuple[float, str]
) -> Found:
    """The best static pose of a clip against the true ones."""
    assert clip.world is not None
    assert clip.truth is not None
    ragged, size = case
    clip = replace(clip, scale="free" if size == "free" else "known")
    since = time.process_time()
    _, given = perturbed(clip, masks, Noise(mask_ragged_px=ragged), [0, *name.encode()])
    footage = Footage.of(clip.light(), given, Options())
    found = static_hypotheses(footage, Segment("static", 0, len(clip) - 1), support=False)
    assert found is not None
    seconds = time.process_time() - since
    T_world_cam = clip.world.T_world_cam
    true = ObjectTrack(T_world_cam @ clip.truth.T_cam_obj, 1.0)
    best = ObjectTrack(found.T_world_obj(clip.mesh.centre)[0], float(found.scale[0]))
    symmetry = best_symmetry(clip.mesh, best, true, symmetries)
    away = T_world_cam[:, :3, 3] - se3.transform(true.T_ref_obj[0], clip.mesh.centre[None])[0]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    return Found(
        name, times, case,
        moved=float(np.linalg.norm(T_world_cam[:, :3, 3] - T_world_cam[0, :3, 3], axis=1).max()),
        parallax=float(np.arccos(np.clip(away @ away.T, -1.0, 1.0)).max()),
        errors=pose_errors(clip.mesh, best, true, symmetry),
        scale=best.scale,
        seconds=seconds,
    )  # fmt: skip


def table(found: list[Found]) -> str:
    """The table, and each object's error."""
    heads = ["head's motion", "size", "masks", "moves, mm", "parallax, degrees", "right", "ADD (sym.), mm",
             "% of diameter", "centre, mm", "turned, degrees", "size off, %", "s"]  # fmt: skip
    rows = []
    for case in CASES:
        for times in TIMES:
            of = [one for one in found if (one.times, one.case) == (times, case)]
            values = [
                [1e3 * one.moved, np.degrees(one.parallax), 1e3 * one.errors.add.mean(), 100.0 * one.share,
                 1e3 * one.errors.translation.mean(), np.degrees(one.errors.rotation.mean()),
                 100.0 * abs(one.scale - 1.0), one.seconds]
                for one in of
            ]  # fmt: skip
            cells = [f"{value:.1f}" for value in np.median(values, axis=0)]
            if case[1] == "known":
                cells[6] = "–"
            right = f"{sum(one.errors.success for one in of)} of {len(of)}"
            masks = f"off by {case[0]:g} px" if case[0] else "exact"
            motion = {0.0: "none", 1.0: "as recorded"}.get(times, f"{times:g} times")
            rows.append([motion, case[1], masks, *cells[:2], right, *cells[2:]])
    names = dict.fromkeys(one.name for one in found)
    each = [
        [name, *(f"{100.0 * one.share:.1f}" for one in found if one.name == name and one.times == 1.0)]
        for name in names
    ]
    return "\n".join([
        page.table(heads, rows), "",
        f"Medians over {len(each)} objects. Each, the head's motion as recorded, ADD (sym.) in % of the diameter:", "",
        page.table(["", *(f"{size}, {'ragged' if ragged else 'exact'}" for ragged, size in CASES)], each), "",
        f"*Made {stamp()}.*",
    ])  # fmt: skip


def main(root: Path) -> str:
    """Measure all static objects."""
    objects, found = Objects.below(root), []
    for name, files in find(root).items():
        recording = read_recording(name, files)
        for uid in still(recording, objects):
            symmetries = find_symmetries(read_mesh(objects.meshes[uid]))
            for times in TIMES:
                clip, masks = views(recording, objects, uid, times, root)
                called = f"{objects.names[uid]} ({recording.camera.device})"
                for case in CASES:
                    found.append(measured(clip, masks, symmetries, called, times, case))
                    print(called, times, *case, f"{100.0 * found[-1].share:.1f} %", flush=True)
    return table(found)


if __name__ == "__main__":
    match sys.argv[1:]:
        case [root]:
            print(main(Path(root)))
        case [root, "--write"]:
            page.write(SECTION, main(Path(root)))
        case _:
            sys.exit(__doc__)
