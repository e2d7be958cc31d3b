"""The fingerprint of the code covers all that a reconstruction may import, and no more parts than that."""

from __future__ import annotations

import re
import tomllib

from getagrip.experiments import segment_trials, timeline_trials, trials
from getagrip.io import code
from helpers.paths import ROOT


def test_parts_that_are_left_out_are_those_above_the_fit() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    layers = [re.findall(r"\w+", layer) for layer in contracts[0]["layers"]]
    (fit,) = (n for n, layer in enumerate(layers) if "fitting" in layer)
    above = {part for layer in layers[:fit] for part in layer}
    beside = {part for part in layers[fit] if part != "fitting"}  # parts in one layer may not import each other
    assert {*code.UNFINGERPRINTED_PARTS} == (above | beside) - {"timelines", "evidence"}  # a fit uses these, too
    used = {
        part
        for path in (ROOT / "src/getagrip/timelines").rglob("*.py")
        for part in re.findall(r"(?:from|import) getagrip\.(\w+)", path.read_text("utf-8"))
    }
    assert "fitting" in used
    assert not used & {*code.UNFINGERPRINTED_PARTS}
    assert re.fullmatch("[0-9a-f]{16}", code.fingerprint())


def test_what_is_made_otherwise_has_a_fingerprint_of_more_files() -> None:
    """Of changed clips, other systems, segments and timelines: of files that are there, and each of them counts."""
    parts = (
        *trials.CHANGES_CODE,
        *trials.EXTERNAL_SYSTEMS_CODE,
        *segment_trials.SEGMENT_CODE,
        *timeline_trials.TIMELINE_CODE,
    )
    assert all((code.PACKAGE / part).exists() for part in parts)
    assert len({code.fingerprint(), *map(code.fingerprint, parts)}) == len({*parts}) + 1
    assert code.fingerprint("evaluation", "segmentation") == code.fingerprint("segmentation", "evaluation")
