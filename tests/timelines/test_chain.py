"""The chain of least energy against all chains."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.timelines.chain import best_chain, second_best


@given(st.lists(st.integers(1, 4), min_size=1, max_size=4), st.integers(0, 99))
def test_no_other_chain_costs_less(counts: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    energy = [rng.uniform(size=n) for n in counts]
    links = [rng.uniform(size=(n, m)) for n, m in pairwise(counts)]

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
