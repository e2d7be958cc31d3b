"""Plug-ins of other packages, extras, and the fingerprint of the code."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from getagrip.bench import grasps
from getagrip.bench.sequences import segments, timelines
from getagrip.checks import Check, Evidence, run_checks
from getagrip.errors import UsageError
from getagrip.io import plugins
from getagrip.io.plugins import PluginTable
from getagrip.metrics.evaluate.comparison import Comparison
from getagrip.metrics.evaluate.metric import IOU, Metric, compute_metrics
from helpers.clips import small_clip
from helpers.environment import ROOT, write_package

Install = Callable[..., Path]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install a package of one module, for this test."""
    monkeypatch.setattr(plugins, "PLUGIN_TABLES", {})
    monkeypatch.syspath_prepend(tmp_path)
    plugins._find_entry_points.cache_clear()
    plugins.warn_once.cache_clear()
    return lambda *package, **entries: write_package(tmp_path, *package, **entries)


@pytest.fixture(autouse=True)
def _as_before() -> object:
    yield
    plugins._find_entry_points.cache_clear()


def numbers() -> PluginTable[int]:
    return PluginTable("numbers", {"one": 1}, "an int", lambda _, it: isinstance(it, int))


def test_names_are_known_and_objects_loaded_when_asked_for(install: Install, tmp_path: Path) -> None:
    code = f"import os\nos.mkdir({str(tmp_path / 'loaded')!r})\nTWELVE = 12\n"
    install("dozen", "1.2", code, numbers="twelve = dozen:TWELVE")
    table = numbers()
    assert ([*table], len(table), "twelve" in table, "two" in table) == (["one", "twelve"], 2, True, False)
    assert not (tmp_path / "loaded").exists()
    assert table["twelve"] == 12
    assert (tmp_path / "loaded").exists()
    assert table.working() == {"one": 1, "twelve": 12}
    assert plugins.plugin_packages() == ["dozen 1.2"]
    assert plugins.fingerprint_with_plugins().endswith(" with dozen 1.2")


@pytest.mark.parametrize(
    ("code", "why"),
    [
        ("import nowhere", "ModuleNotFoundError: No module named 'nowhere'"),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("class Stop(BaseException): pass\nraise Stop('here')", "Stop: here"),
        ("1 / 0", "ZeroDivisionError"),
        ("", "has no attribute 'TWELVE'"),
        ("TWELVE = 'dozen'", "must be an int (got 'dozen')"),
    ],
)
def test_a_broken_one_is_named_and_left_out(
    install: Install, capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest, code: str, why: str
) -> None:
    module = f"torn{request.node.callspec.indices['code']}"
    install(module, "0.1", code, numbers=f"twelve = {module}:TWELVE")
    table = numbers()
    with pytest.raises(UsageError) as caught:
        table["twelve"]
    assert f"getagrip.numbers 'twelve' of {module} 0.1 ({module}:TWELVE)" in str(caught.value)
    assert why in str(caught.value)
    for _ in range(2):
        assert table.working() == {"one": 1}
    assert capsys.readouterr().err == f"warning: left out: {caught.value}\n"


def test_a_name_that_is_taken_is_refused(install: Install, capsys: pytest.CaptureFixture[str]) -> None:
    install("uno", "3.0", "ONE = 11", numbers="one = uno:ONE\n../two = uno:ONE")
    table = numbers()
    assert table.working() == {"one": 1}
    lines = capsys.readouterr().err.splitlines()
    assert "'../two' of uno 3.0 (uno:ONE) is left out: its name must be one that a folder can have" in lines[0]
    assert "'one' of uno 3.0 (uno:ONE) is left out: getagrip has 'one' itself" in lines[1]


def test_of_two_packages_with_one_name_neither_is_used(install: Install, capsys: pytest.CaptureFixture[str]) -> None:
    install("deux", "1", "TWO = 2", numbers="two = deux:TWO")
    install("zwei", "2", "TWO = 2", numbers="two = zwei:TWO")
    table = numbers()
    with pytest.raises(UsageError, match=r"'two' of deux 1 .* and getagrip.numbers 'two' of zwei 2 .* the same name"):
        table["two"]
    assert table.working() == {"one": 1}
    assert "deux 1" in capsys.readouterr().err


def test_it_is_said_what_a_result_was_made_with(install: Install) -> None:
    code = "def FOUR():\n    return 4\n"
    file = install("four", "4.0", code, methods="four = four:FOUR", input_checks="four = four:FOUR")
    found = []
    for text in (code, code + "# another source\n"):
        file.write_text(text)
        for kind in ("methods", "input_checks"):
            PluginTable(kind, {}, "a function", lambda _, it: callable(it))
        assert plugins.plugin_dependencies("static")["plugins"].startswith("four 4.0 (input_checks four ")
        found.append(plugins.plugin_dependencies("four")["plugins"])
    assert [text.count("four 4.0") for text in found] == [2, 2]
    assert found[0] != found[1]


def test_one_that_raises_stops_nothing_else(install: Install, capsys: pytest.CaptureFixture[str]) -> None:
    code = "from getagrip.checks import Check\nfrom getagrip.metrics.evaluate.metric import Metric\n"
    code += "CHECK = Check('cross', lambda it: 1 / 0, '', '')\nMETRIC = Metric('cross', lambda it, _: 1 / 0)\n"
    install("cross", "1", code, checks="cross = cross:CHECK", metrics="cross = cross:METRIC")
    checks = PluginTable[Check]("checks", {}, "a Check", lambda _, it: isinstance(it, Check))
    metrics = PluginTable[Metric]("metrics", {}, "a Metric", lambda _, it: isinstance(it, Metric))
    clip, masks = small_clip()
    ours = Check("ours", lambda it: 1.0, "", "")
    measured, findings = run_checks([*checks.working().values(), ours], Evidence(clip, masks))
    assert measured["ours"] == 1.0
    (finding,) = findings
    assert str(finding).startswith("note: cross: getagrip.checks 'cross' of cross 1 (cross:CHECK) failed: ZeroDivision")
    assert compute_metrics(Comparison(clip, masks), [*metrics.working().values()]) == ({}, {})
    assert "getagrip.metrics 'cross' of cross 1 (cross:METRIC) failed" in capsys.readouterr().err
    with pytest.raises(NotImplementedError):
        compute_metrics(Comparison(clip, masks), [IOU])


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
