from __future__ import annotations

import pytest

from getagrip.clip import Clip, Masks
from helpers.scenes import egg_and_mug


@pytest.fixture(scope="session")
def scene() -> tuple[Clip, Masks]:
    """A mug that turns in a hand, which is an egg."""
    return egg_and_mug()
