"""DexYCB's whole sequences as timelines."""

import numpy as np
import pytest

from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.readers.datasets.dataset import clips
from getagrip.readers.datasets.dexycb.dexycb_clips import DexYcb
from helpers.dexycb_files import FRAMES, LOST, TAKEN, write_extrinsics
from helpers.environment import DATA, needs


@pytest.mark.slow
def test_a_sequence_becomes_a_timeline(root):
    """Whole, with masks: the ball is held from frame ``TAKEN`` on; before, it moves with no hand near it."""
    table = write_extrinsics(root, np.eye(4), se3.rigid(None, np.array([0.0, 0.0, 1.0])))
    ((clip, masks),) = clips(DexYcb(root=root, timelines=True))
    assert clip.frames == tuple(f"{n:06d}" for n in range(FRAMES) if n != LOST)
    assert [(s.state, s.first, s.last, s.side) for s in clip.segments] == [
        ("free", 0, TAKEN - 1, None), ("grasp", TAKEN, len(clip) - 1, "right"),
    ]  # fmt: skip
    assert (clip.world.support, masks.object.any()) == (0.0, True)
    table.unlink()
    ((clip, _),) = clips(DexYcb(root=root, timelines=True))
    assert clip.world.up is None  # nothing else says where the table is
    with pytest.raises(UsageError, match="--timelines"):
        list(clips(DexYcb(root=root, timelines=True, whole=True)))


@pytest.mark.slow
@needs(DATA / "dexycb" / "left_hand_sequences.npz")
def test_real_objects_lie_on_a_table_that_the_others_show():
    dataset = DexYcb(root=DATA / "dexycb", meshes=DATA / "ycb", timelines=True)
    (draft,) = dataset.parts(lambda _: None)[20].drafts(lambda name, with_hands=False: True, lambda _: None)
    clip, _ = draft.make()
    states = [segment.state for segment in clip.segments]
    assert (states[0], "grasp" in states) == ("static", True)
    in_world = clip.world.T_world_cam @ clip.truth.T_cam_obj
    lowest = se3.transform(in_world, clip.mesh.vertices[None])[..., 2].min(axis=1)
    assert np.abs(lowest[clip.segments[0].rows]).max() < 0.01
    assert lowest[-1] > 0.05
