"""A scene to export."""

from __future__ import annotations

import pytest

from getagrip.export import Scene
from helpers.exported import result_and_clip


@pytest.fixture
def scene() -> Scene:
    return Scene.of(*result_and_clip())
