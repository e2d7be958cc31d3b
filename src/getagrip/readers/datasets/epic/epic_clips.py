"""The clip of a grasp of EPIC-Grasps: VISOR's masks in some frames, the video's camera, and hands from a file.

Without ground truth and without the object's own mesh: the mesh is a template of the category, its scale free.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Clip, FrameMasks, HandTrack, Masks, Segment, World
from getagrip.clip.read_arrays import check_intrinsics, read_hand
from getagrip.clip.timeline import at_frames
from getagrip.clip.write import missing_hand_provenance
from getagrip.errors import InputError
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import MESH_SUFFIXES, read_mesh
from getagrip.io import arrays
from getagrip.io.files import shorten_value
from getagrip.provenance import (
    Provenance,
    Source,
    assumed,
    estimated,
    is_provenance_key,
    measured,
    provenance_from_arrays,
)
from getagrip.readers import streams
from getagrip.readers.datasets.dataset import Note
from getagrip.readers.datasets.epic import visor
from getagrip.readers.datasets.epic.epic_images import EPIC_WORLD_UP
from getagrip.readers.datasets.epic.epic_tables import EpicGrasp, numbering_rate, subject_of
from getagrip.readers.datasets.views import MIN_VISIBLE_PIXELS
from getagrip.stable_grasps.segment_states import resolve_overlaps
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES

EPIC_IMAGE_SIZE_PX = visor.DENSE_IMAGE_SIZE_PX
"""Width and height of the clips' images [px]: those of VISOR's dense annotations."""
MAX_EPIC_CLIP_FRAMES = 30
"""Maximum number of frames of a clip, spread evenly over the valid frames (as in the paper)."""
MIN_VALID_FRAMES = 2
"""Minimum number of valid frames of a grasp: one silhouette does not show a motion."""
FOCAL_TO_WIDTH_RATIO = 200.0 / 640.0
"""Assumed ratio of focal length to image width, HOMan's for EPIC-KITCHENS."""
BACKGROUND_CLASS_IDS = frozenset({8, 12, 24, 42, 46, 63, 70, 90, 113, 124, 157, 159, 182, 242, 247, 263, 295})
"""Noun classes that rarely occlude: drawer, fridge, hob, worktop, oven, sink, dishwasher, microwave, freezer, washing
machine, kitchen, floor, chair, wall, shelf, window, door."""

VisorFrames = dict[int, visor.VisorFrame]
"""VISOR's frames by EPIC's frame numbers."""


@dataclass(frozen=True)
class EpicHandFile:
    """A ``hand.npz``, with optional frames and camera; its hands are read by ``track``."""

    path: Path
    frames: tuple[int, ...] | None
    """EPIC's frame numbers (``frames``); None if the hands are of the clip's frames."""
    K: Float[ndarray, "3 3"] | None
    """The estimator's intrinsics [px of 854 x 480]; None if not stated."""
    camera: Source
    """Source of ``K``."""

    def has(self, number: int) -> bool:
        """Return whether a frame has a hand."""
        return self.frames is None or number in self.frames

    def track(self, chosen: Sequence[int]) -> HandTrack:
        """Read the hand in some of the file's frames. Raises ``InputError``."""
        if self.frames is None:
            return read_hand(self.path, len(chosen))
        track = read_hand(self.path, len(self.frames))
        return track.take(np.array([self.frames.index(number) for number in chosen]))


@dataclass(frozen=True)
class EpicCamera:
    """The camera of a video."""

    K: Float[ndarray, "3 3"]
    """Intrinsics [px of 854 x 480]."""
    source: Source
    T_world_cam: Mapping[int, Float[ndarray, "4 4"]] | None = None
    """Camera poses by EPIC's frame numbers, in a metric world with z up; None if unknown."""

    def sees(self, number: int) -> bool:
        """Return whether a frame can be used: with camera poses, only frames with a pose."""
        return self.T_world_cam is None or number in self.T_world_cam

    def world(self, numbers: Sequence[int]) -> World | None:
        """Return the camera's path over some frames."""
        if self.T_world_cam is None:
            return None
        return World(np.stack([self.T_world_cam[n] for n in numbers]), EPIC_WORLD_UP)


def collect_grasp_frames(
    files: Sequence[Path], mapping: visor.FrameMapping, grasps: Sequence[EpicGrasp]
) -> dict[str, VisorFrames]:
    """Collect VISOR's frames that show the object of each grasp, by the grasp's name. Raises ``InputError``.

    Of several annotations of a frame, people's take precedence over interpolated ones, then the most complete one.
    """
    out: dict[str, VisorFrames] = {grasp.name: {} for grasp in grasps}
    for path in files:
        for frame in visor.read_frames(path):
            number = mapping.number(frame)
            for grasp in grasps:
                if grasp.start <= number <= grasp.end and any(_is_grasped(a, grasp) for a in frame.annotations):
                    other = out[grasp.name].get(number)
                    if other is None or _annotation_rank(frame) > _annotation_rank(other):
                        out[grasp.name][number] = frame
    return out


def _is_grasped(annotation: visor.Annotation, grasp: EpicGrasp) -> bool:
    return annotation.name == grasp.entity and not annotation.hands and bool(annotation.polygons)


def _annotation_rank(frame: visor.VisorFrame) -> tuple[bool, int]:
    return not frame.dense, len(frame.annotations)


def visor_frame_masks(frame: visor.VisorFrame, grasp: EpicGrasp) -> FrameMasks:
    """Draw the masks of a frame: the object, the ignored pixels, and the grasping hand.

    Both hands, gloves and other objects are ignored, except for ``BACKGROUND_CLASS_IDS``; the hand's mask includes its
    glove, but not a pair of gloves in one mask. The object's polygons take precedence over others.
    """

    def drawn(chosen: Iterable[visor.Annotation]) -> Bool[ndarray, "H W"]:
        return visor.draw_visor_mask(chosen, frame.size, EPIC_IMAGE_SIZE_PX)

    grasped = [a for a in frame.annotations if _is_grasped(a, grasp)]
    hiding = [a for a in frame.annotations if a not in grasped and (a.hands or a.class_id not in BACKGROUND_CLASS_IDS)]
    observed = drawn(grasped)
    holding = drawn(a for a in frame.annotations if a.hands == (grasp.side,))
    return FrameMasks(observed, drawn(hiding) & ~observed, holding & ~observed)


def make_epic_clip(
    grasp: EpicGrasp,
    frames: VisorFrames,
    mesh: Mesh,
    mesh_source: str,
    camera: EpicCamera,
    hands: EpicHandFile | None,
    has_mapping: bool,
    note: Note,
    segments: Sequence[Segment] = (),
) -> tuple[Clip, Masks] | None:
    """Make the clip of a grasp and its masks; None, after a note, with too few valid frames.

    Valid frames have a mask of the object and, if the hand file states its frames, a hand. A clip has at most
    ``MAX_EPIC_CLIP_FRAMES`` of them; with fewer, frames with a mask alone are added, whose hands may come later.
    The clip's hand has no vertices: ``read_grasp_hand`` reads them.
    """
    masks = {number: visor_frame_masks(frame, grasp) for number, frame in sorted(frames.items()) if camera.sees(number)}
    valid = [number for number, mask in masks.items() if np.count_nonzero(mask.object) >= MIN_VISIBLE_PIXELS]
    masked, valid = valid, [number for number in valid if hands is None or hands.has(number)]
    if len(valid) < MIN_VALID_FRAMES:
        what = "a mask" if hands is None or hands.frames is None else "a mask and a hand"
        of = f"of {shorten_value(grasp.entity)}"
        note(f"{grasp.name}: {len(valid)} of its {grasp.frames} frames have {what} {of}: skipped")
        return None
    spans = [(s.first, s.last) for s in segments] or [(grasp.start, grasp.end)]
    chosen = sorted({number for span in spans for number in _choose_frames(valid, masked, span)})
    if hands is not None and hands.K is not None:
        camera = replace(camera, K=hands.K, source=hands.camera)
    names = tuple(f"{number:010d}" for number in chosen)
    at_chosen = [span for s in segments for span in at_frames([s], np.array(chosen))]
    made = Clip(
        name=grasp.name,
        category=grasp.category,
        side=grasp.side,
        fps=numbering_rate(grasp.video),
        frames=names,
        times=np.array(chosen) / numbering_rate(grasp.video),
        world=camera.world(chosen),
        segments=resolve_overlaps(at_chosen, len(chosen), grasp.side),
        size=EPIC_IMAGE_SIZE_PX,
        K=np.tile(camera.K, (len(chosen), 1, 1)),
        mesh=mesh,
        scale="free",
        hand=HandTrack(
            np.zeros((len(chosen), 0, 3)), np.zeros((0, 3), int), np.tile(np.eye(4), (len(chosen), 1, 1)), {}
        ),
        provenance=_epic_provenance(
            grasp, [frames[n] for n in chosen], mesh_source, camera, hands, has_mapping, segments
        )
        | missing_hand_provenance(
            names, [row for row, number in enumerate(chosen) if hands is None or hands.has(number)]
        ),
    )
    return made, Masks.of(masks[number] for number in chosen)


def _choose_frames(valid: Sequence[int], masked: Sequence[int], span: tuple[int, int]) -> list[int]:
    first, last = span
    known = [number for number in valid if first <= number <= last]
    others = [number for number in masked if first <= number <= last and number not in known]
    chosen = _spread_evenly(known, MAX_EPIC_CLIP_FRAMES)
    return chosen + _spread_evenly(others, MAX_EPIC_CLIP_FRAMES - len(chosen))


def _spread_evenly(numbers: Sequence[int], count: int) -> list[int]:
    return [numbers[i] for i in np.round(np.linspace(0, len(numbers) - 1, min(count, len(numbers)))).astype(int)]


def read_grasp_hand(path: Path, clip: Clip) -> tuple[HandTrack, list[int]]:
    """Read the hand of a clip from its hand file, and the indices of its frames. Raises ``InputError``."""
    hands, numbers = read_epic_hand_file(path), [int(name) for name in clip.frames]
    rows = [row for row, number in enumerate(numbers) if hands.has(number)]
    return hands.track([numbers[row] for row in rows]), rows


def _epic_provenance(
    grasp: EpicGrasp,
    frames: Sequence[visor.VisorFrame],
    mesh: str,
    camera: EpicCamera,
    hands: EpicHandFile | None,
    has_mapping: bool,
    segments: Sequence[Segment],
) -> Provenance:
    dense = sum(frame.dense for frame in frames)
    provenance: Provenance = {
        "source": f"EPIC-Grasps {grasp.example}: {grasp.video}, frames {grasp.start} to {grasp.end}",
        "subject": subject_of(grasp.video),
        "entity": grasp.entity,
        "licence": "made from EPIC-KITCHENS, VISOR and EPIC-Grasps, CC BY-NC 4.0",
        "masks": f"VISOR: {len(frames) - dense} frames annotated by people, {dense} interpolated; ignored are both "
        "hands and other objects, not what stands behind",
        "frame_numbers": "EPIC's, VISOR's moved by its frame_mapping.json"
        if has_mapping
        else "VISOR's, taken for EPIC's for want of frame_mapping.json: a few frames off",
        "camera": camera.source,
        "mesh": mesh,
        "scale": "free: no object's size is known",
        "hands": "missing: add hand.npz (docs/estimators.md)" if hands is None else "the hand file's",
    }
    if segments:
        provenance["clip"] = f"a timeline of EPIC-HIT, {len(segments)} segments"
    return provenance | ({"mended": grasp.note} if grasp.note else {})


def read_epic_hand_file(path: Path) -> EpicHandFile:
    """Read a ``hand.npz`` with optional ``frames`` (N,) and ``K`` (3, 3). Raises ``InputError``."""
    stored = arrays.read(path, lambda key: key in {"frames", "K"} or is_provenance_key(key))
    K = None
    if "K" in stored:
        K = arrays.floats(path, stored, "K", (3, 3))
        check_intrinsics(path, K[None], EPIC_IMAGE_SIZE_PX)
    known = provenance_from_arrays(path, stored).get("camera", measured("it does not say from where"))
    camera = replace(known, text=f"the hand file's: {known}")
    return EpicHandFile(path, arrays.frame_numbers(path, stored), K, camera)


def epic_pinhole(focal: float | None = None) -> EpicCamera:
    """Make a pinhole with a central principal point and a focal length [px of 854 x 480], assumed by default."""
    f = FOCAL_TO_WIDTH_RATIO * EPIC_IMAGE_SIZE_PX[0] if focal is None else focal
    K = np.array([[f, 0.0, EPIC_IMAGE_SIZE_PX[0] / 2], [0.0, f, EPIC_IMAGE_SIZE_PX[1] / 2], [0.0, 0.0, 1.0]])
    guess = assumed(f"a guess: the focal length {f:g} px, which HOMan takes for EPIC-KITCHENS")
    return EpicCamera(K, guess if focal is None else measured("focal length as given"))


def read_epic_camera(path: Path) -> EpicCamera:
    """Read the camera of a video from EPIC-Fields (``<video>.json``), without distortion. Raises ``InputError``.

    The principal point is set to the centre, as by the authors of EPIC-Grasps.
    """
    camera = streams.read_json_member(path, "camera")
    size = [camera.get("width"), camera.get("height")]
    params = camera.get("params")
    if not all(isinstance(side, int) and 0 < side < 10_000 for side in size):
        raise InputError(path, "camera", f"the size {shorten_value(size)}", "width and height in pixels")
    if camera.get("model") not in ("OPENCV", "PINHOLE", "FULL_OPENCV") or not isinstance(params, list):
        expected = "OPENCV, with fx, fy, cx, cy, ... in params"
        raise InputError(path, "camera.model", shorten_value(camera.get("model")), expected)
    focal = params[:2]
    if not all(isinstance(f, int | float) and 0 < f < 1e6 for f in focal) or len(focal) < 2:
        raise InputError(path, "camera.params", shorten_value(params), "fx, fy, cx, cy, ... [px], fx and fy above 0")
    K = np.diag([focal[0] * EPIC_IMAGE_SIZE_PX[0] / size[0], focal[1] * EPIC_IMAGE_SIZE_PX[1] / size[1], 1.0])
    K[:2, 2] = np.array(EPIC_IMAGE_SIZE_PX) / 2
    check_intrinsics(path, K[None], EPIC_IMAGE_SIZE_PX)
    return EpicCamera(K, estimated("EPIC-Fields, its distortion left out"))


def category_mesh(category: str, folder: Path | None) -> tuple[Mesh, str]:
    """Read the mesh of a category [m, z up], ``<category>.obj`` (.ply, .stl, .glb) of a folder or the built-in one.

    Also returns its source. Raises ``InputError`` for a folder without the mesh.
    """
    if folder is None:
        return SYNTHETIC_CATEGORIES[category](), "this package's procedural mesh of the category"
    for suffix in MESH_SUFFIXES:
        if (path := folder / f"{category}{suffix}").is_file():
            return read_mesh(path), f"{path.name} of the folder given"
    raise InputError(folder, "", f"no {category}.obj in it", f"{category}.obj, the mesh of the category")
