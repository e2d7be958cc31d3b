"""Files of a project: clips with segments, results, meshes, poses, lists, databases, and hands put into clips."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh

from fuzz.child import SHARED, Read, Reader
from getagrip.batch.ledger import Ledger, LedgerEntry
from getagrip.bench.inputs.hand_sources import HandSource, WithHands
from getagrip.cli import new_clip
from getagrip.cli.import_hands import HandFile
from getagrip.clip import Clip, Joint, Masks, Segment, find_masks, input_sha256, read_clip, read_masks, write_clip
from getagrip.clip import read as read_module
from getagrip.clip.clip import World
from getagrip.clip.masks import read_observed
from getagrip.clip.object_poses import read_pose_file
from getagrip.clip.read import read_header
from getagrip.fitting.options import Options
from getagrip.fitting.solver.initial_poses import read_learnt, read_priors_folder
from getagrip.geometry.mesh_files import parse_mesh, read_mesh
from getagrip.io import arrays
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.external import read_meshes
from getagrip.metrics.evaluate.results import read_result_clip_masks
from getagrip.reconstruct import reconstruct
from getagrip.report.pages.result_page import write_page
from getagrip.report.pictures.result_view import View
from getagrip.result import SegmentResult, read_result, read_result_record, write_result
from getagrip.stable_grasps import grasp_lists as stable_grasps_grasp_lists
from getagrip.studio.store import labels, tasks
from getagrip.studio.store.mark_store import Store
from getagrip.timelines.detect.detect_segments import find_segments
from helpers.clips import box, small_clip
from helpers.results import true_result


def whole_clip(folder: Path) -> None:
    """A clip with all that a clip can have."""
    clip, masks = small_clip()
    assert clip.truth is not None
    moves = np.arange(8) < 4
    joint = Joint(moves, np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.5)
    truth = replace(clip.truth, articulation=np.zeros(3), joint=joint)
    world = World(np.tile(np.eye(4), (3, 1, 1)), np.array([0.0, 0.0, 1.0]))
    write_clip(replace(clip, truth=truth, world=world, times=np.arange(3) / 30.0), masks, folder / "clip")


def read_whole_clip(folder: Path) -> None:
    """All that is read of a clip anywhere."""
    read_header(folder / "clip")
    input_sha256(folder / "clip")
    clip = read_clip(folder / "clip")
    read_observed(clip)
    find_masks(clip)
    read_masks(clip)


def a_result(folder: Path) -> None:
    """A result of the small clip."""
    write_result(true_result(small_clip()[0], None), folder / "result")


def mesh(suffix: str) -> Reader:
    """A file of meshes."""

    def write(folder: Path) -> None:
        shape = box(0.05, 0.07, 0.11)
        trimesh.Trimesh(shape.vertices, shape.faces).export(folder / f"a{suffix}")

    def read(folder: Path) -> None:
        new_clip.read_own_mesh(new_clip.MeshOptions(folder / f"a{suffix}", size_mm=100.0))
        parse_mesh(folder / f"a{suffix}")
        read_mesh(folder / f"a{suffix}")

    return Reader(write, read)


def frame_meshes(folder: Path) -> None:
    """A mesh for each frame of the small clip."""
    for n in range(3):
        (folder / f"{n:04d}.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0 1 0 0\nvn 0 0 1\nf 1/1/1 2//1 -1\n")


def a_ledger(folder: Path) -> None:
    """A ledger of three tasks."""
    with Ledger(folder) as ledger:
        for name in "abc":
            entry = ledger.claim(name, "options", "code")
            assert entry is not None
            ledger.end(replace(entry, state="failed" if name == "b" else "done", about={"iou": 0.5}))


def use_ledger(folder: Path) -> None:
    """What a driver does with a ledger."""
    with Ledger(folder) as ledger:
        ledger.claim("a", "options", "code")
        ledger.end(LedgerEntry("a", "done", about={"iou": 0.9}))
        list(ledger.entries())


def marks(folder: Path) -> None:
    """A database of a mark and a key frame."""
    store = Store(folder / "marks.sqlite")
    with store.database.transaction() as db:
        db.execute(
            "INSERT INTO versions (change, tab, at, mark, task, annotator, start, deleted) "
            "VALUES ('c', 't', 'now', 'm', 'v', 'ann', 3, 0)"
        )
        db.execute(
            "INSERT INTO keyframe_versions (change, tab, at, keyframe, task, annotator, grasp, frame, joints, "
            """outlines, hidden, deleted) VALUES ('c', 't', 'now', 'k', 'v', 'ann', 'm', 3, '{"0": [1, 2]}', """
            """'{"o": {"of": "object", "closed": true, "points": [[1, 1], [1, 5], [5, 5]]}}', 0, 0)"""
        )
    store.drafts.put("m", "masks", "basis", {3: {"object": [[[1, 1], [1, 5], [5, 5]]]}})
    store.close()


def use_marks(folder: Path) -> None:
    """What the page asks for."""
    store = Store(folder / "marks.sqlite")
    store.marks.standing()
    store.marks.history("m")
    for keyframe in store.keyframes.standing():
        keyframe.labels()
    store.keyframes.history("k")
    store.drafts.since("m", 0)
    store.drafts.bases("m", "masks")
    store.close()


def clicked(folder: Path) -> None:
    """Labels of two frames."""
    joints = [None, [12.5, 7.5], *[None] * 19]
    frames = {"3": {"joints": joints, "object": [[[1, 1], [9, 1], [9, 9]]], "front": []}, "5": {"object": []}}
    content = {"video": "a.mp4", "size": [64, 48], "side": "left", "fps": 30.0, "first": 3, "last": 9, "frames": frames}
    (folder / "labels.json").write_text(json.dumps(content))


GRASP = {"sequence": "s01--box--left", "side": "left", "object": "box", "start": 3, "end": 9, "duration": 1.5}


TIMELINE = {
    "seq_name": "P0001_a", "cat": "box", "total_start": 0, "total_end": 90,
    "segments": [{"st": 1, "ed": 30, "ref": "inhand", "side": "left"},
                 {"st": 31, "ed": 40, "ref": "scene_static", "side": None}],
}  # fmt: skip


def grasp_lists(folder: Path) -> None:
    """Lists of grasps in each format."""
    stable_grasps_grasp_lists.write_listed_grasps(
        folder / "a.json",
        [stable_grasps_grasp_lists.ListedGrasp("s01--box--left", "left", "box", "3", "9", 1.5)],
        {"tau": 0.5},
    )
    (folder / "b.json").write_text(json.dumps([GRASP]))
    (folder / "c.csv").write_text(f"{','.join(GRASP)}\n{','.join(map(str, GRASP.values()))}\n")
    (folder / "d.json").write_text(json.dumps([TIMELINE]))


def use_list(path: Path) -> None:
    """What is asked of a list."""
    names = tuple(f"{n:05d}" for n in range(20))
    for grasp in stable_grasps_grasp_lists.read_listed_grasps(path).grasps:
        grasp.is_of("s01--box--left", "left", "box")
        for frames, origin in ((names, None), (names, 3), (("a", "b"), None)):
            grasp.positions(frames, origin)


def each(read: Callable[[Path], object]) -> Callable[[Path], None]:
    """A reader of each file in a folder, the others read though one is refused."""
    from getagrip.errors import GetagripError

    def read_each(folder: Path) -> None:
        refused = None
        for path in sorted(folder.iterdir()):
            try:
                read(path)
            except GetagripError as error:
                refused = error
        if refused is not None:
            raise refused

    return read_each


def poses(folder: Path) -> None:
    """Poses of three frames in each format."""
    T = np.tile(np.eye(4), (3, 1, 1))
    arrays.write(folder / "a.npz", {"T_cam_obj": T, "frames": np.arange(3), "scale": np.array(1.0)})
    np.save(folder / "b.npy", T)
    np.savetxt(folder / "c.txt", T.reshape(-1, 4))
    (folder / "d.json").write_text(json.dumps(T.tolist()))
    (folder / "e.json").write_text(json.dumps({f"{n}": T[n].tolist() for n in range(3)}))
    (folder / "f.json").write_text(json.dumps({"T_hand_obj": T[:, :3].tolist(), "frames": ["0", "1", "2"], "scale": 1}))
    gt = {str(n): [{"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0.0, 0.0, 500.0]}] for n in range(3)}
    (folder / "g.json").write_text(json.dumps(gt))
    (folder / "h.csv").write_text("scene_id,im_id,obj_id,score,R,t,time\n1,0,1,0.9,1 0 0 0 1 0 0 0 1,0 0 500,-1\n")


def learnt(folder: Path) -> None:
    """Learnt poses, and a folder of the authors'."""
    from getagrip.fitting.solver.cluster_poses import LearntGrasps, true_grasp_pose

    clips = [replace(small_clip(seed=n)[0], name=f"c{n}", provenance={"subject": "ann"}) for n in range(2)]
    LearntGrasps(tuple(true_grasp_pose(clip) for clip in clips), k=10).write(folder / "poses.npz")
    (folder / "box").mkdir()
    np.save(folder / "box" / "left_1.npy", 1.1 * np.eye(4))


def use_learnt(folder: Path) -> None:
    """Both."""
    read_learnt(folder / "poses.npz")
    read_priors_folder(folder)


def candidates(folder: Path) -> None:
    rows = [{"video": "P01_01", "start": 10, "end": 90, "side": "left", "category": "cup", "entity": "red cup"}]
    (folder / "a.json").write_text(json.dumps(rows))
    (folder / "b.csv").write_text(f"{','.join(rows[0])}\n{','.join(map(str, rows[0].values()))}\n")


def segments(folder: Path) -> None:
    rows = [
        {"state": "static", "first": "1", "last": "2"},
        {"state": "grasp", "first": "3", "last": "9", "side": "left"},
    ]
    content = {"a": {"segments": rows, "source": "marked by ann", "still_camera": "as ann states"}}
    (folder / "segments.json").write_text(json.dumps(content))


def use_segments(folder: Path) -> None:
    read_module.read_segment_list(folder / "segments.json", ["a"]).at([f"{n:04d}" for n in range(8)], has_world=True)


FEW = Options(inits=2, frames=2)


def uncut() -> tuple[Clip, Masks]:
    """The small clip, first still and then held."""
    clip, masks = small_clip(frames=4)
    world = World(np.tile(np.eye(4), (4, 1, 1)), np.array([0.0, 0.0, 1.0]), support=-0.5)
    segments = Segment("static", 0, 1), Segment("grasp", 2, 3, "right")
    return replace(clip, world=world, segments=segments), masks


def warmed(write: Read, read: Read) -> Reader:
    """A reader that needs kernels: they are loaded here, since to load them looks like a pickle that names classes."""

    def write_and_read(folder: Path) -> None:
        write(folder)
        read(folder)

    return Reader(write_and_read, read)


def write_uncut(folder: Path) -> None:
    write_clip(*uncut(), folder / "clip")


def a_timeline(folder: Path) -> None:
    """What is made of it."""
    clip = read_clip(folder / "clip")
    reconstruct(clip, read_masks(clip), FEW)


def found(folder: Path) -> None:
    """What is found in it."""
    clip = read_clip(folder / "clip")
    find_segments(clip, read_masks(clip), options=FEW)


def listed(folder: Path) -> None:
    """Segments beside a clip."""
    clip, masks = uncut()
    write_clip(replace(clip, world=None, segments=()), masks, folder / "clip")
    given = read_module.SegmentList.of(clip, clip.segments, "marked by ann", "as ann states")
    (folder / "segments.json").write_text(json.dumps({"small": given.fields, "other": given.fields}))


def use_listed(folder: Path) -> None:
    given = read_module.read_segment_list(folder / "segments.json", ["small"])
    clip = read_module.add_segments(read_clip(folder / "clip"), given)
    with TemporaryDirectory(dir=SHARED) as out:
        header = replace(read_header(folder / "clip"), folder=Path(out))
        assert read_module.write_clip_segments(header, given) == clip.segments


def report(folder: Path) -> None:
    """A result of a timeline, beside its clip."""
    clip, masks = uncut()
    write_clip(clip, masks, folder / "clip")
    names = [(clip.frames[s.first], clip.frames[s.last]) for s in clip.segments]
    rows = [
        SegmentResult(state=s.state, first=a, last=b, iou=0.9) for s, (a, b) in zip(clip.segments, names, strict=True)
    ]
    rows[0] = replace(rows[0], T_world_obj=np.eye(4))
    result = replace(true_result(clip, None), segments=tuple(rows), T_cam_hand=clip.hand.T_cam_hand)
    write_result(result, folder / "result", input_sha256(folder / "clip"))


def write_report(folder: Path) -> None:
    """What ``report`` makes of it."""
    result, clip, masks = read_result_clip_masks(folder / "result", folder / "clip")
    view, evaluation = View.of(result, clip, masks), evaluate(result, clip, masks)
    with TemporaryDirectory(dir=SHARED) as out:
        write_page(view, evaluation, read_result_record(folder / "result"), Path(out) / "report.html")


def hands(folder: Path) -> None:
    """A hand file of some frames, as ``clip new`` takes it."""
    clip, _ = small_clip()
    track = clip.hand
    about = {
        "frames": np.arange(3) + 5, "K": clip.K[0], "side": np.array("right"),
        "provenance_hands": np.array("by an estimator"),
    }  # fmt: skip
    regions = {f"region_{name}": index for name, index in track.regions.items()}
    given = {"vertices": track.vertices, "faces": track.faces, "T_cam_hand": track.T_cam_hand}
    arrays.write(folder / "small.npz", {**about, **regions, **given, "joints": track.joints})


def use_hands(folder: Path) -> None:
    HandFile.of(folder / "small.npz").at(tuple(f"{n:06d}" for n in range(4, 8)), "right", None)
    clip, masks = small_clip()
    source = HandSource("name", folder)
    WithHands(source, (source,))(replace(clip, frames=("5", "6", "7")), masks, 0)


READERS: dict[str, Reader] = {
    "clip": Reader(whole_clip, read_whole_clip),
    "result": Reader(a_result, lambda folder: read_result(folder / "result")),
    **{f"mesh {suffix[1:]}": mesh(suffix) for suffix in (".obj", ".ply", ".off", ".stl", ".glb")},
    "meshes of frames": Reader(frame_meshes, lambda folder: read_meshes(folder, small_clip()[0], "hand")),
    "ledger": Reader(a_ledger, use_ledger),
    "marks": Reader(marks, use_marks),
    "labels": Reader(clicked, lambda folder: labels.read_label_file(folder / "labels.json")),
    "segment list": Reader(segments, use_segments),
    "grasp lists": Reader(grasp_lists, each(use_list)),
    "candidates": Reader(candidates, each(tasks.read_tasks)),
    "poses": Reader(poses, each(read_pose_file)),
    "initial poses": Reader(learnt, use_learnt),
    "timeline": warmed(write_uncut, a_timeline),
    "found": warmed(write_uncut, found),
    "segments": Reader(listed, use_listed),
    "report": warmed(report, write_report),
    "hand file": Reader(hands, use_hands),
}
"""By name."""
