"""What a message says to type installs an extra as this package was installed, never by a name of an index."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from getagrip.io import plugins

NEEDS = [
    "numpy>=2.0", "usd-core>=25.5; extra == 'usd'", "mujoco>=3.2; extra == 'mujoco'",
    "vhacdx>=0.0.8; extra == 'mujoco'", "getagrip[mujoco,usd]; extra == 'all'",
]  # fmt: skip


class Installed:
    """A distribution with some record of where it came from."""

    def __init__(self, record: object) -> None:
        self.record = record

    def read_text(self, name: str) -> str | None:
        assert name == "direct_url.json"
        return None if self.record is None else json.dumps(self.record)


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch):
    """Have the package installed by some record."""
    monkeypatch.setattr(metadata, "requires", lambda _: NEEDS)
    return lambda record: monkeypatch.setattr(metadata, "distribution", lambda _: Installed(record))


def test_from_a_clone_the_clone_is_named(installed, tmp_path: Path) -> None:
    folder = tmp_path / "a clone"
    folder.mkdir()
    installed({"url": folder.as_uri(), "dir_info": {"editable": True}})
    assert plugins.install_command("usd") == f'pip install -e "{folder}[usd]"'
    installed({"url": folder.as_uri(), "dir_info": {}})
    assert plugins.install_command("usd") == f'pip install "{folder}[usd]"'


def test_from_a_wheel_the_wheel_is_named_while_it_is_there(installed, tmp_path: Path) -> None:
    wheel = tmp_path / "getagrip-0.1.0-py3-none-any.whl"
    wheel.touch()
    installed({"url": wheel.as_uri(), "archive_info": {}})
    assert plugins.install_command("mujoco") == f'pip install "{wheel}[mujoco]"'
    wheel.unlink()
    assert plugins.install_command("mujoco") == 'pip install "mujoco>=3.2" "vhacdx>=0.0.8"'


@pytest.mark.parametrize("record", [None, [], {"url": "https://example.org/x.whl"}, {"url": 3}, "text"])
def test_else_the_libraries_are_named(installed, record: object) -> None:
    installed(record)
    assert plugins.install_command("usd") == 'pip install "usd-core>=25.5"'
    assert plugins.install_command("all") == 'pip install "mujoco>=3.2" "vhacdx>=0.0.8" "usd-core>=25.5"'


def test_every_extra_of_the_package_has_libraries() -> None:
    for extra in metadata.metadata("getagrip").get_all("Provides-Extra") or ():
        found = plugins.libraries_of(extra)
        assert found
        assert all(Requirement(each).name != "getagrip" for each in found)
