"""``getagrip doctor``: checks of the installation and of a small reconstruction.

Each line begins with ``ok``, ``without`` (an optional part), ``MISSING`` or ``BROKEN``; all but ``ok`` give advice.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from time import perf_counter
from typing import Annotated, Literal

from tyro.conf import arg

from getagrip.cli.command import Command
from getagrip.errors import GetagripError, UsageError
from getagrip.io import files
from getagrip.io.options import OptionalFolder, one_of
from getagrip.io.plugins import install_command

EXTRA_PURPOSES = {
    "torch": "reads estimators' .pt files", "lerobot": "exports to LeRobot", "mujoco": "exports to MuJoCo",
    "usd": "exports to USD", "ray": "`--engine ray`", "slurm": "`--engine slurm`",
    "s3": "clips and results at s3:// addresses", "gs": "at gs:// addresses",
    "bench": "the peer of the speed benchmark", "hands": "finds hands in a video",
}  # fmt: skip
"""Purpose of each extra of the package."""
BROWSER_COMMANDS = ("chromium", "chromium-browser", "google-chrome", "firefox", "open", "xdg-open")
MIN_DISK_GB, MIN_MEMORY_GB = 1.0, 2.0
"""Minimum free disk space for results, and minimum memory [GB]."""
_REQUIREMENT_PATTERN = re.compile(r"([\w.-]+)[^;]*?[>=]=([\d.]+)")
_EXTRA_PATTERN = re.compile(r"extra == ['\"](\w+)['\"]")

Line = tuple[str, str]
"""State and words of a line."""


@dataclass(frozen=True, kw_only=True)
class Doctor(Command):
    """Check the installation, and compile what the first run would have to."""

    mano: OptionalFolder = None
    """Folder of your MANO_RIGHT.pkl and MANO_LEFT.pkl, to be tried."""
    address: Annotated[str | None, arg(metavar="ADDR", help_behavior_hint="(default: RAY_ADDRESS)")] = None
    """Ray cluster to be tried."""
    fetch: Annotated[Literal["hands"] | None, one_of("hands"), arg(help_behavior_hint="")] = None
    """Fetch MediaPipe's hand models (Apache-2.0, 8 MB) by pip, into the cache, for `draft`."""
    models: OptionalFolder = None
    """Folder of the hand models, to be tried (default: the cache)."""

    def run(self) -> int:
        """Print the state of each part and reconstruct a small clip; return 1 if a required part fails, else 0.

        The reconstruction compiles the kernels and keeps them on disk, so that later ones start at once.
        """
        print(f"getagrip {metadata.version('getagrip')}, Python {platform.python_version()}, {platform.platform()}")
        if self.fetch:
            from getagrip.studio.hands import download_models

            for path in download_models():
                print(f"ok       {path}")
        wrong = False
        checks = (
            _check_libraries(),
            _check_extras(),
            _check_plugins(),
            _check_clusters(self.address),
            _check_machine(),
            _check_mano(self.mano),
            _check_hand_models(self.models),
            _check_estimators(),
        )
        for check in checks:
            for state, words in check:
                print(f"{state:<8} {words}", flush=True)
                wrong |= state in ("MISSING", "BROKEN")
        if wrong:
            return 1
        try:
            _smoke_test()
        except Exception as error:  # any error is reported, not raised
            print(f"BROKEN   a synthetic clip cannot be reconstructed: {type(error).__name__}: {error}")
            return 1
        return 0


def _check_libraries() -> Iterator[Line]:
    for name, least, extra in _requirements():
        if not extra:
            yield _check_library(name, least, "MISSING", f'pip install "{name}>={least}"')


def _check_extras() -> Iterator[Line]:
    """Yield a line for each optional library, and for a browser."""
    for name, least, extra in _requirements():
        if extra in EXTRA_PURPOSES:
            yield _check_library(name, least, "without", f"{EXTRA_PURPOSES[extra]}: {install_command(extra)}")
    found = next(filter(None, map(shutil.which, BROWSER_COMMANDS)), None)
    needed = "pages of `report`, `view` and `annotate` open in one: install Chromium or Firefox, or open them elsewhere"
    yield ("ok", f"browser {found}") if found else ("without", f"browser; {needed}")


def _check_plugins() -> Iterator[Line]:
    import getagrip.checks
    import getagrip.cli.datasets
    import getagrip.export
    import getagrip.metrics.evaluate
    import getagrip.readers.trackers  # noqa: F401 - all tables
    from getagrip.io.plugins import PLUGIN_TABLES

    for table in PLUGIN_TABLES.values():
        for name, plugin in table.plugins.items():
            try:
                table[name]
            except UsageError as error:
                yield "BROKEN", str(error)
            else:
                yield "ok", str(plugin)


def _check_clusters(address: str | None) -> Iterator[Line]:
    """Yield a line each for Ray and Slurm, and for the reply of a Ray cluster."""
    from getagrip.batch.clusters import check_ray_address

    address = address or os.environ.get("RAY_ADDRESS")
    if address is None or ":" not in address:
        advice = "name one by --address HOST:PORT or RAY_ADDRESS, else `--engine ray` starts its own here"
        yield "without", f"Ray cluster; {advice}"
    else:
        try:
            check_ray_address(address)
        except (OSError, ValueError) as error:
            advice = "is `ray start --head` running there, is the port open?"
            yield "BROKEN", f"Ray cluster {address} does not answer ({error}); {advice}"
        else:
            yield "ok", f"Ray cluster {address} answers"
    sbatch = shutil.which("sbatch")
    slurm = f"Slurm: {sbatch}" if sbatch else "Slurm; `--engine slurm` needs a machine that has the command sbatch"
    yield "ok" if sbatch else "without", slurm


def _requirements() -> Iterator[tuple[str, str, str]]:
    """Yield name, minimum version and extra ("" for none) of each library."""
    for requirement in metadata.requires("getagrip") or ():
        match, extra = _REQUIREMENT_PATTERN.match(requirement), _EXTRA_PATTERN.search(requirement)
        if match is not None:
            yield match[1], match[2], extra[1] if extra else ""


def _check_library(name: str, least: str, otherwise: str, advice: str) -> Line:
    version = _installed_version(name)
    if version is None:
        return otherwise, f"{name} {least} or later; {advice}"
    if _version_numbers(version) < _version_numbers(least):
        return otherwise, f"{name} {least} or later, here is {version}; {advice}"
    return "ok", f"{name} {version}"


def _check_machine() -> Iterator[Line]:
    """Yield lines on cores, file locks, linear algebra, disk and memory."""
    import scipy.linalg  # noqa: F401 - loads its own BLAS
    from threadpoolctl import threadpool_info

    from getagrip.batch.executor import available_cores

    yield "ok", f"{available_cores()} cores to use, a clip on each: --workers"
    if not files.HAS_FILE_LOCKS:
        yield "without", "locks on files, which this system has none of: one call at a time into a folder"
    for blas in {str(one["filepath"]): one for one in threadpool_info() if one["user_api"] == "blas"}.values():
        name = f"{blas['internal_api']} {blas['version']} ({Path(blas['filepath']).name})"
        yield "ok", f"BLAS {name}, threads: {blas['num_threads']}; a reconstruction uses one, whatever is set"
    for what, folder in (("this folder", Path.cwd()), ("temporary files", Path(gettempdir()))):
        free = shutil.disk_usage(folder).free / 1e9
        state = "ok" if free >= MIN_DISK_GB else "BROKEN"
        yield state, f"{free:.1f} GB free for {what} ({folder})" + ("; make room" if state != "ok" else "")
    if (memory := _free_memory()) is not None:
        few = max(1, int(memory / 0.5))
        advice = "" if memory >= MIN_MEMORY_GB else f"; end other programs, or --workers {few}"
        yield "ok" if memory >= MIN_MEMORY_GB else "without", f"{memory:.1f} GB of memory free, 0.5 GB a worker{advice}"


def _free_memory() -> float | None:
    """Return the available memory without swapping [GB], if the system states it."""
    try:
        found = re.search(r"^MemAvailable:\s*([0-9]+) kB", Path("/proc/meminfo").read_text(), re.MULTILINE)
    except OSError:
        return None
    return None if found is None else int(found[1]) / 1e6


def _check_mano(folder: Path | None) -> Iterator[Line]:
    """Yield lines on the user's own MANO files."""
    if folder is None:
        yield "without", "MANO: getagrip doctor --mano DIR tries your files (https://mano.is.tue.mpg.de)"
        return
    import numpy as np

    from getagrip.hands import mano
    from getagrip.hands.model import Side

    sides: tuple[Side, ...] = ("right", "left")
    for side in sides:
        path = folder / f"MANO_{side.upper()}.pkl"
        try:
            mean = float(np.abs(mano.load(path, side).mean).max())
        except GetagripError as error:
            yield "BROKEN", f"MANO: {error}; download it anew from https://mano.is.tue.mpg.de"
            continue
        yield "ok", f"MANO, {side} hand: {path}, mean pose up to {mean:.2f} rad"
    flat, mean_pose = "to the flat hand (HaMeR, HO-3D, HOI4D)", "to its mean pose (DexYCB, HOT3D, ARCTIC)"
    asked = "`import hands --from mano` asks for it"
    yield "ok", f"no MANO file records how poses are given: relative {flat}, or {mean_pose}; {asked}"


def _check_hand_models(folder: Path | None) -> Iterator[Line]:
    """Yield a line on the models that find hands, which are loaded and tried."""
    from getagrip.studio.hands import load_models
    from getagrip.studio.hands.networks import missing_model_files, model_folder

    where = folder or model_folder()
    if missing_model_files(folder):
        yield "without", f"hand models in {where}, which `draft` needs: getagrip doctor --fetch hands"
        return
    try:
        nets = load_models(folder)
    except GetagripError as error:
        yield "BROKEN", f"hand models: {error}"
        return
    slow = "" if nets.runtime == "LiteRT" else f"; six times as fast: {install_command('hands')}"
    yield "ok", f"hand models in {where}, run by {nets.runtime}{slow}"


def _check_estimators() -> Iterator[Line]:
    from getagrip.studio.jobs import ESTIMATORS, estimator_command, setup_advice

    for name, one in ESTIMATORS.items():
        try:
            words = estimator_command(name)
        except UsageError as error:
            yield "BROKEN", str(error)
        else:
            what = f"draft --{one.makes} {name}"
            yield ("ok", f"{what}: {' '.join(words)}") if words else ("without", f"{what}; {setup_advice(name)}")


def _installed_version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _version_numbers(version: str) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", version)[:3]]


def _smoke_test() -> None:
    """Reconstruct and evaluate a small clip twice, first with compilation."""
    from getagrip.batch.job import Job, reconstruct_one
    from getagrip.clip import read_clip, read_masks, write_clip
    from getagrip.compiling import COMPILATION_MESSAGE, compile_once
    from getagrip.fitting.options import Options
    from getagrip.metrics.evaluate import evaluate_result
    from getagrip.synthetic.scene import synthesise
    from getagrip.synthetic.scene_options import SceneOptions

    with TemporaryDirectory() as folder:
        clip = Path(folder) / "clip"
        write_clip(*synthesise("can", 0, SceneOptions(frames=6)), clip)
        read_masks(read_clip(clip))
        for n, words in enumerate(("compiling included", "compiled")):
            began = perf_counter()
            compile_once(lambda: print(f"ok       {COMPILATION_MESSAGE}", flush=True))
            out = Path(folder) / f"result-{n}"
            outcome = reconstruct_one(Job("can", clip, out, Options(), overwrite=False))
            if outcome.state != "done":
                raise RuntimeError(outcome.message)
            add = evaluate_result(out, clip).metrics["add_sym_mm"]
            print(f"ok       a can in 6 frames, {add:.1f} mm off, {perf_counter() - began:.1f} s, {words}")
