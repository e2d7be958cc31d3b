"""Further views: of each dataset's own calibration, chosen by their lines of sight, with masks of the true poses."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.batch.import_dataset import import_clips
from getagrip.clip import Clip, read_clip
from getagrip.clip.views import View, read_views, views_of
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.rasterize import depth_and_face
from getagrip.readers.datasets.arctic import Arctic
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.dexycb.dexycb_clips import DexYcb
from getagrip.readers.datasets.ho3d import Ho3d
from getagrip.readers.datasets.hot3d.hot3d_clips import Hot3d
from getagrip.readers.datasets.tracks import Track
from getagrip.readers.datasets.views import TrackView, with_further_views
from helpers.dexycb_files import INTRINSICS, NAME, SERIALS, packed, scene, write_dexycb, write_extrinsics, write_models
from helpers.environment import DATA, Run, needs
from helpers.hand_object_files import write_ho3d, write_ho3d_calibration, write_hot3d
from helpers.motion_capture_files import write_arctic

BESIDE = se3.rigid(se3.exp_so3(np.array([0.1, -1.2, 0.05])), np.array([0.65, 0.1, 0.4]))
"""Pose of a further camera in the first one's frame, which looks at the object from its right."""


def silhouette(clip: Clip, view: View, n: int) -> np.ndarray:
    """Pixels in which the true object is before the true hand, in a view."""
    assert clip.truth is not None
    truth, T = clip.truth, np.linalg.inv(view.T_cam_view[n])
    of_object, of_hand = (
        depth_and_face(se3.transform(T @ T_cam[n], points), faces, view.K[n], view.size)[0]
        for T_cam, points, faces in (
            (truth.T_cam_obj, truth.object_vertices(clip.mesh.vertices, slice(n, n + 1))[0], clip.mesh.faces),
            (truth.T_cam_hand, truth.hand_vertices[n], clip.hand.faces),
        )
    )
    return np.asarray(of_object < of_hand)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """DexYCB's own layout, whose second camera is ``BESIDE`` the first one."""
    write_extrinsics(write_dexycb(tmp_path), np.linalg.inv(BESIDE), np.eye(4))
    return tmp_path


@pytest.mark.slow
def test_a_view_of_dexycb_is_its_calibrated_camera(root: Path) -> None:
    ((clip, masks),) = clips(DexYcb(root=root, views=2))
    (view,) = views_of(clip)
    assert (view.name, view.size, len(view.K)) == (SERIALS[1], (640, 480), len(clip))
    np.testing.assert_allclose(view.T_cam_view, np.tile(BESIDE, (len(clip), 1, 1)), atol=1e-9)
    assert view.masks.known.all()
    assert view.masks.hand is not None
    for n in (0, len(clip) - 1):
        np.testing.assert_array_equal(view.masks.object[n], silhouette(clip, view, n))
        assert view.masks.object[n].sum() > 300
    assert "rendered" in str(view.provenance["masks"])
    ((alone, own),) = clips(DexYcb(root=root))
    assert views_of(alone) == ()
    np.testing.assert_array_equal(own.object, masks.object)  # a further view changes nothing in the first one
    ((every, _),) = clips(DexYcb(root=root, views="all", timelines=True))
    assert [view.name for view in views_of(every)] == [SERIALS[1]]


@pytest.mark.slow
def test_a_view_that_never_shows_the_object_is_left_out(root: Path) -> None:
    """A view in which it is out of the image in some frames has no mask of these."""
    notes: list[str] = []
    write_extrinsics(root, se3.rigid(None, np.array([5.0, 0.0, 0.0])), np.eye(4))
    ((clip, _),) = clips(DexYcb(root=root, views=3), notes.append)
    assert views_of(clip) == ()
    assert [note.partition(": ")[2] for note in notes] == [
        "2 views, no more are calibrated", f"the object is not visible in the view {SERIALS[1]}: left out",
    ]  # fmt: skip
    _, T_cam_obj, _ = scene()
    last = np.linalg.inv(BESIDE) @ T_cam_obj[-4]
    edge = INTRINSICS.replace("308.5", str(-616.6 * last[0, 3] / last[2, 3] - 4.0))  # the last frames are out of it
    (root / "calibration" / "intrinsics" / f"{SERIALS[1]}_640x480.yml").write_text(edge)
    write_extrinsics(root, np.linalg.inv(BESIDE), np.eye(4))
    ((clip, _),) = clips(DexYcb(root=root, views=2))
    known = views_of(clip)[0].masks.known
    assert 0 < known.sum() < len(clip)


@pytest.mark.slow
def test_a_view_of_ho3d_is_another_sequence_of_its_recording(tmp_path: Path, mano: Path) -> None:
    root = write_ho3d(tmp_path, mano)
    shared = se3.rigid(se3.exp_so3(np.array([0.3, 2.0, 1.0])), np.array([1.0, 2.0, 3.0]))
    poses = {"4": shared @ se3.rigid(None, np.array([9.0, 9.0, 9.0])), "2": shared, "0": shared @ BESIDE}
    write_ho3d_calibration(root, "ABF1", poses)
    (root / "train" / "ABF10" / "meta").mkdir(parents=True)  # the camera 4 has no sequence
    ((clip, _),) = clips(Ho3d(root=root, views="all"))
    (view,) = views_of(clip)
    assert view.name == "ABF10"
    np.testing.assert_allclose(view.T_cam_view[3], BESIDE, atol=1e-9)
    np.testing.assert_allclose(view.K[0], [[612.0, 0.0, 330.5], [0.0, 613.0, 240.75], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(view.masks.object[2], silhouette(clip, view, 2))
    notes: list[str] = []
    next((root / "calibration").iterdir()).rename(root / "calibration" / "other")
    ((clip, _),) = clips(Ho3d(root=root, views=2), notes.append)
    assert views_of(clip) == ()
    assert "1 view, no more are calibrated" in notes[-1]


@pytest.mark.slow
def test_views_of_arctic_move_before_the_camera_on_the_head(tmp_path: Path, mano: Path) -> None:
    root = write_arctic(tmp_path, mano)
    path = root / "meta" / "misc.json"
    content = json.loads(path.read_text())
    worlds = np.array(content["s01"]["world2cam"])
    worlds[2] = np.linalg.inv(BESIDE) @ worlds[2]
    worlds[[0, 1, *range(3, 8)], 2, 3] -= 50.0  # behind these
    content["s01"]["world2cam"] = worlds.tolist()
    path.write_text(json.dumps(content))
    for own, other in ((0, "view3"), (3, "view0")):
        found = Arctic(root=root, mano=mano, view=own, views=2)
        ((clip, _),) = clips(found)
        (view,) = views_of(clip)
        assert (view.name, view.size) == (other, (840, 600))
        assert np.ptp(view.T_cam_view, axis=0).max() > 0.01
        np.testing.assert_array_equal(view.masks.object[4], silhouette(clip, view, 4) & view.masks.object[4])
        assert view.masks.object[4].sum() > 100
        assert clip.world is not None
        T_world_view = clip.world.T_world_cam @ view.T_cam_view
        moves = np.ptp(T_world_view if other == "view3" else T_world_view @ se3.inverse(T_world_view[:1]), axis=0)
        assert (moves.max() < 1e-9) == (other == "view3")


@pytest.mark.slow
def test_views_of_hot3d_are_the_headset_s_other_cameras(tmp_path: Path) -> None:
    root = write_hot3d(tmp_path)
    path = next(root.rglob("camera_models.json"))
    small, large = json.loads(path.read_text())
    q = se3.quaternion(se3.exp_so3(np.array([0.0, -0.3, 0.0]))[None])[0]
    mount = {"quaternion_wxyz": q.tolist(), "translation_xyz": [0.1, 0.02, 0.0]}
    params = [*large["projectionParams"][:4], 0.8, *[0.0] * 11]  # its picture does not fill the pinhole
    other = {"label": "camera-slam-right", "T_Device_Camera": mount, "projectionParams": params}
    path.write_text(json.dumps([small, large, {**large, **other}]))
    ((clip, _),) = clips(Hot3d(root=root, views="all"))
    (view,) = views_of(clip)
    assert view.name == "camera-slam-right"
    np.testing.assert_allclose(np.linalg.norm(view.T_cam_view[:, :3, 3], axis=1), np.hypot(0.1, 0.02))
    turned = se3.angle_between(view.T_cam_view[:, :3, :3], np.eye(3)[None])
    np.testing.assert_allclose(turned, 0.3, atol=1e-9)
    (source,) = Hot3d(root=root, views=2).sources()
    inside = next(iter(source.read(lambda _: None))).views[0].covered
    assert inside is not None
    assert 0.5 < inside.mean() < 1.0
    assert view.masks.ignore[:, ~inside].all()
    np.testing.assert_array_equal(view.masks.object[3][inside], silhouette(clip, view, 3)[inside])
    path.write_text(json.dumps([small, large, large]))
    with pytest.raises(InputError, match=r"camera_models.json: cameras must be different names"):
        list(clips(Hot3d(root=root, views=2)))
    assert len(list(clips(Hot3d(root=root)))) == 1


@needs(DATA / "hot3d")
@pytest.mark.slow
def test_real_headsets_have_cameras_apart_as_they_are_built() -> None:
    """Millimetres from the clips' camera, of a Quest 3 and of Aria glasses."""
    apart = {"camera-slam-right": (64, 2), "aria-slam-left": (15, 3), "aria-slam-right": (126, 3)}
    for source in Hot3d(root=DATA / "hot3d", views="all").sources():
        track = next(iter(source.read(lambda _: None)))
        of = "aria" if len(track.views) == 2 else "camera"
        for view in track.views:
            expected, off = apart[view.name.replace("camera", of)]
            far = 1e3 * np.linalg.norm(view.T_cam_view[:, :3, 3], axis=1)
            np.testing.assert_allclose(far, expected, atol=off)


def looking(across: float, up: float, turned_away: bool = False) -> TrackView:
    """A camera about the object, 0.6 m before the first one, at angles [deg] from it."""
    R = se3.exp_so3(np.radians([0.0, -across, 0.0])) @ se3.exp_so3(np.radians([-up, 0.0, 0.0]))
    middle = np.array([0.0, 0.0, 0.6])
    T = se3.rigid(R, middle - R @ middle)
    if turned_away:
        T = T @ se3.rigid(se3.exp_so3(np.array([0.0, np.pi, 0.0])))
    K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
    return TrackView(f"{across:g}-{up:g}", K, (640, 480), np.tile(T, (4, 1, 1)), "a camera")


def still(root: Path) -> Track:
    """A track of four frames, its object at rest before the camera."""
    track = next(iter(DexYcb(root=root).sources()[0].read(lambda _: None))).take(np.arange(4))
    return replace(track, T_cam_obj=np.tile(se3.rigid(None, np.array([0.0, 0.0, 0.6])), (4, 1, 1)))


def chosen(track: Track, found: list[TrackView], views: Any) -> list[str]:
    return [view.name for view in with_further_views(track, views, lambda: found, lambda _: None).views]


@pytest.mark.slow
def test_views_are_chosen_whose_lines_of_sight_differ_most(root: Path) -> None:
    track = still(root)
    found = [looking(20, 0), looking(180, 5), looking(80, 0), looking(0, 75), looking(90, 0, turned_away=True)]
    assert chosen(track, found, 2) == ["80-0"]
    assert chosen(track, found, 3) == ["80-0", "0-75"]
    assert chosen(track, found, 9)[:2] == ["80-0", "0-75"]
    assert sorted(chosen(track, found, 9)) == sorted(chosen(track, found, "all"))
    assert chosen(track, found, 1) == []
    rng = np.random.default_rng(0)
    for _ in range(20):  # in whatever order they are, the same are chosen; one more keeps those before
        some = [looking(*rng.uniform(-80, 80, 2)) for _ in range(5)]
        mixed = [some[k] for k in rng.permutation(5)]
        assert chosen(track, some, 3) == chosen(track, mixed, 3) == chosen(track, some, 4)[:2]


@pytest.mark.slow
def test_a_part_of_a_track_has_the_views_of_its_frames(root: Path) -> None:
    view = replace(looking(80, 0), known=np.array([True, False, True, True]))
    view = replace(view, T_cam_view=view.T_cam_view @ se3.rigid(t=np.arange(12.0).reshape(4, 3)))
    part = replace(still(root), views=(view,)).take(np.array([3, 1]))
    np.testing.assert_array_equal(part.views[0].T_cam_view, view.T_cam_view[[3, 1]])
    np.testing.assert_array_equal(part.views[0].known, [True, False])


@pytest.mark.slow
def test_views_are_written_with_the_clip(root: Path, tmp_path: Path, run: Run) -> None:
    assert run("import", "dexycb", root, "--views", "2", "--out", tmp_path / "out")[0] == 0
    ((made, _),) = clips(DexYcb(root=root, views=2))
    views = read_views(read_clip(tmp_path / "out" / NAME))
    assert views is not None
    for written, view in zip(views.each, views_of(made), strict=True):
        assert (written.name, written.size, written.provenance) == (view.name, view.size, view.provenance)
        np.testing.assert_allclose(written.T_cam_view, view.T_cam_view, atol=1e-9)
        np.testing.assert_array_equal(written.masks.object, view.masks.object)
        np.testing.assert_array_equal(written.masks.hand, view.masks.hand)


def test_wrong_numbers_of_views_are_refused(root: Path, tmp_path: Path, run: Run) -> None:
    for views in ("0", "-1", "65", "some", "2.5"):
        status, _, err = run("import", "dexycb", root, "--views", views, "--out", tmp_path / "out")
        assert (status, "--views" in err, "Traceback" in err) == (2, True, False), views
    with pytest.raises(UsageError, match="--views cannot be used with --whole"):
        import_clips(DexYcb(root=root, views=2, whole=True), tmp_path / "out", debug=False)
    write_models(tmp_path / "ycb")
    np.savez(tmp_path / "packed.npz", **packed())
    with pytest.raises(UsageError, match="--views 2 needs DexYCB's own layout: a packed file has one camera"):
        DexYcb(root=tmp_path / "packed.npz", meshes=tmp_path / "ycb", views=2).sources()


def numbers(text: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(text) and None


@pytest.mark.parametrize(
    ("name", "text", "named"),
    [
        ("cam_orders.txt", "0 1 3", "different digits of cameras, 2 among them"),
        ("cam_orders.txt", "2 2", "different digits"),
        ("cam_orders.txt", "", "numbers"),
        ("cam_orders.txt", "two", "numbers"),
        ("trans_0.txt", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0", "a rotation and a translation"),
        ("trans_1.txt", "nan " * 16, "numbers"),
        ("trans_1.txt", "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1", "a rotation and a translation"),
        ("cam_1_intrinsics.txt", "fx: 600, fy: 600, ppx: 320", "fx, fy, ppx and ppy"),
        ("cam_1_intrinsics.txt", "fx: 0, fy: 600, ppx: 320, ppy: 240", "fx"),
        ("cam_1_intrinsics.txt", None, "no such file"),
    ],
)
def test_a_broken_calibration_of_ho3d_is_named(
    tmp_path: Path, mano: Path, name: str, text: str | None, named: str
) -> None:
    root = write_ho3d(tmp_path, mano)
    folder = write_ho3d_calibration(root, "ABF1", {"2": np.eye(4), "0": BESIDE})
    (root / "train" / "ABF10" / "meta").mkdir(parents=True)
    if text is None:
        (folder / name).unlink()
    else:
        (folder / name).write_text(text)
    (source,) = (source for source in Ho3d(root=root, views=2).sources() if "ABF12" in source.name)
    with pytest.raises(InputError, match=rf"{name}.*{named}"):
        list(source.read(lambda _: None))
    (source,) = (source for source in Ho3d(root=root).sources() if "ABF12" in source.name)
    assert len(list(source.read(lambda _: None))) == 1  # one view needs none


@pytest.mark.slow
def test_a_broken_calibration_of_dexycb_is_named(root: Path) -> None:
    (source,) = DexYcb(root=root, views=2).sources()
    intrinsics = root / "calibration" / "intrinsics" / f"{SERIALS[1]}_640x480.yml"
    intrinsics.write_text("color: {}")
    with pytest.raises(InputError, match=f"{SERIALS[1]}_640x480.yml: color"):
        list(source.read(lambda _: None))
    write_extrinsics(root, np.zeros((4, 4)), np.eye(4))
    with pytest.raises(InputError, match=f"extrinsics.{SERIALS[0]}"):
        list(source.read(lambda _: None))
    next(root.glob("calibration/*/extrinsics.yml")).unlink()
    with pytest.raises(InputError, match=r"extrinsics.yml: no such file|extrinsics.yml must be"):
        list(source.read(lambda _: None))
