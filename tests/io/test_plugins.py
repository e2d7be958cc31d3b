"""What other packages add: found by name, loaded when used, and left out with a reason where that fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from getagrip.checks import Check, Evidence, run_checks
from getagrip.errors import UsageError
from getagrip.io import plugins
from getagrip.io.plugins import PluginTable
from getagrip.metrics.evaluate.comparison import Comparison
from getagrip.metrics.evaluate.metric import IOU, Metric, compute_metrics
from helpers.clips import small_clip
from helpers.environment import write_package

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
