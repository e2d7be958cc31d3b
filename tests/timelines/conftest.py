"""Inputs of the synthetic timeline."""

from __future__ import annotations

import pytest

from getagrip.clip import with_masks
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.timelines.observations import TimelineInputs
from helpers.scenes import timeline


@pytest.fixture(scope="module")
def footage() -> TimelineInputs:
    return TimelineInputs.of(repair_input(with_masks(*timeline()), Options(inits=4)))
