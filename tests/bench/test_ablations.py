"""Variants that run on every clip: methods as they are, and the settings of ablations."""

from __future__ import annotations

import re
from dataclasses import asdict, fields

import pytest

from getagrip.bench.ablations import ABLATIONS, ablation_variants, method_variants
from getagrip.errors import UsageError
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Departures, Options


@pytest.mark.parametrize("name", ABLATIONS)
def test_settings_have_folders_of_their_own_and_something_to_compare_with(name: str) -> None:
    ablation = ABLATIONS[name]
    variants = ablation_variants(name, [], Options())
    labels = [variant.label for variant in variants]
    assert len(set(labels)) == len(labels)
    assert all(variant.against in labels for variant in variants)
    assert all(re.fullmatch(r"[a-z0-9.+-]+", variant.folder) for variant in variants)
    kinds = {(variant.folder, repr(variant.options), repr(variant.change)) for variant in variants}
    assert len(kinds) == len({variant.folder for variant in variants})
    assert {variant.group for variant in variants} == set(ablation.methods)


def test_a_setting_that_changes_nothing_shares_the_methods_results() -> None:
    folders = {variant.step: variant.folder for variant in ablation_variants("inits", ["one-dof"], Options())}
    assert folders["50"] == "one-dof"
    assert folders["10"] == "one-dof+inits-10"
    folders = {variant.step: variant.folder for variant in ablation_variants("inits", ["one-dof"], Options(inits=100))}
    assert folders["100"] == "one-dof"
    assert folders["50"] != "one-dof"
    assert {variant.folder for variant in ablation_variants("sca", ["static"], Options())} == {"static"}


def test_settings_that_are_alike_share_their_results_and_only_these() -> None:
    names = [name for name in ABLATIONS if name != "departures"]  # there the method changes, too
    every = [variant for name in names for variant in ablation_variants(name, [], Options())]
    kinds = {(variant.folder, repr(variant.options), repr(variant.change)) for variant in every}
    assert (
        len(kinds)
        == len({folder for folder, _, _ in kinds})
        == len({(options, change) for _, options, change in kinds})
    )
    assert "soft-hinge+hand-noise-10-mm-8-deg" in {v.folder for v in ablation_variants("inputs", [], Options())}


def test_all_methods_but_the_slow_ones_where_none_is_named() -> None:
    fast = [name for name, method in METHODS.items() if not method.slow]
    assert [variant.folder for variant in method_variants([], Options())] == fast
    assert [variant.folder for variant in method_variants(["paper"], Options())] == ["paper"]


def test_only_known_evidence_is_left_out() -> None:
    none = ablation_variants("pixels", [], Options())[-1].options
    assert (none.without, none.interval) == (("texture", "profile", "handle", "surface-motion"), "as-given")
    with pytest.raises(UsageError, match="unknown without 'luck'"):
        Options(without=("luck",))  # type: ignore[arg-type]


def test_departures_lead_step_by_step_from_the_paper_to_ours() -> None:
    printed, first, *between, last = [v.options for v in ablation_variants("departures", [], Options())]
    assert printed == Options(method="paper", push=1e3 * first.push, pull=1e3 * first.pull)
    made = [sum(asdict(options.departures).values()) for options in between]
    assert first == Options(method="paper")
    assert made == list(range(1, len(fields(Departures)) + 1))
    assert last == Options(method="soft-hinge", hands="as-given")
