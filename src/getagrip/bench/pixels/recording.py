"""``getagrip bench recording``: drafts of real images with known poses, by sources of hands, masks and depth.

Each run is a draft as the command makes it, in this process and without its page. Its inputs that come from the truth
are made as a person gives them: a box grown by a few pixels, outlines that are a pixel or two off.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from math import isnan
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.batch.freshness import load_or_compute
from getagrip.bench.job import Benchmark, BenchmarkPage, ClipScores, Trial
from getagrip.bench.pixels.pixel_errors import PALM_JOINTS, PixelTruth, measure
from getagrip.bench.sources import Sample
from getagrip.bench.sources.recording import TRUTH_JOINTS, RecordingRun, View
from getagrip.clip import Clip, HandTrack, read_clip, read_masks
from getagrip.clip.match_frames import number_of
from getagrip.clip.write import write_hand
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import read_mesh
from getagrip.geometry.rasterize import depth_and_face, render_coverage
from getagrip.hands import generic
from getagrip.hands.fit_joints import fit_joints
from getagrip.hands.model import Side
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.images import write_image, write_mask
from getagrip.io.plugins import date_and_commit
from getagrip.io.terminal import markdown_page
from getagrip.provenance import measured, provenance_to_arrays
from getagrip.readers.depth_files import DEPTH_FORMATS
from getagrip.readers.footage import ImageFolder
from getagrip.report.pictures.panels import mask_contours
from getagrip.result import Reconstruction, read_result, software_versions

BOX_MARGIN_PX = 4.0
"""By how much the truth's box in the first frame is grown on each side, before it is rounded."""
N_OUTLINES, OUTLINE_SIGMA_PX, OUTLINE_TOLERANCE_PX = 3, 1.5, 1.5
"""Number of outlined frames, standard deviation of the noise of an outline's corners in x and in y, and the distance of
the outline from the silhouette without it."""
OCCLUDER_GAP_M = 0.008
"""Distance before the true surface at which what the sensor sees hides the object: half a finger [m]."""
N_JOINT_COMPLETIONS = 5
"""Rounds in which unknown joints are replaced by those of the hand that is fitted to the known ones."""
DRAFT_CODE = (
    "bench/pixels", "bench/sources/recording.py", "cli/draft.py", "cli/draft_inputs.py", "cli/draft_views.py", "studio",
    "readers",
)  # fmt: skip
"""Code, besides a reconstruction's, on which a draft and its errors depend."""
CONTOUR_COLOURS = {"truth": (40, 200, 60), "result": (255, 120, 0)}
"""Colours of contours in pictures, red, green and blue."""
HEADINGS = (
    "view", "hands", "masks", "depth", "frames", "masks, IOU", "IOU", "IOU of the truth", "ADD, mm", "ADD, %", "right",
    "along the ray, mm", "across, mm", "rotation, °", "right candidate", "nearest candidate, mm", "hand, joints, mm",
    "hand, depth, mm", "solved hand, depth, mm", "palm's tilt, °", "right in hand, %", "right in camera, %",
    "refused by",
)  # fmt: skip
ALL_VIEWS_LABEL = "all"


@dataclass(frozen=True)
class DraftRequest:
    """The options of a draft without its page, as ``getagrip draft`` names them."""

    video: Path
    object: Path
    size_mm: float
    K: tuple[float, float, float, float]
    out: Path
    object_box: tuple[float, float, float, float] | None = None
    masks: Path | None = None
    hands: Path | None = None
    depth: Path | None = None
    depth_from: str | None = None
    models: Path | None = None
    views: tuple[tuple[str, Path], ...] = ()
    box_view: tuple[tuple[str, tuple[float, float, float, float]], ...] = ()
    cameras: Path | None = None
    camera: str | None = None


@dataclass(frozen=True)
class RecordingScores(ClipScores):
    """The scores of a run; ``errors`` are the fields of ``PixelErrors``, empty where the draft failed."""

    run: tuple[str, str, str, str] = ("", "", "", "")
    """View, and where hands, masks and depth come from."""
    errors: Json = field(default_factory=dict)


@dataclass(frozen=True)
class RecordingTrial(Trial[RecordingScores]):
    """A draft to make and to measure; its record is ``results/<name>.json``, its picture ``results/<name>.png``."""

    draft: Callable[[DraftRequest], None]

    @property
    def made(self) -> RecordingRun:
        """The run."""
        assert isinstance(self.sample, RecordingRun)
        return self.sample

    def failed(self, why: str, trace: str = "") -> RecordingScores:
        return RecordingScores(self.name, failure=why, trace=trace, run=self.made.way)

    def scores(self) -> RecordingScores:
        run = self.made
        further = [image for view in run.others for image in view.images]
        cameras = [run.view.cameras] if run.others and run.view.cameras is not None else []
        used = (
            *further,
            *cameras,
            *run.view.images,
            run.view.mesh,
            *run.view.depth,
            *([run.hand_file] if run.hand_file else []),
        )
        named = {str(n): path for n, path in enumerate(used)}
        truth = b"".join(array.tobytes() for array in (run.view.K, run.view.T_cam_obj, run.view.joints))
        of = {
            "inputs": files.sha256(named), "options": {"truth": sha256(truth).hexdigest(), "side": run.side},
            "software": software_versions(*DRAFT_CODE),
        }  # fmt: skip
        record, again = load_or_compute(self.results / f"{self.name}.json", of, self.overwrite, self._measured)
        return RecordingScores(self.name, again=again, run=run.way, errors=record["errors"])

    def _measured(self) -> Json:
        """Make the draft anew; return its errors."""
        run, view = self.made, self.made.view
        out, *names = run.folder.parent.parent, run.folder.parent.name, run.folder.name
        shutil.rmtree(files.folder_inside(out, *names))
        inputs = files.folder_inside(out, *names, "inputs")
        scene = TrueScene(view, read_mesh(view.mesh))
        self.draft(draft_request(run, scene, inputs))
        (clip_file,) = (run.folder / "draft" / "clips").glob("*/clip.json")
        clip = read_clip(clip_file.parent)
        result = read_result(run.folder / "draft" / "results" / clip_file.parent.name)[0]
        truth = PixelTruth(view.frames, scene.mesh, view.T_cam_obj, view.joints, np.stack(scene.masks))
        errors = measure(truth, clip, result, read_masks(clip))
        write_image(self.results / f"{self.name}.png", draw_contours(scene, clip, result))
        return {"errors": asdict(errors)}


class TrueScene:
    """A view's images, mesh and true masks."""

    def __init__(self, view: View, mesh: Mesh) -> None:
        """Render the masks. Raises ``InputError``."""
        self.view, self.mesh = view, mesh
        self.size = ImageFolder(view.images[:1], (1,)).size
        self.masks = [self._visible(n) for n in range(len(view.frames))]

    def posed(self, n: int) -> Float[ndarray, "V 3"]:
        """Return the object's true vertices in the camera frame [m]."""
        return np.asarray(se3.transform(self.view.T_cam_obj[n], self.mesh.vertices))

    def box(self) -> tuple[float, float, float, float]:
        """Return the truth's box in the first frame, grown and rounded, within the image: left, top, width, height."""
        uv = project(self.view.K, self.posed(0))
        low = np.maximum(np.round(uv.min(axis=0) - BOX_MARGIN_PX), 0.0)
        high = np.minimum(np.round(uv.max(axis=0) + BOX_MARGIN_PX), self.size)
        left, top, width, height = map(float, (*low, *(high - low)))
        return left, top, width, height

    def _visible(self, n: int) -> Bool[ndarray, "H W"]:
        depth, face = depth_and_face(self.posed(n), self.mesh.faces, self.view.K, self.size)
        shown = face >= 0
        if self.view.depth:
            sensed = read_depth_m(self.view.depth[n])
            if sensed.shape != shown.shape:
                expected = f"{shown.shape[1]} x {shown.shape[0]} pixels, as the image"
                raise InputError(self.view.depth[n], "size", f"{sensed.shape[1]} x {sensed.shape[0]} pixels", expected)
            shown &= (sensed <= 0.0) | (sensed > depth - OCCLUDER_GAP_M)
        return np.asarray(shown)


def depth_format(path: Path) -> str:
    """Return the name of a depth image's format: a sensor's millimetres, or HO-3D's colours. Raises ``InputError``."""
    header = files.read_bytes(path)[:26]
    kinds = {(16, 0): "realsense", (8, 2): "ho3d"}
    if len(header) < 26 or (found := kinds.get((header[24], header[25]))) is None:
        raise InputError(path, "", "another kind of image", "depth as PNG: 16-bit grey in mm, or HO-3D's colours")
    return found


def read_depth_m(path: Path) -> Float[ndarray, "H W"]:
    """Read a depth image [m]; 0 where unknown. Raises ``InputError``."""
    form = DEPTH_FORMATS[depth_format(path)]
    return np.asarray(form.read_png(path) * form.source.unit)


def draft_request(run: RecordingRun, scene: TrueScene, inputs: Path) -> DraftRequest:
    """Write the inputs of a run into a folder; return the options of its draft."""
    view = run.view
    masks = hands = depth = form = None
    if run.masks != "box":
        masks = files.folder_inside(inputs, "masks")
        rows = [*range(len(view.frames))]
        if run.masks == "outlines":
            rows = sorted({*np.linspace(0, len(rows) - 1, N_OUTLINES).round().astype(int).tolist()})
        rng = np.random.default_rng([*view.name.encode()])
        for n in rows:
            shown = scene.masks[n]
            write_mask(masks / f"{view.frames[n]}.png", drawn_outline(shown, rng) if run.masks == "outlines" else shown)
    if run.depth == "sensor":
        form, depth = depth_format(view.depth[0]), files.folder_inside(inputs, "depth")
        for name, path in zip(view.frames, view.depth, strict=True):
            files.write_bytes(depth / f"{name}.png", files.read_bytes(path))
    if run.hand_file is not None:
        hands = run.hand_file
    elif run.hands == TRUTH_JOINTS and run.side is not None:
        hands = inputs / "hand.npz"
        numbers = [number_of(name) for name in view.frames]
        extra = {"frames": np.array(numbers, dtype=np.int64), "K": view.K, "side": np.array(run.side)}
        sources = provenance_to_arrays({"hands": measured("the joints of the truth")})
        write_hand(hand_of_joints(view.joints, run.side), hands, extra | sources)
    extent = 1e3 * float(np.ptp(scene.mesh.vertices, axis=0).max())
    K = view.K
    others = {each.camera: each for each in run.others}
    return DraftRequest(
        view.video, view.mesh, extent, (K[0, 0], K[1, 1], K[0, 2], K[1, 2]), inputs.parent / "draft",
        scene.box() if run.masks == "box" else None, masks, hands, depth, form, run.models,
        tuple((name, each.video) for name, each in others.items()),
        tuple((name, TrueScene(each, scene.mesh).box()) for name, each in others.items()),
        view.cameras if others else None, view.camera if others else None,
    )  # fmt: skip


def drawn_outline(mask: Bool[ndarray, "H W"], rng: np.random.Generator) -> Bool[ndarray, "H W"]:
    """Return a mask's largest part as a person outlines it: a polygon with few corners, each a pixel or two off."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    drawn = np.zeros(mask.shape, dtype=np.uint8)
    if contours:
        corners = cv2.approxPolyDP(max(contours, key=cv2.contourArea), OUTLINE_TOLERANCE_PX, True)[:, 0]
        off = corners + rng.normal(0.0, OUTLINE_SIGMA_PX, corners.shape)
        cv2.fillPoly(drawn, [np.round(off).astype(np.int32)], 1)
    return drawn.astype(bool)


def hand_of_joints(joints: Float[ndarray, "T 21 3"], side: Side) -> HandTrack:
    """Fit the generic hand to joints in the camera frame [m], NaN where unknown; three of the palm must be known."""
    model, known = generic.load(side), np.isfinite(joints).all(axis=2)
    flat = model.with_shape(np.zeros(len(model.shape_names))).with_pose(np.zeros((1, 45))).joints[0]
    filled = joints.copy()
    for n, at in enumerate(known):
        palm = [joint for joint in PALM_JOINTS if at[joint]]
        X, Y = flat[palm], joints[n, palm]
        R = se3.nearest_rotation((Y - Y.mean(axis=0)).T @ (X - X.mean(axis=0)))
        filled[n, ~at] = (flat[~at] - X.mean(axis=0)) @ R.T + Y.mean(axis=0)
        for joint in sorted({*np.flatnonzero(~at)} - {0, *range(1, 9), *PALM_JOINTS}):
            filled[n, joint] = filled[n, joint - 1] + filled[n, joint - 4] - filled[n, joint - 5]  # as the next finger
    fit = fit_joints(model, filled, "openpose")
    for _ in range(0 if known.all() else N_JOINT_COMPLETIONS):
        assert fit.hand.joints is not None
        filled = np.where(known[..., None], joints, se3.transform(fit.hand.T_cam_hand, fit.hand.joints))
        fit = fit_joints(model, filled, "openpose")
    return fit.hand


def draw_contours(scene: TrueScene, clip: Clip, result: Reconstruction) -> ndarray:
    """Draw the contours of truth and result over the result's middle frame."""
    middle = len(result.frames) // 2
    n = scene.view.frames.index(result.frames[middle])
    image = ImageFolder((scene.view.images[n],), (1,)).image(0)
    hand = clip.hand.T_cam_hand[clip.index_of(result.frames)] if result.T_cam_hand is None else result.T_cam_hand
    found = se3.transform((hand @ result.T_hand_obj)[middle], result.scale * clip.mesh.vertices)
    surfaces = {"truth": (scene.posed(n), scene.mesh.faces), "result": (found, clip.mesh.faces)}
    for what, (vertices, faces) in surfaces.items():
        for line in mask_contours(render_coverage(vertices, faces, scene.view.K, scene.size)):
            cv2.polylines(image, [np.round(line).astype(np.int32)], True, CONTOUR_COLOURS[what], 1, cv2.LINE_AA)
    return image


@dataclass(frozen=True)
class RecordingBenchmark(Benchmark[RecordingScores]):
    """A benchmark that drafts every view from all sources; ``draft`` is the command's code."""

    draft: Callable[[DraftRequest], None] = field(repr=False)

    def trials(self, samples: Sequence[Sample], results: Path, overwrite: bool) -> list[Trial[RecordingScores]]:
        return [RecordingTrial(sample, results, overwrite, self.draft) for sample in samples]

    def page(self, scores: Sequence[RecordingScores]) -> BenchmarkPage | None:
        """Make the page: a row for each run, and the medians of each source of hands, masks and depth."""
        if not scores:
            return None
        sources = list(dict.fromkeys(one.run[1:] for one in scores))
        grid: list[Sequence[str]] = [HEADINGS]
        grid += [[*one.run, *_cells([one])] for one in scores]
        if len({one.run[0] for one in scores}) > 1:
            grid += [
                [ALL_VIEWS_LABEL, *each, *_cells([one for one in scores if one.run[1:] == each])] for each in sources
            ]
        about = [
            f"drafts of real images with known poses; made {date_and_commit()}",
            "right: ADD up to symmetries, in the camera, below 10 % of the diameter",
            f"box: the truth's in the first frame, {BOX_MARGIN_PX:g} px larger on each side, rounded; outlines: the "
            f"visible silhouette in {N_OUTLINES} frames, its corners {OUTLINE_SIGMA_PX:g} px off; true: rendered, less "
            f"what the sensor sees {1e3 * OCCLUDER_GAP_M:g} mm or more before it",
            "rows of all views: medians of the drafts that were made",
        ]
        text = markdown_page("Drafts of real images", grid, about, words=4)
        content = {one.name: {"failure": one.failure or None, **one.errors} for one in scores}
        return BenchmarkPage("recording", text, {".md": text}, {}, content)


def _cells(runs: Sequence[RecordingScores]) -> list[str]:
    """Return the cells of a row: of a run, or medians of several."""
    done = [one.errors for one in runs if not one.failure]
    alone = len(runs) == 1
    if not done:
        return [*["–"] * (len(HEADINGS) - 5), f"draft: {runs[0].failure}" if alone else "every draft"]

    def median(where: str, key: str, digits: int, factor: float = 1.0) -> str:
        known = [each if where == "" else each[where] for each in done]
        values = [factor * one[key] for one in known if one is not None and one.get(key) is not None]
        values = [value for value in values if not isnan(value)]
        return f"{np.median(values) + 0.0:.{digits}f}" if values else "–"

    def counted(which: Sequence[bool]) -> str:
        return ("yes" if which[0] else "no") if alone else f"{sum(which)} of {len(runs)}"

    nearest = [min(each["candidates"], key=lambda one: one["add_mm"]) for each in done]
    serious = list(dict.fromkeys(name for each in done for name in each["said"]["serious"]))
    refused = sum(each["said"]["refused"] for each in done) + len(runs) - len(done)
    return [
        median("", "frames", 0), median("", "mask_iou", 2), median("", "iou", 2), median("", "true_pose_iou", 2),
        median("object", "add_mm", 1), median("object", "add_percent", 1),
        counted([each["object"]["right"] for each in done]),
        median("object", "along_mm", 1), median("object", "across_mm", 1), median("object", "rotation_deg", 0),
        counted([any(one["right"] for one in each["candidates"]) for each in done]),
        f"{np.median([one['add_mm'] for one in nearest]):.1f}",
        median("hand_found", "joints_mm", 1), median("hand_found", "along_mm", 1),
        median("hand_solved", "along_mm", 1), median("hand_solved", "tilt_deg", 0),
        median("said", "in_hand", 1, 100.0), median("said", "in_camera", 1, 100.0),
        (", ".join(serious) or "–") if alone else f"{refused} of {len(runs)}",
    ]  # fmt: skip
