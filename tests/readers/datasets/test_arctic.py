"""The ARCTIC reader, on small files of its layout with known answers, and on broken files; the part that turns."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from getagrip.batch.import_dataset import import_clips
from getagrip.clip import read_clip, read_masks, write_clip
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import depth_and_face
from getagrip.readers.datasets import arctic, cutting, tracks
from getagrip.readers.datasets.arctic import Arctic, read_template
from getagrip.stable_grasps.definition import Definition, GraspOptions
from getagrip.stable_grasps.find import CutRules, segment
from helpers.environment import Run, folder_of
from helpers.held_ball import FRAMES, TAKEN, Hostile, ball, posed, same_points, save_pickled  # fmt: skip
from helpers.motion_capture_files import K_EGO, OFFSET, OPENED, scene, write_arctic

CUT = CutRules(Definition(tau=0.5, contact=0.0, shortest=20))


@pytest.fixture
def root(tmp_path: Path, mano: Path) -> Path:
    return write_arctic(tmp_path, mano)


def read(root: Path, mano: Path, **options: Any) -> list[tracks.Track]:
    """The tracks of the one sequence."""
    (source,) = Arctic(root=root, mano=mano, **options).sources()
    return list(source.read(lambda _: None))


def clips(root: Path, mano: Path, whole: bool = False) -> list[Any]:
    notes: list[str] = []
    found = cutting.cut_into_grasps(read(root, mano), notes.append, CUT, whole)
    return [cutting.clip_of_piece(piece, 20, notes.append) for piece in found]


@pytest.mark.slow
def test_poses_and_hands_are_those_that_were_written(root: Path, mano: Path) -> None:
    left, right = read(root, mano)
    of = scene()
    assert (left.side, right.side) == ("left", "right")
    assert right.name == "s01--ball_use_01--ball--right"
    assert right.world is not None
    np.testing.assert_allclose(right.world.T_world_cam, se3.inverse(of["T_cam_world"]), atol=1e-12)
    np.testing.assert_allclose(right.times, np.arange(FRAMES) / 30.0)
    np.testing.assert_allclose(right.hand.T_cam_hand, of["T_cam_hand"], atol=1e-6)
    for track in (left, right):
        np.testing.assert_allclose(track.hand.vertices[3], posed(mano, track.side)[1].vertices, atol=1e-6)
    np.testing.assert_array_equal(right.numbers, np.arange(FRAMES) + OFFSET)
    mesh = ball(0.04)
    for n in (0, OPENED):  # metres from millimetres, the top turned about -z
        turned = np.asarray(mesh.vertices) @ se3.exp_so3(np.array([0.0, 0.0, -of["angle"][n]])).T
        expected = np.where(np.asarray(mesh.vertices)[:, 1:2] > 0, turned, mesh.vertices)
        assert same_points(right.surface(n)[0], se3.transform(of["T_cam_obj"][n], expected), 1e-6)


@pytest.mark.slow
def test_the_view_on_the_head_is_of_a_third_of_the_size(root: Path, mano: Path) -> None:
    track = read(root, mano)[0]
    assert track.size == (840, 600)
    np.testing.assert_allclose(track.K, [[516.0, 0.0, 420.0], [0.0, 513.0, 300.0], [0.0, 0.0, 1.0]])


@pytest.mark.slow
def test_a_fixed_view_stands_still(root: Path, mano: Path) -> None:
    head, fixed = read(root, mano)[1], read(root, mano, view=8)[1]
    T_world = se3.inverse(scene()["T_cam_world"])
    np.testing.assert_allclose(fixed.T_cam_obj, scene()["T_cam_world"][0] @ T_world @ head.T_cam_obj, atol=1e-9)
    with pytest.raises(UsageError, match=r"--view must be .*got 9"):
        Arctic(root=root, mano=mano, view=9).sources()


@pytest.mark.slow
def test_opening_ends_a_grasp(root: Path, mano: Path) -> None:
    ((clip, masks),) = clips(root, mano)
    assert clip.name == "s01--ball_use_01--ball--right"
    assert clip.frames == tuple(f"{n + OFFSET:05d}" for n in range(TAKEN, OPENED))
    np.testing.assert_allclose(clip.truth.articulation, 0.03)
    assert "between 1.7 and 1.7 degrees" in clip.provenance["articulation"]
    assert masks.object.shape == (len(clip), 600, 840)
    assert segment(clip, Definition())[1] == [(0, len(clip) - 1)]


@pytest.mark.slow
def test_masks_show_the_object_and_ignore_both_hands(root: Path, mano: Path) -> None:
    ((clip, masks),) = clips(root, mano)
    left, right = read(root, mano)
    surfaces = [right.surface(TAKEN)] + [
        (se3.transform(t.hand.T_cam_hand[TAKEN], t.hand.vertices[TAKEN]), t.hand.faces) for t in (right, left)
    ]
    depth = np.stack([depth_and_face(v, f, clip.K[0], clip.size)[0] for v, f in surfaces])
    np.testing.assert_array_equal(masks.object[0], (depth.argmin(axis=0) == 0) & np.isfinite(depth[0]))
    np.testing.assert_array_equal(masks.ignore[0], depth.argmin(axis=0) > 0)
    np.testing.assert_array_equal(masks.hand[0], depth.argmin(axis=0) == 1)
    assert masks.object[0].sum() > 300
    assert masks.ignore[0].sum() > 300


@pytest.mark.slow
def test_whole_sequences_are_not_cut_where_the_joint_turns(root: Path, mano: Path) -> None:
    """So that `segment` finds in them what an import finds."""
    found = clips(root, mano, whole=True)
    assert [(clip.side, len(clip), masks) for clip, masks in found] == [("left", FRAMES, None), ("right", FRAMES, None)]
    assert segment(found[1][0], CUT.definition)[1] == [(TAKEN, OPENED - 1)]
    assert found[1][0].provenance["first_frame"] == OFFSET


@pytest.mark.slow
def test_a_template_may_hold_vertices_twice_and_unused_ones(root: Path, mano: Path, tmp_path: Path) -> None:
    folder = root / "meta" / "object_vtemplates" / "ball"
    lines = (folder / "mesh.obj").read_text().splitlines()
    first = next(n for n, line in enumerate(lines) if line.startswith("v "))
    on_axis = ["v 0 0 55", "v 0 0 55.0000001", "v 0 0 60", "v 0 5 55", "v 5 0 55"]
    faces = [line for line in lines if line.startswith("f ")]
    count = sum(line.startswith("v ") for line in lines)
    fin = [f"f {count + 1} {count + 4} {count + 5}", f"f {count + 2} {count + 5} {count + 4}"]
    (folder / "mesh.obj").write_text("\n".join([*lines[:first], *_vertices(lines), *on_axis, *faces, *fin]))
    parts = json.loads((folder / "parts.json").read_text())
    (folder / "parts.json").write_text(json.dumps([*parts, 0, 1, 0, 0, 1]))
    (made, masks), *_ = clips(root, mano)
    clip = read_clip(write_clip(made, masks, tmp_path / "clip"))
    assert clip.truth.joint.moves.sum() > 10
    assert clip.truth.joint.moves.shape == (len(clip.mesh.vertices),) == (count + 3,)


def _vertices(lines: list[str]) -> list[str]:
    return [line for line in lines if line.startswith("v ")]


def test_neutral_frames_are_of_the_shape_alone() -> None:
    """Along the axis of a long round thing, across a flat one, whatever frame it is in; its middle at the origin."""
    rng = np.random.default_rng(0)
    for stretch in ([1.0, 1.0, 3.0], [1.0, 1.05, 0.2]):
        mesh = ball(0.03)
        vertices = np.asarray(mesh.vertices) / [1.0, 1.05, 1.2] * stretch
        vertices = np.where(vertices > 0, 1.1 * vertices, vertices)  # so that no direction is like its opposite
        own = arctic.neutral_frame(Mesh(vertices, np.asarray(mesh.faces)))
        assert abs(own[2, 2]) > 0.95
        seen = se3.transform(own, vertices)
        np.testing.assert_allclose(seen.min(axis=0), -seen.max(axis=0), atol=1e-12)
        T = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
        moved = Mesh(se3.transform(T, vertices), np.asarray(mesh.faces))
        np.testing.assert_allclose(arctic.neutral_frame(moved) @ T, own, atol=1e-9)


@pytest.mark.slow
def test_import_writes_clips_and_keeps_them(
    root: Path, mano: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out = tmp_path / "out"
    grasps = GraspOptions(contact_mm=0.0, shortest=2)  # the paper's: the authors' list has no grasp before the opening
    assert import_clips(Arctic(root=root, mano=mano, grasps=grasps), out, debug=False) == 0
    name = "s01--ball_use_01--ball--right"
    assert {path.name for path in out.iterdir()} == {
        name,
        f"{name}--2",
        "grasps.json",
        "ledger.sqlite",
    }  # before and after opening
    clip = read_clip(out / name)
    assert read_masks(clip).object.any()
    assert clip.provenance["subject"] == "s01"
    assert "no stable grasp" in capsys.readouterr().err  # of the left hand
    assert import_clips(Arctic(root=root, mano=mano, grasps=grasps), out, debug=False) == 0
    assert "0 clips, 2 already there, 0 of 1 sequences failed" in capsys.readouterr().out


@pytest.mark.slow
def test_wrong_calls_are_refused(root: Path, mano: Path, tmp_path: Path, run: Run) -> None:
    status, _, err = run("import", "arctic", root, "--mano", mano, "--meshes", tmp_path, "--out", tmp_path / "out")
    assert (status, "--meshes" in err) == (2, True)
    with pytest.raises(UsageError, match=r"--mano: ARCTIC holds .* MANO_LEFT.pkl and MANO_RIGHT.pkl"):
        Arctic(root=root).sources()
    with pytest.raises(UsageError, match="--mano must be a folder"):
        Arctic(root=root, mano=tmp_path).sources()
    with pytest.raises(InputError, match="raw_seqs"):
        Arctic(root=tmp_path / "mano", mano=mano).sources()


def edited(path: Path, *keys: str, value: Any) -> None:
    """Change one value of a pickled dictionary; leave it away where the new one is None."""
    content = np.load(path, allow_pickle=True).item()
    inner = content
    for key in keys[:-1]:
        inner = inner[key]
    if value is None:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    save_pickled(path, content)


NAN = np.full((FRAMES, 3), np.nan)


@pytest.mark.parametrize(
    ("keys", "value", "named"),
    [
        (("right",), None, "None"),
        (("left", "rot"), None, "missing left.rot"),
        (("left", "rot"), NAN, "got 96 NaN"),
        (("right", "pose"), np.zeros((FRAMES, 44)), "right.pose"),
        (("right", "trans"), np.zeros((FRAMES + 1, 3)), "right.trans"),
        (("right", "trans"), np.array([None] * FRAMES), "right.trans"),
        (("right", "shape"), "ten", "right.shape"),
        (("right", "shape"), np.zeros(9), "right.shape"),
        (("right", "trans"), Hostile(), "system.; nothing in it was run"),
    ],
)
@pytest.mark.slow
def test_broken_hands_are_named(root: Path, mano: Path, keys: tuple[str, ...], value: Any, named: str) -> None:
    edited(root / "raw_seqs" / "s01" / "ball_use_01.mano.npy", *keys, value=value)
    with pytest.raises(InputError, match=rf"ball_use_01\.mano\.npy.*{named}"):
        read(root, mano)


def test_absurdly_long_sequences_are_refused_before_memory_is_taken(root: Path, mano: Path) -> None:
    file = root / "raw_seqs" / "s01" / "ball_use_01.object.npy"
    np.save(file, np.zeros((tracks.MAX_SEQUENCE_FRAMES + 1, 7)))
    with pytest.raises(InputError, match=r"object\.npy must be at most 20000.*got 20001 frames"):
        read(root, mano)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("R_k_cam_np", np.zeros((FRAMES, 3, 3))),
        ("T_k_cam_np", np.zeros((FRAMES, 4, 1))),
        ("intrinsics", np.eye(4)),
        ("intrinsics", -K_EGO),
        ("intrinsics", None),
    ],
)
@pytest.mark.slow
def test_broken_cameras_are_named(root: Path, mano: Path, key: str, value: Any) -> None:
    edited(root / "raw_seqs" / "s01" / "ball_use_01.egocam.dist.npy", key, value=value)
    with pytest.raises(InputError, match=r"egocam\.dist\.npy"):
        read(root, mano)


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("raw_seqs/s01/ball_use_01.object.npy", b"\x93NUMPY\x01\x00", "header"),
        ("raw_seqs/s01/ball_use_01.mano.npy", b"\x93NUMPY\x01\x00", "header"),
        ("raw_seqs/s01/ball_use_01.mano.npy", b"", "does not load"),
        ("raw_seqs/s01/ball_use_01.mano.npy", b"ccommon.xdict\nxdict\n.", "common.xdict.xdict"),  # as estimates have it
        ("meta/misc.json", b"{}", "s01"),
        ("meta/misc.json", b"[]", "JSON list"),
        ("meta/misc.json", b'{"s01": {"image_size": [[2800, 2000]], "ioi_offset": 0}}', "s01.image_size"),
        ("meta/misc.json", b'{"s01": {"image_size": [[2800], [1, 2]], "ioi_offset": 0}}', "s01.image_size"),
        ("meta/object_vtemplates/ball/parts.json", b"[0, 1]", "2 numbers"),
        ("meta/object_vtemplates/ball/parts.json", b"[0, [", "invalid JSON"),
        ("meta/object_vtemplates/ball/mesh.obj", b"v 1 2", "line 1"),
        ("meta/object_vtemplates/ball/mesh.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3", "0.001 m large"),
    ],
)
@pytest.mark.slow
def test_broken_files_are_named(root: Path, mano: Path, name: str, content: bytes, named: str) -> None:
    (root / name).write_bytes(content)
    with pytest.raises(InputError, match=rf"{Path(name).name}.*{named}"):
        read(root, mano)


@pytest.mark.parametrize("name", ["ball_use_01.mano.npy", "ball_use_01.egocam.dist.npy", "ball_use_01.object.npy"])
@pytest.mark.slow
def test_truncated_and_missing_files_are_named(root: Path, mano: Path, name: str) -> None:
    path = root / "raw_seqs" / "s01" / name
    content = path.read_bytes()
    for length in (20, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match=name):
            read(root, mano)
    path.unlink()
    with pytest.raises((InputError, UsageError), match=r"no such file|raw_seqs"):
        read(root, mano)


@pytest.mark.slow
def test_wrong_shapes_of_poses_are_named(root: Path, mano: Path) -> None:
    np.save(root / "raw_seqs" / "s01" / "ball_use_01.object.npy", np.zeros((FRAMES, 6)))
    with pytest.raises(InputError, match=r"must be .*\(any, 7\) \(got .*\(32, 6\)\)"):
        read(root, mano)


@folder_of("GETAGRIP_ARTIGRASP")
def test_real_hands_and_objects(folder: Path, mano: Path) -> None:
    """ArtiGrasp holds ARCTIC's own files of these two kinds; synthetic hands take their parameters."""
    rsc = folder / "rsc" if (folder / "rsc").is_dir() else folder
    file = sorted(rsc.glob("arctic/*/s[0-9]*/*.object.npy"))[0]
    poses = np.load(file)
    assert poses.shape[1] == 7
    hands = rsc / "mano_double" / file.parent.name / file.name.replace(".object.", ".mano.")
    T_cam_world = np.tile(np.eye(4), (len(poses), 1, 1))
    read = arctic._read_hands(hands, mano, T_cam_world, len(poses))
    joints = np.load(rsc / "mano_double" / "ee" / file.parent.name / file.name.replace(".object.npy", "_r.npy"))
    right = np.arange(3, 32 * (len(poses) // 32))
    wrists = read["right"].T_cam_hand[right] @ np.append(posed(mano, "right")[0].model.joints[0], 1.0)
    assert np.median(np.linalg.norm(wrists[:, :3] - joints[right, 0], axis=1)) < 0.02  # of another hand's shape


def box_template(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """A box with a lid [mm], as ARCTIC has its templates; its vertices and which are the lid's."""
    lid = trimesh.creation.box((120.0, 90.0, 30.0))
    base = trimesh.creation.box((120.0, 90.0, 60.0))
    lid.apply_translation((0.0, 0.0, 60.0))
    joined = trimesh.Trimesh(
        np.concatenate([base.vertices, lid.vertices]),
        np.concatenate([base.faces, lid.faces + len(base.vertices)]),
        process=False,
    )
    top = np.arange(len(joined.vertices)) >= len(base.vertices)
    folder.mkdir(exist_ok=True)
    for name, mesh in (("mesh", joined), ("top", lid), ("bottom", base)):
        mesh.export(folder / f"{name}.obj")
    (folder / "parts.json").write_text(json.dumps(np.where(top, 0, 1).tolist()))
    return np.asarray(joined.vertices), top


@pytest.mark.parametrize("beside", [True, False])
def test_part_0_turns_as_in_arctics_own_code(tmp_path: Path, beside: bool) -> None:
    vertices, top = box_template(tmp_path)
    if not beside:
        (tmp_path / "top.obj").unlink()
    template, angle = read_template(tmp_path), np.radians(60.0)
    k, x = np.array([0.0, 0.0, -1.0]), vertices / 1000.0  # Rodrigues about k
    turned = x * np.cos(angle) + np.cross(k, x) * np.sin(angle) + np.outer(x @ k, k) * (1.0 - np.cos(angle))
    found = se3.transform(
        se3.inverse(template.T_neutral_template), template.joint.at(template.mesh.vertices, np.array([angle]))[0]
    )
    np.testing.assert_allclose(found, np.where(top[:, None], turned, x), atol=1e-6)


def test_numbers_against_the_parts_meshes_are_refused(tmp_path: Path) -> None:
    _, top = box_template(tmp_path)
    (tmp_path / "parts.json").write_text(json.dumps(np.where(top, 1, 0).tolist()))
    with pytest.raises(InputError, match=r"parts\.json.*top\.obj and bottom\.obj"):
        read_template(tmp_path)
