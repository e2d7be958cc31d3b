"""Recordings: real images with known poses, of several calibrated views or a single frame; and the grid of their runs.

The files of a folder are listed in docs/results-pixels.md. They come from strangers: no pickle is read, no link leads
out of the folder, and numbers of views and frames have bounds.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from tyro.conf import arg

from getagrip.bench.sources.source import ClipSource, Sample
from getagrip.errors import InputError, UsageError
from getagrip.io import files
from getagrip.io.files import shorten_value
from getagrip.io.options import OptionalFolder

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float
    from numpy import ndarray

    from getagrip.batch.job import Outcome
    from getagrip.batch.scheduling import SchedulingOptions

MAX_VIEWS, MAX_RECORDING_FRAMES = 64, 1000
"""Maximum numbers of views of a recording, and of frames of a view."""
MIN_TRUTH_JOINTS = 12
"""Least number of known joints in each frame of hands that are made of a recording's joints."""
DRAFTED_HANDS, TRUTH_JOINTS = "found", "joints"
"""Hands that the draft finds, and those of the recording's joints; others have a user's name."""
MASK_CHOICES, DEPTH_CHOICES = ("box", "outlines", "true"), ("none", "sensor")
REPEATED_NAMES = ("000001", "000002")
"""Names that a draft gives to a single image, which it takes twice."""
SINGLE_IMAGES, SINGLE_TRUTH = ("color.png", "color.jpg"), "truth.json"
VIEWS_FILE, TRUTH_FILE = "cameras.json", "truth.npz"


@dataclass(frozen=True, eq=False)
class View:
    """The files of a view and its truth.

    Attributes:
        name: the folder's name, and the camera's.
        video: folder of images, or a single image.
        frames: names that a draft gives to the frames.
        images: image of each frame.
        depth: depth image of each frame; empty without any.
        mesh: the object's mesh file.
        K: intrinsics [px].
        T_cam_obj: (T, 4, 4) true poses [m].
        joints: (T, 21, 3) true joints in the camera frame [m], NaN where unknown.
        camera: name of its camera among ``cameras``.
        cameras: file of the poses of all cameras; None for a single frame.
    """

    name: str
    video: Path
    frames: tuple[str, ...]
    images: tuple[Path, ...]
    depth: tuple[Path, ...]
    mesh: Path
    K: Float[ndarray, "3 3"]
    T_cam_obj: Float[ndarray, "T 4 4"]
    joints: Float[ndarray, "T 21 3"]
    camera: str = ""
    cameras: Path | None = None

    @property
    def has_joints(self) -> bool:
        """True if hands can be made of the joints of every frame: enough are known, and three of the palm."""
        import numpy as np

        known = np.isfinite(self.joints).all(axis=2)
        palm = known[:, [0, 5, 9, 13, 17]]
        return bool((known.sum(axis=1) >= MIN_TRUTH_JOINTS).all() and (palm.sum(axis=1) >= 3).all())


@dataclass(frozen=True, kw_only=True)
class RecordingRun(Sample):
    """A draft of a view: where its hands, masks and depth come from. The folder is the draft's.

    ``others`` are further views of the same recording, each with a box as well.
    """

    view: View
    others: tuple[View, ...]
    hands: str
    masks: str
    depth: str
    hand_file: Path | None
    side: Literal["left", "right"] | None
    models: Path | None

    @property
    def way(self) -> tuple[str, str, str, str]:
        """View, and where hands, masks and depth come from."""
        many = f" in {1 + len(self.others)} views" if self.others else ""
        return self.view.name, self.hands, self.masks + many, self.depth


@dataclass(frozen=True, kw_only=True)
class Recording(ClipSource):
    """Real images with known poses: drafts of each view, by sources of hands, masks and depth."""

    dataset: ClassVar[str] = "recording"
    root: Annotated[tuple[Path, ...], arg(metavar="FOLDER...")]
    """Folders, each of a recording or of a single frame (docs/results-pixels.md)."""
    meshes: OptionalFolder = None
    """Folder of the meshes of single frames: NAME.obj, where truth.json says NAME."""
    hands: Annotated[
        tuple[str, ...], arg(metavar="found|joints|NAME=DIR...", help_behavior_hint="(default: known)")
    ] = ()
    """Hands: those that the draft finds, those of the truth's joints, or hand files DIR/VIEW.npz. By default the first
    two, the second where enough joints are known."""
    side: Annotated[Literal["left", "right"] | None, arg(help_behavior_hint="")] = None
    """The hand whose joints the truth has."""
    masks: Annotated[tuple[Literal["box", "outlines", "true"], ...], arg(help_behavior_hint="(default: all)")] = ()
    """Masks: from a box, from three outlines, or the true ones in every frame."""
    depth: Annotated[tuple[Literal["none", "sensor"], ...], arg(help_behavior_hint="(default: both)")] = ()
    """Without depth, or with the sensor's."""
    views: Annotated[tuple[int, ...], arg(metavar="N...", help_behavior_hint="(default: 1)")] = (1,)
    """Numbers of cameras of a draft. With more than one, hands are found and masks come from a box in each."""
    models: OptionalFolder = None
    """Folder of the hand models (default: the cache; getagrip doctor --fetch hands)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.views or not all(1 <= n <= MAX_VIEWS for n in self.views):
            raise UsageError(f"--views must be 1 to {MAX_VIEWS} (got {', '.join(map(str, self.views))})")
        if self.split is not None:
            raise UsageError(f"--split {self.split} cannot be used with a recording, which has no splits")

    @property
    def title(self) -> str:
        return "real images with known poses"  # paths are private

    def samples(
        self, clips: Path, debug: bool, share: SchedulingOptions | None = None
    ) -> tuple[list[Sample], list[Outcome]]:
        views = [view for root in self.root for view in read_views(root, self.meshes)]
        names = [view.name for view in views]
        if len({*names}) < len(names):
            raise UsageError(f"--root must be folders of different names (got {', '.join(names)})")
        runs = [run for view in views for count in self.views for run in self._runs(view, views, count, clips)]
        if not runs:
            why = "more than one goes with --hands found, --masks box and as many views of a recording"
            raise UsageError(f"--views {' '.join(map(str, self.views))} leaves no draft: {why}")
        return runs, []

    def _runs(self, view: View, views: list[View], count: int, clips: Path) -> list[Sample]:
        known = [DRAFTED_HANDS, *([TRUTH_JOINTS] if view.has_joints else [])]
        depths = [each for each in self.depth or DEPTH_CHOICES if each == "none" or view.depth]
        same = [one for one in views if one.cameras is not None and one.cameras == view.cameras]
        after = [] if view not in same else [*same[same.index(view) + 1 :], *same[: same.index(view)]]
        others, runs = tuple(after[: count - 1]), list[Sample]()
        if len(others) < count - 1:
            return []
        for hands, masks, depth in product(self.hands or known, self.masks or MASK_CHOICES, depths):
            source, _, folder = hands.partition("=")
            if hands == TRUTH_JOINTS and not view.has_joints:
                continue
            if others and (hands, masks) != (DRAFTED_HANDS, "box"):
                continue
            if folder:
                if not files.is_portable_name(source):
                    raise UsageError(f"--hands NAME=DIR needs a name that can be a file's (got {source!r})")
                files.inside(Path(folder), f"{view.name}.npz", "", "a hand file of each view")
            elif source not in (DRAFTED_HANDS, TRUTH_JOINTS):
                raise UsageError(f"--hands must be found, joints or NAME=DIR (got {hands!r})")
            if hands == TRUTH_JOINTS and self.side is None:
                raise UsageError(f"missing --side: {view.name} has joints, and does not say of which hand")
            name = f"{view.name}-{source}-{masks}-{depth}" + (f"-{count}-views" if others else "")
            file = Path(folder) / f"{view.name}.npz" if folder else None
            run = RecordingRun(
                name, clips / name, view=view, others=others, hands=source, masks=masks, depth=depth, hand_file=file,
                side=self.side, models=self.models,
            )  # fmt: skip
            runs.append(run)
        return runs


def read_views(root: Path, meshes: Path | None) -> list[View]:
    """Read the views of a recording, or a single frame. Raises ``InputError``."""
    if (root / SINGLE_TRUTH).exists():
        return [_read_single(root, meshes)]
    if not (root / VIEWS_FILE).exists():
        expected = f"{VIEWS_FILE} with {TRUTH_FILE}, or {SINGLE_TRUTH}; docs/results-pixels.md lists the files"
        raise InputError(root, "", f"neither {VIEWS_FILE} nor {SINGLE_TRUTH}", expected)
    import numpy as np

    from getagrip.geometry import se3
    from getagrip.io import arrays

    path = files.inside(root, VIEWS_FILE, "", "the views' cameras")
    cameras = files.read_json(path)
    if not 0 < len(cameras) <= MAX_VIEWS or not all(map(files.is_portable_name, cameras)):
        raise InputError(path, "", f"{len(cameras)} views", f"1 to {MAX_VIEWS} names of folders, with their cameras")
    source = files.inside(root, TRUTH_FILE, "", "the truth")
    truth = arrays.read(source, {"frames", "T_world_obj", "joints_world"}.__contains__)
    names = arrays.array_from_names(truth.get("frames"))
    if names is None or not 0 < len(names) <= MAX_RECORDING_FRAMES:
        raise InputError(source, "frames", "no such names", f"the names of 1 to {MAX_RECORDING_FRAMES} frames")
    poses = arrays.floats(source, truth, "T_world_obj", (len(names), 4, 4))
    _check_rigid(source, "T_world_obj", poses)
    joints = truth.get("joints_world", np.full((len(names), 21, 3), np.nan))
    if joints.shape != (len(names), 21, 3) or joints.dtype.kind != "f":
        got = f"{joints.dtype} of shape {joints.shape}"
        raise InputError(source, "joints_world", got, f"floating-point numbers of shape ({len(names)}, 21, 3)")
    mesh = _only_mesh(root)
    if mesh is None:
        raise InputError(root, "mesh", "no mesh", "the object's mesh")
    views = []
    for name, camera in cameras.items():
        fields_of = camera if isinstance(camera, dict) else {}
        fx, fy, cx, cy = (_numbers(path, f"{name}.{key}", fields_of.get(key), ()) for key in ("fx", "fy", "cx", "cy"))
        T_world_cam = _numbers(path, f"{name}.T_world_cam", fields_of.get("T_world_cam"), (4, 4))
        _check_rigid(path, f"{name}.T_world_cam", T_world_cam[None])
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        images = _images(root, f"{name}/color")
        rows = _rows_of_images(source, images, [str(each) for each in names])
        stems = tuple(image.stem for image in images)
        depth: tuple[Path, ...] = ()
        if (root / name / "depth").is_dir():
            depth = tuple(files.inside(root, f"{name}/depth/{stem}.png", "", "depth of each image") for stem in stems)
        T_cam_world = se3.inverse(T_world_cam)
        at = T_cam_world @ poses[rows], se3.transform(T_cam_world, joints[rows].astype(float))
        views.append(
            View(f"{root.resolve().name}-{name}", root / name / "color", stems, images, depth, mesh, K, *at, name, path)
        )
    return views


def _read_single(root: Path, meshes: Path | None) -> View:
    import numpy as np

    path = files.inside(root, SINGLE_TRUTH, "", "the truth")
    truth = files.read_json(path)
    pose = _numbers(path, "T_cam_obj", truth.get("T_cam_obj"), (4, 4))
    _check_rigid(path, "T_cam_obj", pose[None])
    joints = np.full((2, 21, 3), np.nan)
    if "joints_cam" in truth:  # the first joints, the wrist at least
        known = _numbers(path, "joints_cam", truth["joints_cam"], (-1, 3))
        if len(known) > 21:
            raise InputError(path, "joints_cam", f"{len(known)} joints", "at most 21, the wrist first")
        joints[:, : len(known)] = known
    image = next((root / name for name in SINGLE_IMAGES if (root / name).is_file()), None)
    if image is None:
        raise InputError(root, "", "no image", f"one of {', '.join(SINGLE_IMAGES)}")
    image = files.inside(root, image.name, "", "the image")
    depth = (files.inside(root, "depth.png", "", "depth of the image"),) if (root / "depth.png").exists() else ()
    K = _numbers(path, "K", truth.get("K"), (3, 3))
    mesh = _only_mesh(root)
    if mesh is None and meshes is None:
        raise InputError(root, "mesh", "no mesh", "the object's mesh; or --meshes DIR, where it has its name")
    if mesh is None and meshes is not None:
        mesh = files.inside(meshes, f"{truth.get('object')}.obj", "object", "the object's mesh", path)
    assert mesh is not None
    poses = np.stack([pose, pose])
    return View(root.resolve().name, image, REPEATED_NAMES, (image, image), 2 * depth, mesh, K, poses, joints)


def _only_mesh(root: Path) -> Path | None:
    """Return the mesh in a folder; None without one. Raises ``InputError`` for several."""
    from getagrip.geometry.mesh_files import MESH_SUFFIXES

    found = files.list_files(root, MESH_SUFFIXES)
    if len(found) > 1:
        named = ", ".join(path.name for path in found)
        raise InputError(root, "mesh", f"{len(found)} meshes ({files.printable(named)})", "the object's only")
    return files.inside(root, found[0].name, "", "the object's mesh") if found else None


def _images(root: Path, folder: str) -> tuple[Path, ...]:
    """Return the images of a view, by the numbers in their names."""
    from getagrip.readers.footage import ImageFolder

    images = ImageFolder.open(root / folder).paths
    if not 1 < len(images) <= MAX_RECORDING_FRAMES:
        raise InputError(root / folder, "", f"{len(images)} images", f"2 to {MAX_RECORDING_FRAMES}")
    return tuple(files.inside(root, f"{folder}/{path.name}", "", "the view's images") for path in images)


def _rows_of_images(source: Path, images: Collection[Path], names: list[str]) -> list[int]:
    """Return the row of each image in the truth, by number. Raises ``InputError`` for one without truth."""
    from getagrip.clip.match_frames import number_of

    place = {number_of(name): row for row, name in enumerate(names)}
    place.pop(None, None)
    missing = next((path.name for path in images if number_of(path.stem) not in place), None)
    if missing is not None:
        raise InputError(
            source, "frames", f"no pose of {shorten_value(missing)}", "a pose of every image, by its number"
        )
    return [place[number_of(path.stem)] for path in images]


def _numbers(path: Path, key: str, value: object, shape: tuple[int, ...]) -> np.ndarray:
    """Return finite numbers of a shape, -1 for any length. Raises ``InputError``."""
    import numpy as np

    from getagrip.io import arrays

    array = arrays.from_lists(value)
    fits = array is not None and array.ndim == len(shape) and array.dtype.kind in "fi"
    if array is None or not fits or not all(w in (-1, n) for n, w in zip(array.shape, shape, strict=True)):
        raise InputError(path, key, shorten_value(value), f"numbers of shape {shape}" if shape else "a number")
    if not np.isfinite(array).all():
        raise InputError(path, key, "NaN or infinite numbers", "finite numbers")
    return np.asarray(array, dtype=float)


def _check_rigid(path: Path, key: str, T: Float[ndarray, "n 4 4"]) -> None:
    from getagrip.geometry import se3

    if not se3.is_rigid(T).all():
        raise InputError(path, key, "a matrix that is no rigid motion", "rotations and translations [m]")
