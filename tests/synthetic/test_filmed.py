"""Filmed scenes: the split is disjoint and covers; people are not the fitted hand; scans; a hand comes and goes."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.model import HandModel
from getagrip.synthetic.categories import SHAPE_MAKERS
from getagrip.synthetic.filmed import (
    GRASP_FRAMES,
    KINDS,
    LATER_KINDS,
    REACH_FRAMES,
    Person,
    draw_look,
    filmed_clips,
    make_filmed_scene,
)
from getagrip.synthetic.video import SKIN_TONES

CUBE = """mtllib cube.mtl
v 0 0 0\nv .05 0 0\nv .05 .06 0\nv 0 .06 0\nv 0 0 .1\nv .05 0 .1\nv .05 .06 .1\nv 0 .06 .1
vt .25 .25\nvt .75 .75
f 1/1 3/1 2/1\nf 1/1 4/1 3/1\nf 5/2 6/2 7/2\nf 5/2 7/2 8/2\nf 1/1 2/1 6/2\nf 1/1 6/2 5/2
f 2/1 3/1 7/2\nf 2/1 7/2 6/2\nf 3/1 4/1 8/2\nf 3/1 8/2 7/2\nf 4/1 1/1 5/2\nf 4/1 5/2 8/2
"""


def scan_in(folder: Path, mtl: str = "newmtl a\nmap_Kd cube.png\n") -> Path:
    """Write a textured box: red below, where the texture is below, and blue above."""
    texture = np.zeros((4, 4, 3), np.uint8)
    texture[2:, :2] = 0, 0, 255  # blue, green, red
    texture[:2, 2:] = 255, 0, 0
    cv2.imwrite(str(folder / "cube.png"), texture)
    (folder / "cube.mtl").write_text(mtl)
    (folder / "cube.obj").write_text(CUBE)
    return folder / "cube.obj"


def test_the_split_is_disjoint_and_covers_all_kinds() -> None:
    train, validation = filmed_clips("train"), filmed_clips("validation")
    assert len(validation) == 72
    assert len(train) + len(validation) >= 200
    parts = [*KINDS.values(), *LATER_KINDS.values()]
    assert sorted(kind for part in parts for kind in part) == sorted(SHAPE_MAKERS)
    assert not {clip.kind for clip in train} & {clip.kind for clip in validation}
    assert not {clip.seed for clip in train} & {clip.seed for clip in validation}
    names = [clip.name for clip in (*train, *validation)]
    assert len({*names}) == len(names)


@pytest.mark.parametrize("split", ["train", "validation"])
def test_the_first_clips_are_of_all_kinds_and_ways(split: str) -> None:
    clips = filmed_clips("validation" if split == "validation" else "train")
    part = KINDS["validation" if split == "validation" else "train"]
    some = list(islice(clips, len(part)))
    assert {clip.kind for clip in some} == {*part}
    for ways in ([clip.side for clip in clips], [clip.camera for clip in clips], [clip.sized for clip in clips]):
        assert 0.4 < sum(way == ways[0] for way in ways) / len(ways) < 0.6


def test_a_scan_belongs_to_one_split_by_its_name(tmp_path: Path) -> None:
    paths = [tmp_path / f"{n}" / "textured.obj" for n in range(30)]
    parts = [{clip.scan for clip in filmed_clips(split, paths)} - {None} for split in ("train", "validation")]
    assert not parts[0] & parts[1]
    assert len(parts[0] | parts[1]) == 30
    assert len(parts[1]) >= 4


def bones(model: HandModel, shape: np.ndarray | None = None) -> np.ndarray:
    """Return the logarithms of the 10 phalanges' lengths between joints of a flat hand."""
    joints = model.with_shape(shape).with_pose().joints[1:].reshape(5, 4, 3)
    return np.log(np.linalg.norm(np.diff(joints[:, :3], axis=1), axis=-1).ravel())


def test_people_differ_from_the_fitted_hand_as_people_do() -> None:
    model = generic.load("right")
    off = np.stack([bones(Person.draw(seed).model) for seed in range(80)]) - bones(model)
    assert np.abs(off.mean(axis=0)).max() < 0.03
    assert 0.07 < off.std(axis=0).mean() < 0.12  # size and bone are 7 %; the joints' places add to it
    flat = model.with_shape().with_pose().joints
    thick = []
    for seed in range(80):
        person = Person.draw(seed).model
        finger = model.weights[:, 5] > 0.9  # the middle finger's second bone
        across = [np.ptp(each.template[finger, 2]) for each in (person, model)]
        thick.append(np.log(across[0] / across[1]))
    assert flat.shape == (21, 3)
    assert 0.07 < np.std(thick) < 0.15


def test_no_shape_of_the_fitted_hand_is_a_person() -> None:
    model, step = generic.load("right"), 1e-3
    J = np.stack([(bones(model, step * e) - bones(model)) / step for e in np.eye(len(model.shape_names))], axis=1)
    left = []
    for seed in range(20):
        off = bones(Person.draw(seed).model) - bones(model)
        left.append(off - J @ np.linalg.lstsq(J, off, rcond=None)[0])
    assert np.sqrt(np.mean(np.square(left))) > 0.01
    assert (Person.draw(3).model.template == Person.draw(3).model.template).all()
    assert np.abs(Person.draw(3).model.weights - model.weights).max() > 0.02


def test_looks_of_validation_lack_in_training() -> None:
    tones = {tuple(tone) for tone in SKIN_TONES}
    looks = {split: [draw_look(split, seed) for seed in range(12)] for split in ("train", "validation")}
    assert all(tuple(look.skin) in tones for look in looks["train"])
    assert not any(tuple(look.skin) in tones for look in looks["validation"])
    assert len({look.sleeve_start for look in looks["validation"]}) > 2


@pytest.mark.slow
@pytest.mark.parametrize("n", [0, 1])
def test_the_object_stands_while_the_hand_comes_and_goes(n: int) -> None:
    filmed = filmed_clips("validation")[n]
    scene, colours = make_filmed_scene(filmed)
    clip, truth = scene.clip, scene.clip.truth
    assert truth is not None
    assert clip.world is not None
    assert clip.hand.joints is not None
    assert (len(clip), clip.side, colours) == (2 * REACH_FRAMES + GRASP_FRAMES, filmed.side, None)
    T = clip.world.T_world_cam @ truth.T_cam_obj
    for rest in (slice(0, REACH_FRAMES + 1), slice(len(T) - REACH_FRAMES - 1, len(T))):
        np.testing.assert_allclose(T[rest], np.broadcast_to(T[rest][0], T[rest].shape), atol=1e-9)
    palm = se3.transform(truth.T_cam_hand, clip.hand.joints)[:, 9]
    apart = np.linalg.norm(palm - se3.transform(truth.T_cam_obj, scene.object.centre[None])[:, 0], axis=1)
    assert min(apart[0], apart[-1]) > apart[REACH_FRAMES : REACH_FRAMES + GRASP_FRAMES].max()
    aligned = np.linalg.norm(truth.scale * clip.mesh.vertices - scene.object.vertices, axis=1) / scene.object.diameter
    assert 0.005 < aligned.mean() < 0.06  # the user's mesh is of the object's kind, and not the object's
