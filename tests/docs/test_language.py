"""One English: retired words of the glossary are used nowhere, and docstrings begin as those of the field do."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks import cite
from helpers.environment import ROOT
from helpers.pages import PAGES

SOURCES = sorted((ROOT / "src").rglob("*.py"))
TEXTS = sorted(
    path
    for folder in ("src", "scripts", "benchmarks")
    for path in (ROOT / folder).rglob("*")
    if path.suffix in {".py", ".js", ".html"}
)
"""Files whose prose is docstrings, comments, messages and what pages show."""
RETIRED = re.compile(
    r"\b(doubt(ed|ful|s)?|foret(ell|old)\w*|crews?|told|so many|(put|puts|set|sets) right|left behind"
    r"|of its kind|hands held|the held object|the given (hand|pose|mesh|mask)s?)\b".replace(" ", r"\s+"),
    re.IGNORECASE,
)
"""Prose: pages, docstrings, comments and messages."""
NAMES = re.compile(r"(^|_)(doubt(ed|ful|s)?|foretold|crews?|told|ways|held|given)(_|$)", re.IGNORECASE)
"""Identifiers."""
LOCAL = {"given", "held"}
"""Names that are fine alone: of an argument, and of a lock."""
EVERYDAY = set(
    re.findall(
        r"\w+",
        """
        LARGEST SMALLEST FEWEST LONGEST SHORTEST LEAST MOST FARTHEST NEAREST DEEPEST WIDEST HIGHEST LOWEST FINEST
        BESIDE APART ALONE ALIKE ENOUGH FEW LITTLE SURE ROUNDS ELSEWHERE MUCH SOME MANY OFTEN OURS THEIRS
        """,
    )
)
"""Words in no constant: MAX, MIN, THRESHOLD, WEIGHT, N and what of."""
FORMER_STEMS = set(
    re.findall(
        r"\w+",
        """
        usual judge solved_hand hand_with_object hand_errors hand_fit seen_joints predicted_silhouette misfit
        every_frame learn_priors soft settled between footage_of found cut hinge_fits lifted_again seen_ground
        steadied_hands carried_masks propagated_masks merged_masks shared_flow object_motion colour_cut fine_border
        frame_wanted click_motion drafting drafted_grasps finding_hands found_hands labelled labelled_footage
        written_files versions second_look selecting placed_hands clicked_hands lifted_hands named choices brief
        own_code leftovers extras plausible soft_edges label_choice naming per_frame share streamed keep validity
        imports of_timeline signs solved own_hands other_poses other_masks changes compared trial trials other_systems
        published own_mesh shown looking touched tiles states lists utils helpers common misc
        """,
    )
)
"""Stems of files that the field does not know."""
VERBS = re.findall(
    r"\w+",
    """
    Add Answer Apply Approximate Assign Average Begin Bend Blend Build Call Cancel Carry Check Choose Claim Clip
    Close Cluster Collect Combine Compare Compile Complete Compute Convert Copy Correlate Count Crop Cut Decode Delay
    Descend Describe Detect Differentiate Displace Do Draw Drop Embed Encode End Enlarge Enter Escape Estimate
    Evaluate Expand Explain Export Extend Fill Find Fit Flatten Flip Follow Give Group Grow Have Hold Identify
    Ignore Import Interpolate Join Judge Keep Learn Leave Let Lift Limit Link List Listen Load Lock Make Mark Match
    Measure Minimise Mirror Move Name Note Open Overwrite Pack Pair Parse Place Pop Predict Print Project Pull Put
    Raise Rank Read Reconstruct Reduce Refine Refuse Remove Render Repair Replace Report Resample Resolve Return
    Reverse Rotate Run Sample Say Scale Score Search Segment Select Send Serve Set Shift Shorten Show Shrink
    Simplify Simulate Skip Smooth Solve Split Stack Start Strike Strip Study Subdivide Sum Summarise Take Trace Track
    Transform Triangulate Turn Unpack Wait Widen Write Yield
    Download Extract Merge Propagate Redraw Resize Stabilize Stop Store Translate Undo
    """,
)
"""The words with which public functions begin. A new one is added here, if it is an imperative."""
ELLIPSES = re.compile(r"(Of|The same|Likewise|As|What|Whether|Where|How far)\b")
"""No docstring begins so: it would lean on the line above."""


def docstrings(tree: ast.Module) -> Iterator[tuple[ast.AST, str, int]]:
    """The docstrings of a module, its classes, functions and attributes: what they are of, text, line."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        for n, child in enumerate(body):
            if (
                isinstance(child, ast.Expr)
                and isinstance(child.value, ast.Constant)
                and isinstance(child.value.value, str)
            ):
                yield (node if n == 0 else body[n - 1]), child.value.value, child.lineno


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.stem not in {"glossary", "CHANGELOG"}], ids=lambda p: p.name
)
def test_pages_use_no_retired_word(page: Path) -> None:
    """Words of tables are those of the commit that measured them."""
    text = cite.WRITTEN.sub("", page.read_text(encoding="utf-8"))
    assert [match[0] for match in RETIRED.finditer(text)] == []


def test_the_next_release_uses_no_retired_word() -> None:
    _, unreleased, *_ = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## [")
    assert [match[0] for match in RETIRED.finditer(unreleased)] == []


def test_docstrings_comments_and_messages_use_no_retired_word() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{text.count(chr(10), 0, match.start()) + 1}: {match[0]}"
        for path in (*TEXTS, ROOT / "Makefile")
        for text in [path.read_text(encoding="utf-8")]
        for match in RETIRED.finditer(text)
    ]
    assert found == []


def test_identifiers_use_no_retired_word() -> None:
    found = set()
    for path in SOURCES:
        if NAMES.search(path.stem):
            found.add(path.name)
        for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
            if token.type == tokenize.NAME and NAMES.search(token.string) and token.string not in LOCAL:
                found.add(f"{path.relative_to(ROOT)}: {token.string}")
    assert sorted(found) == []


def test_no_docstring_is_an_ellipsis() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text[:40]}"
        for path in SOURCES
        for _, text, line in docstrings(ast.parse(path.read_text(encoding="utf-8")))
        if ELLIPSES.match(text)
    ]
    assert found == []


def test_public_functions_begin_with_a_verb_and_classes_do_not() -> None:
    """The classes of commands, datasets and figures are their help, which may ask to do something."""
    found = []
    for path in SOURCES:
        for node, text, line in docstrings(ast.parse(path.read_text(encoding="utf-8"))):
            first, where = text.split()[0].strip(",.:"), f"{path.relative_to(ROOT)}:{line}: {text[:50]}"
            if isinstance(node, ast.FunctionDef):
                public = not node.name.startswith("_") and not any(
                    "property" in ast.unparse(d) for d in node.decorator_list
                )
                found += [where] if public and first not in VERBS else []
            elif isinstance(node, ast.ClassDef) and not {"cli", "datasets", "figures"} & set(path.parts):
                found += [where] if first in VERBS else []
    assert found == []


def test_every_retired_word_of_the_glossary_is_looked_for() -> None:
    _, table = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8").split("## Retired words")
    words = [row.split("|")[1].strip() for row in table.strip().splitlines()[2:]]
    assert len(words) >= 8
    assert [word for word in words if not RETIRED.search(word) and not NAMES.search(word)] == []


def test_constants_say_what_of() -> None:
    """Everyday words cannot be searched for: LARGEST meant something else in nineteen files."""
    found = []
    for path in SOURCES:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", node)]
            names = [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
            found += [f"{path.stem}.{name}" for name in names if name.isupper() and EVERYDAY & set(name.split("_"))]
    assert found == []


def test_files_are_named_by_the_field() -> None:
    assert [str(path.relative_to(ROOT)) for path in SOURCES if path.stem in FORMER_STEMS] == []
