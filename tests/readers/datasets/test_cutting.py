"""Cutting tracks: an import and `segment` find the same grasps, and lists take the place of either."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from getagrip.batch.import_dataset import import_clips
from getagrip.bench.sources.source import ClipFolder
from getagrip.bench.tables import durations_by_category, grasp_list_durations
from getagrip.clip import FINGERS, HandTrack, Joint, read_clip, write_clip
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.readers.datasets.cutting import TrackedDataset, clip_of_piece, cut_into_grasps
from getagrip.readers.datasets.dataset import Note
from getagrip.readers.datasets.tracks import SequenceSource, Track
from getagrip.stable_grasps import grasp_lists
from getagrip.stable_grasps.definition import Definition, GraspOptions
from getagrip.stable_grasps.find import CutRules, segment
from helpers.environment import Run

FRAMES, FIRST, LAST = 101, 30, 70
ORIGIN = 7
"""Number of the sequence's first frame."""
NAME = "s01--ball_use_01--ball--right"


def ball(radius: float) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))


def drifting() -> Track:
    """Contact in frames 30 to 70 of 101, and a joint that drifts by 10 degrees over all of them."""
    hand, mesh = ball(0.03), ball(0.03)
    vertices, regions = np.tile(hand.vertices, (FRAMES, 1, 1)), {finger: np.arange(3) for finger in FINGERS}
    T_cam_hand = np.tile(se3.rigid(t=np.array([0.0, 0.0, 0.6])), (FRAMES, 1, 1))
    at = np.zeros((FRAMES, 3))
    at[:, 0] = np.where((np.arange(FRAMES) >= FIRST) & (np.arange(FRAMES) <= LAST), 0.055, 0.2)
    return Track(
        file=Path("ball"), subject="s01", sequence="ball_use_01", category="ball", side="right", fps=30.0,
        numbers=np.arange(FRAMES) + ORIGIN, digits=5, size=(320, 240),
        K=np.array([[300.0, 0.0, 160.0], [0.0, 300.0, 120.0], [0.0, 0.0, 1.0]]),
        hand=HandTrack(vertices, hand.faces, T_cam_hand, regions),
        T_cam_obj=T_cam_hand @ se3.rigid(t=at), mesh=mesh, provenance={},
        joint=Joint(mesh.vertices[:, 0] > 0.01, np.zeros(3), np.array([0.0, 0.0, 1.0])),
        articulation=np.radians(np.linspace(0.0, 10.0, FRAMES)), origin=ORIGIN,
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class OneTrack(TrackedDataset):
    """A dataset with one track."""

    root: Path = Path()
    grasps: GraspOptions = field(default_factory=lambda: GraspOptions(shortest=10))

    def sources(self) -> list[SequenceSource]:
        return [SequenceSource("s01/ball_use_01", _read)]


def _read(note: Note) -> list[Track]:
    return [drifting()]


def numbers(folder: Path) -> tuple[int, int, int]:
    """First and last frame of a clip's folder as they count from 0, and how many it has."""
    frames = read_clip(folder).frames
    return int(frames[0]) - ORIGIN, int(frames[-1]) - ORIGIN, len(frames)


@pytest.mark.slow
def test_an_import_and_segment_agree_on_a_joint_that_drifts(tmp_path: Path) -> None:
    cut = CutRules(Definition())
    (found,) = cut_into_grasps([drifting()], print, cut)
    assert found.track.numbers[[0, -1]].tolist() == [ORIGIN + FIRST, ORIGIN + LAST]
    (whole,) = cut_into_grasps([drifting()], print, cut, whole=True)
    assert len(whole.track) == FRAMES
    made = clip_of_piece(whole, 20, print)
    assert made is not None
    written = read_clip(write_clip(made[0], None, tmp_path / "whole"))
    assert segment(written, Definition())[1] == [(FIRST, LAST)]
    # Beyond 5 degrees it has been opened, in both.
    wide = replace(drifting(), articulation=np.radians(np.linspace(0.0, 20.4, FRAMES)))
    (whole,) = cut_into_grasps([wide], print, cut, whole=True)
    made = clip_of_piece(whole, 20, print)
    assert made is not None
    ends = [
        piece.track.numbers[[0, -1]] - ORIGIN
        for piece in cut_into_grasps([wide], print, CutRules(Definition(shortest=5)))
    ]
    assert [tuple(end) for end in ends] == segment(made[0], Definition(shortest=5))[1] == [(30, 54), (55, 70)]


@pytest.mark.slow
def test_contact_is_that_of_the_object_as_its_joint_was(tmp_path: Path) -> None:
    """A lid that opens away from the hand: at the mean angle of its clip it would seem to touch."""
    track = drifting()
    assert track.joint is not None
    lid = replace(track.joint, moves=track.mesh.vertices[:, 0] < -0.02, point=np.array([0.0, -0.03, 0.0]))
    angle = np.where(np.arange(FRAMES) < 50, 0.0, -0.5)
    opened = replace(track, joint=lid, articulation=angle)
    (whole,) = cut_into_grasps([opened], print, CutRules(Definition()), whole=True)
    made = clip_of_piece(whole, 20, print)
    assert made is not None
    written = read_clip(write_clip(made[0], None, tmp_path / "whole"))
    assert made[0].truth == written.truth
    iou, _ = segment(written, Definition())
    assert iou.size[49] > 0.0
    assert iou.size[50] < iou.size[49]
    with np.load(tmp_path / "whole" / "truth.npz") as stored:
        arrays = dict(stored)
    for key, value in (
        ("joint_moves", np.ones(3, bool)), ("joint_direction", np.ones(3)), ("joint_point", np.full(3, 900.0)),
        ("joint_angle", np.array(90.0)), ("joint_angle", None), ("articulation", None),
    ):  # fmt: skip
        changed = {k: v for k, v in (arrays | {key: value}).items() if v is not None}
        np.savez(tmp_path / "whole" / "truth.npz", **changed)
        with pytest.raises(InputError, match=rf"truth\.npz: (missing )?{key}"):
            read_clip(tmp_path / "whole")


@pytest.mark.slow
def test_the_list_beside_the_clips_is_theirs(tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "clips"
    assert import_clips(OneTrack(), out, debug=False) == 0
    assert numbers(out / NAME) == (FIRST, LAST, LAST + 1 - FIRST)
    found = grasp_lists.read_listed_grasps(out / "grasps.json")
    first, last = f"{FIRST + ORIGIN:05d}", f"{LAST + ORIGIN:05d}"
    (grasp,) = found.grasps
    assert (grasp.sequence, grasp.first, grasp.last) == (NAME, first, last)
    assert grasp.duration == pytest.approx((LAST + 1 - FIRST) / 30.0)
    (row, _) = durations_by_category(grasp_list_durations(out, found.grasps))
    assert (row.category, row.clips, row.mean) == ("ball", 1, pytest.approx(grasp.duration))
    # Clips cut in another way do not go beside them.
    for other in (OneTrack(whole=True), OneTrack(grasps=GraspOptions(shortest=11))):
        with pytest.raises(UsageError, match=r"--out .* cannot be used with this import: it holds clips cut as"):
            import_clips(other, out, debug=False)
    (out / "grasps.json").unlink()
    with pytest.raises(UsageError, match=r"without a grasps\.json that states how"):
        import_clips(OneTrack(), out, debug=False)


@pytest.mark.slow
def test_every_command_takes_the_same_list(tmp_path: Path, run: Run) -> None:
    """Marked by hand, counted from 0; cut by an import; drawn and studied in the whole sequence."""
    marked = tmp_path / "marked.json"
    rows = [{"clip": "s01--ball_use_01", "side": "right", "object": "ball", "start": 40, "end": 60, "duration": 0.7}]
    marked.write_text(json.dumps([*rows, rows[0] | {"side": "left"}]))
    assert import_clips(OneTrack(grasps=GraspOptions(listed=marked)), tmp_path / "clips", debug=False) == 0
    assert numbers(tmp_path / "clips" / f"{NAME}--00040-00060") == (40, 60, 21)
    assert import_clips(OneTrack(whole=True), tmp_path / "whole", debug=False) == 0
    lists_made = [tmp_path / "clips" / "grasps.json"]
    for command, option in (("segment", "--list"), ("study", "--intervals")):
        out = tmp_path / command
        status, said, err = run(command, tmp_path / "whole", option, marked, "--out", out)
        assert (status, err.strip()) == (0, "1 of the 2 grasps of marked.json are in these clips")
        assert "1 stable grasp in 1 of 1 clip" in said
        lists_made.append(out / "grasps.json")
    grasps = [
        grasp_lists.read_listed_grasps(path).grasps for path in (*lists_made, tmp_path / "segment" / "segments.csv")
    ]
    assert {(one.sequence, one.first, one.last) for found in grasps for one in found} == {(NAME, "00047", "00067")}
    # The contact is that of whoever read the list: an importer's (here ARCTIC's), or the command's options.
    assert grasp_lists.read_cut(lists_made[0]) == {
        "list": "marked.json",
        "sha256": grasp_lists.read_listed_grasps(marked).sha256,
        "contact": 0.0,
        "points": "vertices",
    }
    assert ClipFolder(folder=tmp_path / "clips").contact_mm == 0.0
    # What one of them wrote, the others read.
    again = OneTrack(grasps=GraspOptions(listed=tmp_path / "segment" / "segments.csv"))
    assert import_clips(again, tmp_path / "again", debug=False) == 0
    assert numbers(tmp_path / "again" / f"{NAME}--00047-00067") == (40, 60, 21)
