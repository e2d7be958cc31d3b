"""The chain of least energy against all chains, and the links between segments."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.timelines.joint import best_chain, link_cost, second_best, squared_vertex_distance
from getagrip.timelines.observations import Hypotheses
from getagrip.timelines.tracking import Paths
from helpers.clips import box


def some_chain(counts: list[int], seed: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    rng = np.random.default_rng(seed)
    return [rng.uniform(size=n) for n in counts], [rng.uniform(size=(n, m)) for n, m in pairwise(counts)]


COUNTS = st.lists(st.integers(1, 4), min_size=1, max_size=5)


@given(COUNTS, st.integers(0, 99))
def test_no_other_chain_costs_less(counts: list[int], seed: int) -> None:
    energy, links = some_chain(counts, seed)

    def cost(chain: tuple[int, ...]) -> float:
        own = sum(e[k] for e, k in zip(energy, chain, strict=True))
        return float(own + sum(link[chain[i], chain[i + 1]] for i, link in enumerate(links)))

    every = sorted((cost(chain), chain) for chain in product(*map(range, counts)))
    chosen, total = best_chain(energy, links)
    assert (tuple(chosen), total) == (every[0][1], pytest.approx(every[0][0]))
    expected = every[1][0] if len(every) > 1 else float("inf")
    assert second_best(
        energy, links, [np.arange(n) == k for n, k in zip(counts, chosen, strict=True)]
    ) == pytest.approx(expected)


@given(COUNTS, st.integers(0, 99))
def test_time_may_run_backwards(counts: list[int], seed: int) -> None:
    energy, links = some_chain(counts, seed)
    chosen, total = best_chain(energy, links)
    back, same = best_chain(energy[::-1], [link.T for link in links[::-1]])
    assert (back[::-1], same) == (chosen, pytest.approx(total))


@given(COUNTS, st.integers(0, 99), st.integers(0, 4))
def test_a_segment_that_is_cut_in_two_is_the_same_segment(counts: list[int], seed: int, at: int) -> None:
    """Its hypotheses stand in both parts, and only one and the same may follow."""
    energy, links = some_chain(counts, seed)
    at %= len(counts)
    chosen, total = best_chain(energy, links)
    same = np.where(np.eye(counts[at], dtype=bool), 0.0, np.inf)
    parts = [0.3 * energy[at], 0.7 * energy[at]]
    cut = best_chain([*energy[:at], *parts, *energy[at + 1 :]], [*links[:at], same, *links[at:]])
    assert cut == ([*chosen[: at + 1], *chosen[at:]], pytest.approx(total))


@given(COUNTS, st.integers(0, 99))
def test_energy_that_all_hypotheses_have_chooses_none(counts: list[int], seed: int) -> None:
    energy, links = some_chain(counts, seed)
    chosen, total = best_chain(energy, links)
    assert best_chain([e + n for n, e in enumerate(energy)], links) == (
        chosen, pytest.approx(total + sum(range(len(energy)))),
    )  # fmt: skip


MESH = box(0.1, 0.06, 0.04)
MOST = 50.0


def some_ends(seed: int, count: int) -> Hypotheses:
    """One frame each, near to each other."""
    rng = np.random.default_rng(seed)
    R, centre = se3.exp_so3(rng.normal(0.0, 0.3, (count, 1, 3))), rng.normal(0.0, 0.02, (count, 1, 3))
    return Hypotheses(R, centre, np.ones(count), rng.uniform(0.0, 9.0, count))


def in_other_units(found: Hypotheses, T: np.ndarray, k: float = 1.0) -> Hypotheses:
    """The same in another frame, by another unit of length."""
    return Hypotheses(T[:3, :3] @ found.R, k * se3.transform(T, found.centre), found.scale, found.energy)


@given(st.integers(0, 99))
def test_links_know_no_frame_and_no_unit(seed: int) -> None:
    start, paths, ends = some_ends(seed, 2), some_ends(seed + 1, 5), some_ends(seed + 2, 3)
    rng = np.random.default_rng(seed)
    T = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    of = np.array([0, 1, 0, 1, 1])
    one = link_cost(MESH, Paths(paths, of), start, ends, MOST)
    larger = Mesh(1000.0 * MESH.vertices, MESH.faces)
    other = link_cost(larger, Paths(in_other_units(paths, T, 1e3), of), start, in_other_units(ends, T, 1e3), MOST)
    np.testing.assert_allclose(other, one, rtol=1e-9)
    assert (one <= MOST).all()
    assert (one >= 0.0).all()


def test_distance_is_nothing_where_poses_are_the_same_and_the_same_both_ways() -> None:
    one, other = some_ends(0, 4), some_ends(1, 3)
    np.testing.assert_allclose(np.diag(squared_vertex_distance(MESH, one, one)), 0.0, atol=1e-15)
    np.testing.assert_allclose(squared_vertex_distance(MESH, one, other), squared_vertex_distance(MESH, other, one).T)
    shifted = Hypotheses(one.R, one.centre + np.array([0.0, 0.03, 0.04]), one.scale, one.energy)
    np.testing.assert_allclose(np.diag(squared_vertex_distance(MESH, one, shifted)), 0.05**2)
