"""The public dataclasses: equal where their content is, made of fitting arrays only, every field in help()."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from copy import deepcopy
from dataclasses import fields, is_dataclass, replace
from typing import Any, get_type_hints

import numpy as np
import pytest

import getagrip
from getagrip import Axis, Candidates, Clip, HandTrack, Masks, Mesh, Reconstruction, Truth, UsageError, Warp, World
from getagrip.hands.model import HandModel, PosedHand, ShapedHand
from getagrip.io.array_data import ArrayData, equal_content
from getagrip.result import SegmentResult, Status
from helpers.clips import small_clip

DATACLASSES = [kind for name in getagrip.__all__ if is_dataclass(kind := getattr(getagrip, name))]


def one_of(kind: type[ArrayData]) -> Any:
    """An object of a public class."""
    clip, masks = small_clip()
    axis = Axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.linspace(0.0, 1.0, 3))
    candidates = Candidates(clip.hand.T_cam_hand[None], np.ones(1), np.array([5.0]))
    result = Reconstruction(
        clip="small", method="one-dof", frames=clip.frames, T_hand_obj=clip.hand.T_cam_hand, scale=1.0, iou=np.ones(3),
        axis=axis, candidates=candidates, energy={"total": 5.0}, status=Status.CONVERGED, ambiguous=False, seconds={},
    )  # fmt: skip
    world, warp = World(clip.hand.T_cam_hand), Warp.by(np.zeros(3), 1.0, np.zeros((9, 3)))
    segment = SegmentResult(state="grasp", first="0", last="1", axis_point=np.zeros(3))
    made = [segment, clip, clip.hand, clip.truth, clip.mesh, masks, axis, candidates, result, world, warp]
    return next(one for one in made if type(one) is kind)


ARRAY_CLASSES = [Axis, Candidates, Clip, HandTrack, Masks, Mesh, Reconstruction, SegmentResult, Truth, Warp, World]


@pytest.mark.slow
def test_all_public_dataclasses_with_arrays_are_meant() -> None:
    assert {kind for kind in DATACLASSES if issubclass(kind, ArrayData)} == {*ARRAY_CLASSES}
    others = {kind.__name__ for kind in DATACLASSES if not issubclass(kind, ArrayData)}
    assert others == {"Evaluation", "Finding", "Options", "SceneOptions", "Segment", "Source"}


# Equality.


@pytest.mark.parametrize("kind", ARRAY_CLASSES)
def test_a_copy_is_equal_and_one_other_number_is_not(kind: type[ArrayData]) -> None:
    one = one_of(kind)
    assert one == deepcopy(one)
    assert one != "something else"
    with pytest.raises(TypeError, match="unhashable"):
        hash(one)
    for field in fields(kind):  # type: ignore[arg-type]
        value = getattr(one, field.name)
        if isinstance(value, np.ndarray):
            changed = value.copy()
            changed.flat[-1] = not changed.flat[-1]
            assert one != replace(one, **{field.name: changed})


def test_parts_are_compared_too() -> None:
    clip = one_of(Clip)
    regions = clip.hand.regions | {"thumb": np.array([1, 0])}
    for other in (
        replace(clip, hand=replace(clip.hand, regions=regions)),
        replace(clip, truth=None),
        replace(clip, provenance={"hands": "another"}),
    ):
        assert clip != other
        assert other != clip
        assert other == deepcopy(other)


def test_nothing_that_was_computed_from_the_fields_changes_equality() -> None:
    mesh, other = one_of(Mesh), one_of(Mesh)
    assert mesh.diameter > 0.0
    assert mesh == other


def test_nan_equals_nan() -> None:
    assert equal_content({"a": [np.nan, np.array([1.0, np.nan])]}, {"a": [np.nan, np.array([1.0, np.nan])]})
    for a, b in (
        (np.nan, 1.0),
        (np.array([np.nan]), np.array([1.0])),
        (np.array([1]), "1"),
        (np.zeros(2), np.zeros(3)),
        ([1, 2], [1]),
        ({"a": 1}, {"b": 1}),
    ):
        assert not equal_content(a, b)
        assert not equal_content(b, a)


# Making them.


TRIANGLE = np.array([[0, 1, 2]])


def test_numbers_of_another_width_are_converted_and_others_kept_as_they_are() -> None:
    mesh = Mesh(np.eye(3, dtype=np.float32), TRIANGLE.astype(np.int16))
    assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float64, np.int64)
    own = np.eye(3)
    assert Mesh(own, TRIANGLE).vertices is own


def changed(kind: type[ArrayData], **fields: Any) -> Callable[[], object]:
    return lambda: replace(one_of(kind), **fields)


HAND, CLIP, MASKS = one_of(HandTrack), one_of(Clip), one_of(Masks)
SHORT = CLIP.take(np.array([0]))
REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "must be floats of shape (V, 3)": (lambda: Mesh(np.eye(4), TRIANGLE), "Mesh.vertices"),
    "must be vertex ids from 0 to 2 (got 3)": (lambda: Mesh(np.eye(3), TRIANGLE + 1), "Mesh.faces"),
    "must be integers": (lambda: Mesh(np.eye(3), TRIANGLE * 1.0), "Mesh.faces"),
    "must be an array": (lambda: Mesh([[0.0, 1.0, 2.0]], TRIANGLE), "Mesh.vertices"),
    "got uint8": (changed(Masks, object=MASKS.object.astype(np.uint8)), "Masks.object"),
    "must be booleans of shape (3, 24, 32)": (changed(Masks, ignore=MASKS.ignore[:2]), "Masks.ignore"),
    "must be floats of shape (3, 4, 4)": (changed(HandTrack, T_cam_hand=SHORT.hand.T_cam_hand), "HandTrack.T_cam_hand"),
    "must be floats of shape (3, 21, 3)": (changed(HandTrack, joints=HAND.joints[:, :20]), "HandTrack.joints"),
    "missing thumb, index, middle, ring, pinky in": (changed(HandTrack, regions={}), "HandTrack.regions"),
    "got bool of shape (8,)": (
        changed(HandTrack, regions=HAND.regions | {"palm": np.ones(8, bool)}),
        "HandTrack.regions['palm']",
    ),
    "must be vertex ids from 0 to 7 (got 8)": (
        changed(HandTrack, regions=HAND.regions | {"palm": np.array([8])}),
        "HandTrack.regions['palm']",
    ),
    "must be floats of shape (T, 3, 3)": (changed(Clip, K=CLIP.K[0]), "Clip.K"),
    "must be 3 frames, as many as the hand has (got 2)": (changed(Clip, K=CLIP.K[:2]), "Clip.K"),
    "must be 3 frames, as many as the hand has (got 1)": (changed(Clip, frames=("a",)), "Clip.frames"),
    "hand has (got 1)": (changed(Clip, truth=SHORT.truth), "Clip.truth"),
    "got 'Left'": (changed(Clip, side="Left"), "Clip.side"),
    "got 'unknown'": (changed(Clip, scale="unknown"), "Clip.scale"),
    "must be 3 names, as many as T_hand_obj (got 0)": (changed(Reconstruction, frames=()), "Reconstruction.frames"),
}


@pytest.mark.usefixtures("users_hints")
@pytest.mark.parametrize("words", REFUSED)
def test_what_does_not_fit_is_named(words: str) -> None:
    make, field = REFUSED[words]
    with pytest.raises(UsageError, match=r" must be |missing ") as caught:
        make()
    assert field in str(caught.value)
    assert words in str(caught.value)


def test_a_clip_needs_little() -> None:
    full = one_of(Clip)
    clip = Clip(hand=full.hand, mesh=full.mesh, K=full.K, size=full.size, side="right")
    assert clip.frames == ("000000", "000001", "000002")
    assert (clip.truth, clip.folder, clip.left_out, clip.provenance) == (None, None, (), {})


# help().


@pytest.mark.parametrize("kind", [*DATACLASSES, HandModel, PosedHand, ShapedHand])
def test_help_shows_every_field_and_the_shape_of_every_array(kind: type) -> None:
    classes = [one for one in kind.__mro__[::-1] if is_dataclass(one) and "__doc__" in vars(one)]
    described = dict(re.findall(r"^    (\w+): (.+)$", "\n".join(map(inspect.getdoc, classes)), re.MULTILINE))
    assert list(described) == [field.name for field in fields(kind)]
    for name, hint in get_type_hints(kind).items():
        array = next((h for h in (hint, *getattr(hint, "__args__", ())) if hasattr(h, "dim_str")), None)
        if array is not None and not isinstance(hint, dict) and "dict" not in str(hint):
            axes = array.dim_str.replace("*batch", "...").replace(" ", ", ") + ("," if " " not in array.dim_str else "")
            assert described[name].startswith(f"({axes}) ")
