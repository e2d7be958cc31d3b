"""The fingerprint of the code covers all that a reconstruction may import, and no more parts than that."""

from __future__ import annotations

import re
import tomllib

from getagrip.bench import grasps, segments, timelines
from getagrip.io import plugins
from helpers.environment import ROOT


def test_parts_that_are_left_out_are_those_above_the_fit() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    layers = [re.findall(r"\w+", layer) for layer in contracts[0]["layers"]]
    (fit,) = (n for n, layer in enumerate(layers) if "fitting" in layer)
    above = {part for layer in layers[:fit] for part in layer}
    rooms = {part for part in plugins.UNFINGERPRINTED_PARTS if "/" not in part}
    assert rooms == above - {"reconstruct", "timelines"}  # which call the fit
    used = {
        part
        for path in (ROOT / "src/getagrip/timelines").glob("*.py")
        for part in re.findall(r"(?:from|import) getagrip\.([\w.]+)", path.read_text("utf-8"))
    }
    assert any(part.startswith("fitting.") for part in used)
    left_out = tuple(part.replace("/", ".") for part in plugins.UNFINGERPRINTED_PARTS)
    assert [part for part in used if f"{part}.".startswith(tuple(f"{left}." for left in left_out))] == []
    assert re.fullmatch("[0-9a-f]{16}", plugins.fingerprint())


def test_what_is_made_otherwise_has_a_fingerprint_of_more_files() -> None:
    """Of changed clips, other systems, segments and timelines: of files that are there, and each of them counts."""
    parts = (
        *grasps.CHANGES_CODE,
        *grasps.EXTERNAL_SYSTEMS_CODE,
        *segments.SEGMENT_CODE,
        *timelines.TIMELINE_CODE,
    )
    assert all((plugins.PACKAGE / part).exists() for part in parts)
    assert len({plugins.fingerprint(), *map(plugins.fingerprint, parts)}) == len({*parts}) + 1
    assert plugins.fingerprint("metrics/evaluate", "timelines/detect") == plugins.fingerprint(
        "timelines/detect", "metrics/evaluate"
    )
