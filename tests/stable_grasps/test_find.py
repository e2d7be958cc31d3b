"""Stable grasps against brute force, and the laws of contact IOU."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from getagrip.errors import UsageError
from getagrip.metrics.contact import pairwise_iou
from getagrip.stable_grasps import find as grasps
from getagrip.stable_grasps.definition import GRASP_RULES, Definition
from getagrip.stable_grasps.find import PairwiseIou, contact_iou, stable_grasps

Interval = tuple[int, int]
sets = arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24))
taus = st.sampled_from([0.0, 0.2, 0.25, 1 / 3, 0.5, 0.6, 2 / 3, 0.75])


@st.composite
def holds(draw: st.DrawFn) -> np.ndarray:
    """Contacts that stay for a while and change by a point now and then: long and short grasps, and gaps."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    frames, change = draw(st.integers(1, 60)), draw(st.sampled_from([0.02, 0.1, 0.3]))
    contact = np.zeros((frames, 8), dtype=bool)
    now = rng.random(8) < 0.5
    for n in range(frames):
        now = now ^ (rng.random(8) < change)
        if rng.random() < change / 3:
            now = rng.random(8) < rng.choice([0.0, 0.5])
        contact[n] = now
    return contact


def overlap(a: Interval, b: Interval) -> bool:
    return a[0] <= b[1] and b[0] <= a[1]


def greedily(candidates: list[Interval], shortest: int) -> list[Interval]:
    """Longest first, the earlier of equally long ones, none that overlaps another."""
    taken: list[Interval] = []
    for one in sorted(candidates, key=lambda c: (c[0] - c[1], c[0])):
        if one[1] - one[0] + 1 >= shortest and not any(overlap(one, other) for other in taken):
            taken.append(one)
    return sorted(taken)


def by_brute_force(iou: np.ndarray, tau: float, shortest: int, rule: str) -> list[Interval]:
    T = len(iou)
    if rule == "all-pairs":
        every = [(i, j) for i in range(T) for j in range(i, T) if (iou[i : j + 1, i : j + 1] > tau).all()]
        return greedily(every, shortest)
    if rule == "first":
        ends = [next((j for j in range(i, T) if iou[i, j] < tau or iou[i, j] == 0), T) for i in range(T)]
        return greedily([(i, end - 1) for i, end in enumerate(ends)], shortest)
    if rule == "touch":
        steady = (np.diag(iou) > 0).tolist()
    else:
        steady = [t >= 2 and iou[t - 2, t - 1] > tau and iou[t - 1, t] > tau for t in range(T)]
    runs = [(i, j) for i in range(T) for j in range(i, T) if all(steady[i : j + 1])]
    return greedily(runs, shortest)


@pytest.mark.parametrize("rule", GRASP_RULES)
@given(contact=holds(), tau=taus, shortest=st.integers(1, 6), block=st.sampled_from([1, 7, 128]))
def test_intervals_are_those_of_brute_force(
    contact: np.ndarray, tau: float, shortest: int, block: int, rule: grasps.Rule
) -> None:
    iou = contact_iou(contact)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grasps, "IOU_BLOCK_FRAMES", block)
        expected = by_brute_force(iou, tau, shortest, rule)
        assert stable_grasps(iou, tau, shortest, rule) == expected
        assert stable_grasps(PairwiseIou.of(contact), tau, shortest, rule) == expected


@given(contact=holds(), tau=taus, shortest=st.integers(1, 6))
def test_every_pair_of_a_grasp_is_alike_and_no_grasp_can_be_longer(
    contact: np.ndarray, tau: float, shortest: int
) -> None:
    iou = contact_iou(contact)
    found = stable_grasps(iou, tau, shortest)
    assert found == sorted(found)
    for first, last in found:
        assert last - first + 1 >= shortest
        assert (iou[first : last + 1, first : last + 1] > tau).all()
        for longer in ((first - 1, last), (first, last + 1)):
            inside = longer[0] >= 0 and longer[1] < len(iou)
            if inside and not any(overlap(longer, other) for other in found if other != (first, last)):
                assert not (iou[longer[0] : longer[1] + 1, longer[0] : longer[1] + 1] > tau).all()
    assert not any(overlap(a, b) for a, b in combinations(found, 2))


@given(contact=holds(), tau=taus)
def test_the_longest_grasp_is_no_longer_than_by_the_weaker_test(contact: np.ndarray, tau: float) -> None:
    iou = contact_iou(contact)
    longest = [max((b - a for a, b in stable_grasps(iou, tau, 1, rule)), default=-1) for rule in ("all-pairs", "first")]
    assert longest[0] <= longest[1]


def test_known_answers() -> None:
    a, b, none = [1, 1, 1, 1, 0, 0], [0, 0, 1, 1, 1, 1], [0] * 6  # IOU(a, b) = 1/3
    contact = np.array([none] + 5 * [a] + 2 * [none] + 5 * [b] + 3 * [a], dtype=bool)
    iou = contact_iou(contact)
    assert stable_grasps(iou, 0.5, 3) == [(1, 5), (8, 12), (13, 15)]
    assert stable_grasps(iou, 0.5, 4) == [(1, 5), (8, 12)]
    assert stable_grasps(iou, 0.3, 3) == [(1, 5), (8, 15)]
    assert stable_grasps(iou, 1 / 3, 3) == [(1, 5), (8, 12), (13, 15)]  # above tau, not at it
    assert stable_grasps(iou, 1 / 3, 3, "first") == [(1, 5), (8, 15)]
    assert stable_grasps(iou, 0.5, 1, "consecutive") == [(3, 5), (10, 12), (15, 15)]


def test_drifting_contact_is_one_hold_for_consecutive_frames_only() -> None:
    contact = np.array([[n <= p < n + 10 for p in range(60)] for n in range(50)])
    iou = contact_iou(contact)
    # n frames apart: (10 - n) / (10 + n) > 0.5 for n <= 3.
    assert stable_grasps(iou, 0.5, 4) == [(n, n + 3) for n in range(0, 48, 4)]
    assert stable_grasps(iou, 0.5, 4, "consecutive") == [(2, 49)]


def test_what_runs_into_a_longer_grasp_is_cut_by_the_definition_and_dropped_by_the_first_frames_test() -> None:
    iou = np.zeros((12, 12))
    for first, last in ((0, 4), (3, 11)):
        iou[first : last + 1, first : last + 1] = 1.0
    assert stable_grasps(iou, 0.5, 2) == [(0, 2), (3, 11)]
    assert stable_grasps(iou, 0.5, 2, "first") == [(3, 11)]


@pytest.mark.parametrize("rule", GRASP_RULES)
def test_nothing_is_held_where_nothing_touches(rule: grasps.Rule) -> None:
    for frames in (0, 1, 2, 300):
        assert stable_grasps(contact_iou(np.zeros((frames, 5), dtype=bool)), 0.5, 1, rule) == []


@given(sets)
def test_iou_is_that_of_the_metrics(contact: np.ndarray) -> None:
    np.testing.assert_array_equal(contact_iou(contact), pairwise_iou(contact))
    np.testing.assert_array_equal(contact_iou(contact, np.full(contact.shape[1], 0.1)), pairwise_iou(contact))


@given(sets, st.integers(0, 2**32 - 1))
def test_weights_count_a_point_as_if_it_were_there_more_often(contact: np.ndarray, seed: int) -> None:
    times = np.random.default_rng(seed).integers(0, 4, contact.shape[1])
    np.testing.assert_allclose(
        contact_iou(contact, times * 0.3), contact_iou(np.repeat(contact, times, axis=1)), atol=1e-12
    )


@given(holds(), st.integers(0, 2**32 - 1))
def test_a_pair_has_the_same_iou_in_any_slice(contact: np.ndarray, seed: int) -> None:
    rng = np.random.default_rng(seed)
    iou = PairwiseIou.of(contact, rng.random(8))
    whole = iou[:, :]
    np.testing.assert_array_equal(whole, whole.T)
    np.testing.assert_array_equal(np.diag(whole), contact.any(axis=1).astype(float))
    a, b, c, d = rng.integers(0, len(contact) + 1, 4)
    np.testing.assert_array_equal(iou[a:b, c:d], whole[a:b, c:d])


def test_wrong_options_are_named() -> None:
    iou = np.eye(3)
    for wrong in ({"tau": 1.0}, {"tau": -0.1}, {"tau": np.nan}, {"shortest": 0}, {"rule": "some"}):
        with pytest.raises(UsageError, match=next(iter(wrong))):
            stable_grasps(iou, **wrong)


def test_a_grasp_may_be_as_short_as_one_frame() -> None:
    assert Definition(shortest=1).shortest == 1
    with pytest.raises(UsageError, match="shortest"):
        Definition(shortest=0)
