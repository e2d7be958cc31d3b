"""Mutate the package's source at random, one place at a time, and list the mutants that no test kills.

Cosmic Ray's operators make the changes. It is no part of the project's environment but has one of its own::

    python3 -m venv ../mutants && ../mutants/bin/pip install cosmic-ray==8.7.0
    nice ../mutants/bin/python scripts/mutants.py --seed 64

The tests are run by the project's Python in a copy of the tree. Each mutant first meets the test files that name its
module, and those that survive meet all tests in the folders of ``TESTS``. A test that fails kills a mutant, and so does
one that goes on beyond ``LIMITS``.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).resolve().parents[1]
TESTS = {
    "fitting/energy": ("fitting/energy", "kernels", "fitting"),
    "fitting/motion": ("fitting",),
    "kernels": ("kernels", "fitting/energy", "hands", "geometry", "fitting"),
    "least_squares.py": ("test_least_squares.py", "fitting"),
    "metrics": ("metrics", "evaluation", "checks"),
    "grasps": ("grasps", "datasets", "segmentation", "timelines"),
}
"""Sources to mutate, with their tests."""
LEFT_OUT = ("paper_pull.py", "paper_push.py")
LIMITS = (150, 900)
"""CPU time limits of the nearest tests and of all tests [s]: a mutant may never end."""
KINDS = re.compile(
    "core/(ReplaceBinaryOperator_((Add|Sub|Mul|Div|FloorDiv)_(Add|Sub|Mul|Div)|(Pow|Mod)_Mul"
    "|(RShift|LShift)_(RShift|LShift)|Bit(Or|And|Xor)_Bit(Or|And|Xor))"
    "|ReplaceComparisonOperator_((Eq|NotEq|Lt|LtE|Gt|GtE)_(Eq|NotEq|Lt|LtE|Gt|GtE)|Is_IsNot|IsNot_Is|In_NotIn|NotIn_In)"
    "|AddNot|Replace(And|Or|True|False|Break|Continue)With.*|ReplaceUnaryOperator_.*|NumberReplacer|ZeroIterationForLoop)"
)
"""Operators in use; others, such as shifts of floats, always fail."""
EQUIVALENT = {
    ("approximation.py", "x = np.zeros(11 if through is None else 9)"): "the ninth number moves nothing",
    ("least_squares.py", "step = -np.linalg.solve(A, g[..., None])[..., -1]"): "the axis has one entry",
    ("mask.py", "if total == bound[b]:  # the step is rejected, whatever the other frames say"): "it saves time only",
    ("silhouette.py", "PLANES = 5"): "the planes that are read hold the same, modulo 16",
}
"""Equivalent mutants, by file and changed line, with the reason."""


@dataclass(frozen=True)
class Mutant:
    """A source with one change: its file in the tree, the changed content, and the line before and after."""

    source: str
    code: str
    name: str
    old: str
    new: str

    @property
    def folders(self) -> tuple[str, ...]:
        return next(folders for part, folders in TESTS.items() if f"getagrip/{part}" in self.source)

    def tests(self, tree: Path) -> tuple[list[str], list[str]]:
        """Return the test files that name the module (else its folder), the nearest first, and all test files."""
        module = Path(self.source).with_suffix("")
        at = [tree / "tests" / folder for folder in self.folders]
        files = [*dict.fromkeys(f for one in at for f in (sorted(one.rglob("test_*.py")) if one.is_dir() else [one]))]
        for some, parts in ((files, module.parts[1:]), ([f for f in files if at[0] == f.parent], module.parts[1:-1])):
            named = re.compile(re.escape(".".join(parts)) + r"\b")
            near = [f for f in some if f.stem == f"test_{module.name}" or named.search(f.read_text(encoding="utf-8"))]
            if near:
                near.sort(key=lambda file: file.stem != f"test_{parts[-1]}")
                break
        return [str(file) for file in near], [str(file) for file in files]


def mutants(count: int, seed: int) -> list[Mutant]:
    """Draw places of all sources, and a possible change at each."""
    places: dict[tuple[str, tuple[int, int]], list[tuple[str, int]]] = defaultdict(list)
    for path in (ROOT / "src" / "getagrip" / part for part in TESTS):
        for file in sorted(path.glob("*.py")) if path.is_dir() else [path]:
            nodes = [*ast_nodes(get_ast(file.read_text(encoding="utf-8")))] if file.name not in LEFT_OUT else []
            for kind in filter(KINDS.fullmatch, operator_names()):
                positions = ((node, at) for node in nodes for at, _ in get_operator(kind)().mutation_positions(node))
                for occurrence, (node, at) in enumerate(positions):
                    if counts(node):
                        places[str(file.relative_to(ROOT)), at].append((kind, occurrence))
    rng, drawn = random.Random(seed), list[Mutant]()
    for source, (line, column) in sorted(rng.sample(sorted(places), count)):
        kind, occurrence = rng.choice(places[source, (line, column)])
        before = (ROOT / source).read_text(encoding="utf-8")
        code = mutate_code(before, get_operator(kind)(), occurrence)
        old, new = (text.splitlines()[line - 1].strip() for text in (before, code))
        drawn.append(Mutant(source, code, f"{source}:{line}:{column} {kind.removeprefix('core/')}", old, new))
    print(f"{count} of {len(places)} places, seed {seed}")
    return drawn


def counts(node) -> bool:
    """Return whether a node affects behaviour: not part of a type hint or of the guards ``frozen`` and ``strict``."""
    while node.parent is not None:
        above = node.parent
        hint = above.children[1] if above.type == "annassign" else getattr(above, "annotation", None)
        guard = above.type == "argument" and above.children[0].get_code().strip() in ("frozen", "strict")
        if node is hint or guard or above.type == "tfpdef":
            return False
        node = above
    return True


def first_failure(python: str, tree: Path, tests: list[str], limit: int, kernels: Path) -> str:
    """Return the first failing test in a tree, or how the tests ended; empty if they pass."""
    own = {"PYTHONPATH": str(tree / "src"), "NUMBA_CACHE_DIR": str(kernels), "OPENBLAS_NUM_THREADS": "1"}
    ended = subprocess.run(
        [python, "-m", "pytest", *tests, "-x", "-q", "-p", "no:cacheprovider"],
        cwd=tree, env=os.environ | own, capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (limit, limit)),
    )  # fmt: skip
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", ended.stdout, re.MULTILINE)
    return failed[0] if failed else f"exit {ended.returncode}" if ended.returncode else ""


def killer(python: str, tree: Path, mutant: Mutant, tests: list[str], limit: int) -> str:
    """Return the test that kills a mutant; the mutated file is restored afterwards."""
    file = tree / mutant.source
    kept = file.read_text(encoding="utf-8")
    compiled = "import kernel" in kept  # numba checks only a kernel's own source for changes, not its parts'
    kernels = tree.parent / ("own" if compiled else "kernels")
    file.write_text(mutant.code, encoding="utf-8")
    for bytecode in file.parent.glob(f"__pycache__/{file.stem}.*"):  # its source may have the same size and time
        bytecode.unlink()
    try:
        return first_failure(python, tree, tests, limit, kernels)
    finally:
        file.write_text(kept, encoding="utf-8")
        shutil.rmtree(tree.parent / "own", ignore_errors=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=64)
    parser.add_argument("--python", default=str(ROOT / ".venv" / "bin" / "python"), help="of the project")
    given = parser.parse_args()
    left = mutants(given.count, given.seed)
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        for name in subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).splitlines():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, tree / name)
        for stage, limit in enumerate(LIMITS):
            every = sorted({test for mutant in left for test in mutant.tests(tree)[stage]})
            if every and (failed := first_failure(given.python, tree, every, 3600, tree.parent / "kernels")):
                sys.exit(f"{failed} fails without any change")
            survivors = []
            for mutant in left:
                by = killer(given.python, tree, mutant, mutant.tests(tree)[stage], limit)
                print(f"{mutant.name}\n  - {mutant.old}\n  + {mutant.new}\n  {by or 'survives'}", flush=True)
                survivors += [] if by else [mutant]
            left = survivors
    reasons = [EQUIVALENT.get((Path(mutant.source).name, mutant.new)) for mutant in left]
    print(f"\n{given.count - len(left)} of {given.count} killed, {len([*filter(None, reasons)])} equivalent")
    for mutant, reason in zip(left, reasons, strict=True):
        print(f"{mutant.name}\n  - {mutant.old}\n  + {mutant.new}\n  {reason or 'SURVIVES'}")


if __name__ == "__main__":
    main()
