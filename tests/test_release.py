"""What a release is made of: README as an index shows it, the changelog, citations, extras."""

from __future__ import annotations

import importlib.util
import json
import re
import tomllib
from types import ModuleType

import pytest
import yaml
from markdown_it import MarkdownIt

import getagrip
from helpers.environment import ROOT

README = (ROOT / "README.md").read_text("utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
HOME = "https://example.org/who/getagrip"


def hook() -> ModuleType:
    """The step of the build."""
    pytest.importorskip("hatchling", reason="the build back end is not installed")
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def targets(text: str) -> list[str]:
    """Where the links and pictures of a page lead."""
    found = []
    for block in MarkdownIt("commonmark").enable("table").parse(text):
        for token in block.children or ():
            target = token.attrGet("href") or token.attrGet("src")
            found += [str(target)] if target else []
    return found


def test_readme_has_only_absolute_links_at_the_tag_once_it_is_built() -> None:
    text = hook().for_index(README, HOME, "v0.1.0")
    relative = [target for target in targets(README) if not target.startswith(("https://", "#"))]
    assert len(relative) > 30
    for target in relative:
        kind = "raw" if target.startswith("docs/images/") else "blob"
        assert f"{HOME}/{kind}/v0.1.0/{target}" in targets(text)
    assert all(target.startswith(("https://", "#")) for target in targets(text))
    assert "<!--" not in text
    assert "python run" not in text


def test_readme_has_no_link_that_leads_nowhere_where_the_repository_is_not_known() -> None:
    text = hook().for_index(README, "", "v0.1.0")
    assert [target for target in targets(text) if not target.startswith("https://")] == []
    assert "All results, also those of ten objects never seen" in text


def test_pages_are_linked_on_the_site_where_it_has_an_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GETAGRIP_SITE", raising=False)
    assert hook().site() == ""
    for wrong in ("getagrip.example.org", "https://example.org/a b"):
        monkeypatch.setenv("GETAGRIP_SITE", wrong)
        with pytest.raises(ValueError, match="GETAGRIP_SITE"):
            hook().site()
    monkeypatch.setenv("GETAGRIP_SITE", "https://docs.example.org/getagrip/")
    pages = hook().site()
    assert hook().addresses("", pages) == {"Documentation": f"{pages}/", "Paper": hook().PAPER}
    for home in (HOME, ""):
        found = targets(hook().for_index(README, home, "v0.1.0", pages))
        for target in targets(README):
            if match := re.fullmatch(r"docs/([\w-]+)\.md(#.*)?", target):
                assert f"{pages}/{match[1]}.html{match[2] or ''}" in found
        assert not any("/docs/" in target and ".md" in target for target in found)


def test_the_repository_is_that_of_the_continuous_integration(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("GETAGRIP_REPOSITORY", "GITHUB_REPOSITORY", "GITHUB_SERVER_URL"):
        monkeypatch.delenv(name, raising=False)
    assert hook().repository() == ""
    assert [*hook().addresses("")] == ["Paper"]
    monkeypatch.setenv("GITHUB_SERVER_URL", "https://example.org")
    monkeypatch.setenv("GITHUB_REPOSITORY", "who/getagrip")
    assert hook().repository() == HOME
    assert hook().addresses(HOME)["Issues"] == f"{HOME}/issues"


def test_version_changelog_and_citations_agree() -> None:
    version = getagrip.__version__
    changelog = (ROOT / "CHANGELOG.md").read_text("utf-8")
    headings = re.findall(r"^## \[(.+?)\](?: - (\d{4}-\d{2}-\d{2}))?$", changelog, re.MULTILINE)
    assert headings[0] == ("Unreleased", "")
    assert headings[1][0] == version
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert (citation["version"], str(citation["date-released"])) == headings[1]
    assert citation["license"] == PROJECT["license"]
    paper = citation["references"][0]
    assert f"  title   = {{{paper['title']}}}" in README
    zenodo = json.loads((ROOT / ".zenodo.json").read_text("utf-8"))
    assert (zenodo["version"], zenodo["title"]) == (version, citation["title"])
    assert zenodo["license"] == PROJECT["license"]


def test_the_extra_all_has_what_users_may_need() -> None:
    extras = PROJECT["optional-dependencies"]
    assert extras["all"] == [f"getagrip[{','.join(sorted(set(extras) - {'all'}))}]"]


def test_the_workflow_tries_every_python_that_is_classified() -> None:
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text("utf-8"))
    matrix = workflow["jobs"]["test"]["strategy"]["matrix"]
    classified = [line.rsplit(" ", 1)[-1] for line in PROJECT["classifiers"] if ":: 3." in line]
    assert matrix["python"] == classified
    assert {system.split("-")[0] for system in matrix["system"]} == {"ubuntu", "macos", "windows"}
    assert any(line.endswith(":: Linux") for line in PROJECT["classifiers"])
