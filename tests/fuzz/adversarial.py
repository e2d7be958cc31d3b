"""Clips with impossible troubles, in every method: ``python -m fuzz.adversarial --clips N --seed S``.

Each clip is drawn from its number: a synthetic scene of a few frames, up to three troubles (``troubles``). A process of
its own, within limits of time and memory, runs the methods on it with few initial poses. Each has to end in a result
that is finite, reads back and says "failed" where it does not meet the masks, with something serious found
(``--strict``), or in an error of one line; numpy warns of nothing.

``--methods K`` takes K of the methods for each clip, in turn; ``--only NAME`` has one; ``--from K`` begins at another
number. What fails is printed with its number; the exit status is 1 if anything does.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from fuzz.troubles import RARE, TROUBLES
from getagrip.checks import MIN_MEAN_IOU
from getagrip.clip import Clip, Masks
from getagrip.errors import GetagripError
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction, read_result, write_result
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions

CATEGORIES = ("mug", "can", "plate", "scissors", "box")
SECONDS, MEGABYTES = 120.0, 3000
"""Limits of a clip in one method; most take less than a second. While others have the cores, no time passes."""
SCENE = SceneOptions(size=(160, 120), focal=150.0)


@dataclass(frozen=True)
class Case:
    """What is tried."""

    number: int
    category: str
    frames: int
    scale: str
    troubles: tuple[str, ...]
    methods: tuple[str, ...]

    @staticmethod
    def draw(number: int, seed: int = 0, methods: int = len(METHODS), only: str | None = None) -> Case:
        """The case of a number."""
        rng = np.random.default_rng([seed, number])
        weights = np.array([0.1 if name in RARE else 1.0 for name in TROUBLES])
        count = rng.choice([1, 1, 2, 3])
        troubles = rng.choice([*TROUBLES], size=count, replace=False, p=weights / weights.sum()).tolist()
        category, scale = str(rng.choice(CATEGORIES)), str(rng.choice(["known", "free"]))
        frames = int(rng.choice([2, 3, 4, 4, 4, 8]))
        names = [*METHODS]
        chosen = [only] if only else [names[(number * methods + k) % len(names)] for k in range(methods)]
        return Case(number, category, frames, scale, tuple(sorted(troubles)), tuple(chosen))

    def clip(self) -> tuple[Clip, Masks]:
        """The scene with its troubles."""
        options = replace(SCENE, frames=self.frames, scale="free" if self.scale == "free" else "known")
        clip, masks = synthesise(self.category, self.number % 7, options)
        clip = replace(clip, truth=None)
        for k, name in enumerate(self.troubles):
            clip, masks = TROUBLES[name](clip, masks, np.random.default_rng([self.number, k]))
        return clip, masks

    def options(self, method: str) -> Options:
        """Few initial poses and frames."""
        return Options(method=method, inits=2 if METHODS[method].slow else 4, frames=4, seed=self.number)


def faults(result: Reconstruction) -> list[str]:
    """What no result may be."""
    numbers = {
        "T_hand_obj": result.T_hand_obj, "scale": np.array(result.scale),
        "candidates": result.candidates.T_hand_obj, "energy": np.array([*result.energy.values()]),
    }  # fmt: skip
    if result.axis is not None:
        numbers |= {"direction": result.axis.direction, "angle": result.axis.angle}
    found = [f"{name} is not finite" for name, values in numbers.items() if not np.isfinite(values).all()]
    if (np.isnan(result.iou) & (np.array(result.frame_kind) != "interpolated")).any():
        found.append("iou is not a number where the object is visible")
    if not result.status.failed and not np.nanmean(result.iou) >= MIN_MEAN_IOU:
        found.append(f"{result.message} with an IOU of {np.nanmean(result.iou):.2f}")
    if result.status.failed and not any(finding.serious for finding in result.findings):
        found.append("failed, and no check finds anything serious: reconstruct --strict would exit with 0")
    try:
        with tempfile.TemporaryDirectory() as folder:
            read_result(write_result(result, Path(folder) / "result"))
    except Exception as error:  # whatever it is, it is a fault
        found.append(f"the result cannot be read back: {error}")
    return found


Ended = tuple[str, bool, str]
"""Of a method: its name, whether a case ended as it may, and how it ended."""


def attempts(case: Case) -> Iterator[Ended]:
    """How a case ends in each of its methods."""
    try:
        clip, masks = case.clip()
    except GetagripError as error:  # troubles that do not go together
        yield from ((method, "\n" not in str(error), f"refused: {error}") for method in case.methods)
        return
    for method in case.methods:
        yield method, *attempt(clip, masks, case.options(method))


def attempt(clip: Clip, masks: Masks, options: Options) -> tuple[bool, str]:
    """Whether a reconstruction ends as it may, and how it ends."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # numpy's, of numbers that are none
            result = reconstruct(clip, masks, options)
    except GetagripError as error:
        return "\n" not in str(error), f"refused: {error}"
    except Exception:  # whatever it is, it is a fault
        return False, traceback.format_exc()
    wrong = faults(result)
    return not wrong, "; ".join(wrong) or result.message


def limited(case: Case, seconds: float = SECONDS, megabytes: int = MEGABYTES) -> Iterator[Ended]:
    """The same in a process of its own; another one goes on with the methods after one that has ended it."""
    left = case.methods
    while left:
        fork = multiprocessing.get_context("fork")
        ours, theirs = fork.Pipe()
        process = fork.Process(target=_child, args=(replace(case, methods=left), megabytes, theirs))
        process.start()
        theirs.close()
        try:
            while left:
                if not _answers(ours, process.pid, seconds):
                    yield left[0], False, f"not done after {seconds:g} s"
                    break
                yield ours.recv()
                left = left[1:]
        except EOFError:
            process.join()
            yield left[0], False, f"the process died ({process.exitcode})"
        finally:
            process.kill()
            process.join()
        left = left[1:]


def _answers(pipe: Connection, pid: int | None, seconds: float) -> bool:
    """Whether a process answers within so many seconds, not counted those in which it waited for a core."""
    left = seconds
    while left > 0.01 * seconds:
        before = _waited(pid)
        if pipe.poll(left):
            return True
        left = _waited(pid) - before
    return False


def _waited(pid: int | None) -> float:
    """How long a process has waited for a core [s]; 0 where nobody says."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9
    except (OSError, IndexError, ValueError):
        return 0.0


def _child(case: Case, megabytes: int, answer: Connection) -> None:
    import resource

    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + megabytes * 2**20, resource.RLIM_INFINITY))
    for ended in attempts(case):
        answer.send(ended)


def main(arguments: list[str], trial: Callable[[Case], Iterator[Ended]] = limited) -> int:
    """Try some cases, and print those that fail; 1 if any does."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.adversarial", description=__doc__)
    parser.add_argument("--clips", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--from", type=int, default=0, dest="first")
    parser.add_argument("--methods", type=int, default=len(METHODS), choices=range(1, len(METHODS) + 1))
    parser.add_argument("--only", choices=[*METHODS], default=None)
    parser.add_argument("--verbose", action="store_true", help="print those that do not fail, too")
    wanted = parser.parse_args(arguments)
    ends, failed, slowest = Counter[str](), 0, 0.0
    for number in range(wanted.first, wanted.first + wanted.clips):
        case = Case.draw(number, wanted.seed, wanted.methods, wanted.only)
        since = time.perf_counter()
        for method, fine, how in trial(case):
            took, since = time.perf_counter() - since, time.perf_counter()
            slowest = max(slowest, took)
            failed += not fine
            ends[how.split(":")[0].split("\n")[0] if fine else "FAIL"] += 1
            if not fine or wanted.verbose:
                words = f"{case.category}, {case.frames} frames, scale {case.scale}, {', '.join(case.troubles)}"
                print(f"{'ok  ' if fine else 'FAIL'} {number} ({words}) {method}, {took:.1f} s: {how}", flush=True)
    print(
        f"{wanted.clips} clips, {sum(ends.values())} reconstructions, {failed} failed, the slowest took {slowest:.1f} s"
    )
    print(", ".join(f"{how} {n}" for how, n in ends.most_common()))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
