"""``getagrip doctor``: is all there that a reconstruction needs, and does it work here?"""

from __future__ import annotations

import platform
import re
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from getagrip.batch.pool import cores

OPTIONAL = {"deodr": "the peer of the speed benchmark: pip install 'getagrip[bench]'"}
_REQUIREMENT = re.compile(r"([\w.-]+)>=([\d.]+)")


def run() -> int:
    """Print what is there, what is missing and whether a small clip can be reconstructed; 1 if anything is wrong.

    The first reconstruction compiles the kernels and keeps them on disk, so that later ones start at once.
    """
    print(f"getagrip {metadata.version('getagrip')}, Python {platform.python_version()}, {platform.platform()}")
    print(f"{cores()} cores to use")
    missing = _missing_libraries()
    for line in missing:
        print(f"MISSING  {line}")
    for name, purpose in OPTIONAL.items():
        version = _version(name)
        print(f"ok       {name} {version}" if version else f"without  {name}, {purpose}")
    if missing:
        return 1
    try:
        _try_out()
    except Exception as error:  # whatever it is, it is reported, not raised
        print(f"BROKEN   a synthetic clip cannot be reconstructed: {type(error).__name__}: {error}")
        return 1
    return 0


def _missing_libraries() -> list[str]:
    """The libraries that are needed and are not there, or too old; the others are printed."""
    missing = []
    for requirement in metadata.requires("getagrip") or ():
        match = _REQUIREMENT.match(requirement)
        if match is None or "extra ==" in requirement:
            continue
        name, least = match.groups()
        version = _version(name)
        if version is None:
            missing.append(f"{name} {least} or later: pip install '{name}>={least}'")
        elif _numbers(version) < _numbers(least):
            missing.append(f"{name} {least} or later, here is {version}: pip install '{name}>={least}'")
        else:
            print(f"ok       {name} {version}")
    return missing


def _version(name: str) -> str | None:
    """The installed version of a library."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _numbers(version: str) -> list[int]:
    """The leading numbers of a version, to compare it by."""
    return [int(part) for part in re.findall(r"\d+", version)[:3]]


def _try_out() -> None:
    """Make a small clip and take it through every step, twice; only the first time is anything compiled."""
    from getagrip.batch.job import Job, reconstruct_one
    from getagrip.clip import read_clip, read_masks, write_clip
    from getagrip.datasets.synthetic.scene import synthesise
    from getagrip.datasets.synthetic.scene_options import SceneOptions
    from getagrip.evaluation import evaluate_result
    from getagrip.fitting.options import Options

    with TemporaryDirectory() as folder:
        clip = Path(folder) / "clip"
        write_clip(*synthesise("can", 0, SceneOptions(frames=6)), clip)
        read_masks(read_clip(clip))
        for n, words in enumerate(("compiling included", "compiled")):
            began = perf_counter()
            out = Path(folder) / f"result-{n}"
            outcome = reconstruct_one(Job("can", clip, out, Options(), overwrite=False))
            if outcome.state != "done":
                raise RuntimeError(outcome.message)
            add = evaluate_result(out, clip)["metrics"]["add_sym_mm"]
            print(f"ok       a can in 6 frames, {add:.1f} mm off, {perf_counter() - began:.1f} s, {words}")
