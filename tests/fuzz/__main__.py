"""``make fuzz MINUTES=n``: change valid inputs of every reader, and keep each case that goes wrong.

Readers take turns of some seconds. A finding is shrunk, printed, and written to ``tests/fuzz/cases/``, where the
tests find it; the same fault is not looked at again. The exit status is 1 if anything was found.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from itertools import count
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # children are forked: no threads before

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.errors import Flaky

from fuzz.child import SHARED, Finding
from fuzz.corpus import READERS, Seed, keep
from fuzz.mutations import Changes, changes

TURN = 4.0
"""Seconds of a reader at a time."""
SHRINKING = 45.0
"""Seconds that a finding is shrunk."""


class WrongError(Exception):
    """Tells hypothesis that a case is a finding."""


class TimeUp(BaseException):
    """Ends a turn; no ``Exception``, which hypothesis would take for a finding."""


def turn(
    place: Seed, number: int, known: set[str], cases: int | None = None
) -> tuple[int, tuple[Finding, Changes] | None]:
    """Try cases for some seconds, or a number of ``cases``.

    Returns how many were tried, and one that goes wrong in a way not ``known``, made small.
    """
    end, tried = time.monotonic() + (TURN if cases is None else float("inf")), 0
    best: tuple[Finding, Changes] | None = None

    @settings(
        max_examples=cases or 100, database=None, deadline=None, phases=(Phase.generate, Phase.shrink),
        print_blob=False,
        suppress_health_check=list(HealthCheck), report_multiple_bugs=False,
    )  # fmt: skip
    @given(changes(place.changeable))
    def attempt(case: Changes) -> None:
        nonlocal tried, best, end
        if time.monotonic() > end:
            raise TimeUp
        tried += 1
        found = place.attempt(case)
        if found is None or found.what in known or (best and found.what != best[0].what):
            return
        if best is None:
            end = time.monotonic() + SHRINKING
        if best is None or _size(case) <= _size(best[1]):
            best = found, case
        raise WrongError

    for round_ in count() if cases is None else range(1):
        try:
            seed(1000 * number + round_)(attempt)()
        except (WrongError, Flaky, TimeUp):  # Flaky: it goes wrong now and then
            break
    place.child.close()
    return tried, best


def _size(case: Changes) -> int:
    return sum(len(content) for content in case.values())


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--turns", type=int, default=None, help="of each reader, in place of --minutes")
    parser.add_argument("--cases", type=int, default=None, help=f"of a turn (default: as many as take {TURN:g} s)")
    parser.add_argument("--only", choices=[*READERS], action="append", help="these readers alone")
    parser.add_argument("--seed", type=int, default=None, help="(default: the time)")
    wanted = parser.parse_args(arguments)
    os.environ["XDG_CACHE_HOME"] = str(SHARED / "cache")
    first = int(time.time()) if wanted.seed is None else wanted.seed
    end = time.monotonic() + 60.0 * wanted.minutes
    tried, found = dict.fromkeys(wanted.only or READERS, 0), 0
    with tempfile.TemporaryDirectory() as folder:
        seeds, known = {}, {name: set[str]() for name in tried}
        for name in tried:
            seeds[name] = Seed.write(name, Path(folder))
            wrong = seeds[name].attempt({})
            seeds[name].child.close()
            if wrong is not None:
                print(f"{name}: not even the valid input is read: {wrong.what}\n{wrong.details}", flush=True)
                return 1
        for number in count(first):
            for name, place in seeds.items():
                if time.monotonic() > end if wanted.turns is None else number == first + wanted.turns:
                    total = sum(tried.values())
                    print(f"seed {first}: {total} cases of {len(tried)} readers, {found} findings")
                    print(", ".join(f"{name} {n}" for name, n in tried.items()))
                    return int(found > 0)
                n, wrongly = turn(place, number, known[name], wanted.cases)
                tried[name] += n
                if wrongly is not None:
                    found += 1
                    known[name].add(wrongly[0].what)
                    path = keep(name, wrongly[1], wrongly[0].what)
                    where = path or f"too large to keep: {sorted(wrongly[1])}, seed {number}"
                    print(f"{name}: {wrongly[0].what}\n{wrongly[0].details}\n  {where}\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
