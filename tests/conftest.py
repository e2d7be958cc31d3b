"""Shapes in type hints are checked while the tests run, and only then; a small valid clip for all tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

# Modules of plain functions and data, without compiled kernels; `hands` refuses wrong shapes itself.
PLAIN = ("se3", "camera", "mesh", "arrays", "files", "images", "clip", "result", "metrics")
install_import_hook([f"getagrip.{name}" for name in PLAIN], "beartype.beartype")

# The same examples on every machine, however busy it is.
settings.register_profile(
    "here", deadline=None, max_examples=30, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("here")

from getagrip.cli import main  # noqa: E402
from getagrip.clip import FINGERS, Clip, HandTrack, Masks, Truth, write_clip  # noqa: E402
from getagrip.geometry.mesh import Mesh  # noqa: E402

Run = Callable[..., tuple[int, str, str]]
FullDisk = Callable[[int], AbstractContextManager[None]]

BOX_FACES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ]
)  # fmt: skip


def box(x: float, y: float, z: float) -> Mesh:
    """A box about the origin, its faces outward."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) - 0.5
    return Mesh(corners * [x, y, z], BOX_FACES)


def small_clip(frames: int = 3, seed: int = 0) -> tuple[Clip, Masks]:
    """A valid clip of almost nothing: a box for an object, a box with five fingertips for a hand."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[:, :3, 3] = [0.0, 0.0, 0.5] + 0.01 * rng.standard_normal((frames, 3))
    hand = HandTrack(
        vertices=box(0.2, 0.1, 0.03).vertices + 0.001 * rng.standard_normal((frames, 8, 3)),
        faces=BOX_FACES,
        T_cam_hand=T,
        regions={name: np.array([n, n + 1]) for n, name in enumerate((*FINGERS, "palm_edge"))},
        joints=0.1 * rng.standard_normal((frames, 21, 3)),
    )
    seen = np.zeros((frames, 24, 32), dtype=bool)
    seen[:, 8:16, 10:20] = True
    ignore = np.roll(seen, 6, axis=2) & ~seen
    clip = Clip(
        folder=Path("nowhere"),
        name="small",
        category="box",
        side="right",
        fps=30.0,
        frames=tuple(f"{n:04d}" for n in range(frames)),
        size=(32, 24),
        K=np.tile([[40.0, 0.0, 16.0], [0.0, 41.0, 12.0], [0.0, 0.0, 1.0]], (frames, 1, 1)),
        mesh=box(0.05, 0.07, 0.11),
        scale="known",
        hand=hand,
        truth=Truth(T_cam_obj=T, scale=1.0, T_cam_hand=hand.T_cam_hand, hand_vertices=hand.vertices),
        provenance={"hands": "made up"},
    )
    return clip, Masks(seen, ignore)


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder, hidden ones too: their bytes by their paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture
def clip_folder(tmp_path: Path) -> Path:
    """The small clip in a folder that a test may break."""
    return write_clip(*small_clip(), tmp_path / "small")


@pytest.fixture
def refused(tmp_path: Path) -> Callable[..., str]:
    """Assert that reading raises an InputError of one line with certain words; returns the line."""
    from getagrip.errors import InputError

    def check(read: Callable[[], object], *words: str) -> str:
        with pytest.raises(InputError) as caught:
            read()
        message = str(caught.value)
        assert "\n" not in message
        assert ", expected " in message
        for word in words:
            assert word in message
        return message

    return check


@pytest.fixture
def full_disk() -> FullDisk:
    """Within it no file grows beyond so many bytes: a write stores a part, and then fails, as on a full disk."""
    resource = pytest.importorskip("resource")

    @contextmanager
    def limited(size: int) -> Iterator[None]:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return limited


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Call the command line; returns the exit status, stdout and stderr."""

    def call(*args: object) -> tuple[int, str, str]:
        capsys.readouterr()
        try:
            status = main([str(arg) for arg in args])
        except SystemExit as exit_:
            status = int(exit_.code or 0)
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err or "--debug" in args
        return status, out, err

    return call
