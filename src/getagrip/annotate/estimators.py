"""Estimators that a user has: scripts that run in environments of their own, on a folder of images.

Each is a line of ``ESTIMATORS``. The command that starts its script (``scripts/estimators``) is in a variable of the
environment, ``GETAGRIP_SAM2`` for ``sam2``; the words of the line are appended to it.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from getagrip.errors import UsageError
from getagrip.io.terminal import print_note


@dataclass(frozen=True)
class Estimator:
    """An estimator."""

    makes: Literal["masks", "hands"]
    script: str
    """Its script, for the advice on how to set it up."""
    words: str
    """Arguments of the script; a name in braces stands for values of the video, or a place to write to. Without values
    it is left out, with the option before it."""
    reader: str = ""
    """Tracker that reads its files (``import hands --from``); without one, they are masks or a hand file."""


ESTIMATORS = {
    "sam2": Estimator("masks", "sam_masks.py sam2", "{images} --box {box} --out {out}"),
    "sam3": Estimator("masks", "sam_masks.py sam3", "{images} --box {box} --text {word} --out {out}"),
    "hamer": Estimator(
        "hands", "hamer_hands.py", "{images} --side {side} --K {K} --boxes {boxes} --near {near} --out {hand}"
    ),
    "wilor": Estimator("hands", "wilor.py", "{images} --side {side} --K {K} --near {near} --out {hand}"),
    "hawor": Estimator("hands", "hawor_hands.py", "{images} --K {K} --out {out}", "hawor"),
}


def estimators_making(makes: str) -> tuple[str, ...]:
    """Return the names of the estimators that make ``masks`` or ``hands``."""
    return tuple(name for name, one in ESTIMATORS.items() if one.makes == makes)


def command_variable(name: str) -> str:
    """Return the environment variable that holds an estimator's command."""
    return f"GETAGRIP_{name.upper()}"


def setup_advice(name: str) -> str:
    """Say how to set an estimator up."""
    return f"{command_variable(name)}='/environments/{name}/bin/python /scripts/{ESTIMATORS[name].script}', see estimators.md"


def estimator_command(name: str) -> list[str] | None:
    """Return the words of an estimator's command; None where it is not set up.

    Raises ``UsageError`` for a command whose program or script is not there.
    """
    try:
        words = shlex.split(os.environ.get(command_variable(name), ""))
    except ValueError as error:
        raise UsageError(f"{command_variable(name)} must be a command ({error})") from error
    if not words:
        return None
    program = shutil.which(words[0])
    if program is None or any(word.endswith(".py") and not Path(word).is_file() for word in words):
        lost = words[0] if program is None else next(word for word in words if word.endswith(".py"))
        raise UsageError(f"{command_variable(name)} must be a command that is there (got {lost})")
    return [program, *(str(Path(word).absolute()) if word.endswith(".py") else word for word in words[1:])]


def check_estimator(name: str) -> None:
    """Raise ``UsageError`` for an estimator that is not set up."""
    if estimator_command(name) is None:
        raise UsageError(f"missing {command_variable(name)}: the command that runs {name}; {setup_advice(name)}")


def run_estimator(name: str, values: Mapping[str, Sequence[object]], out: Path) -> None:
    """Run an estimator, in the folder of its script; it writes into ``out``, which must exist.

    ``values`` are those of the names in its words. Raises ``UsageError`` with the last line that it printed where it
    fails or writes nothing.
    """
    check_estimator(name)
    words = estimator_command(name) or []
    values = {**values, "out": [out.absolute()], "hand": [out.absolute() / "hand.npz"]}
    for word in ESTIMATORS[name].words.split():
        known = not word.startswith("{") or word[1:-1] in values
        words += [word] if not word.startswith("{") else map(str, values.get(word[1:-1], ()))
        if not known:
            words.pop()  # its option
    where = next((Path(word).parent for word in words if word.endswith(".py")), None)
    print_note(f"{name}: {shlex.join(words)}")
    done = subprocess.run(words, cwd=where, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode or not any(out.iterdir()):
        said = ((done.stderr.strip() or done.stdout.strip()).splitlines() or ["it said nothing"])[-1]
        failed = f"failed with status {done.returncode}" if done.returncode else "wrote nothing"
        raise UsageError(f"{name} {failed}: {said}")
