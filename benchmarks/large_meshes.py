"""Clips with very large meshes, from their folder to a page: processor time and memory of each command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.page import table
from benchmarks.problem import make
from benchmarks.troubles import quartered
from getagrip.clip import write_clip
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.symmetry import surface_points

SOUP = 100_000


def section() -> str:
    """Measure; the section's text."""
    problem = make("mug", 0)
    mesh = problem.clip.mesh
    while len(mesh.faces) < 1_000_000:
        mesh = quartered(mesh)
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for name, large in (("closed", mesh), ("a soup of triangles", soup(problem.clip.mesh))):
            clip = replace(problem.clip, mesh=large, name=name.split()[-1])
            folder = write_clip(clip, problem.masks, Path(scratch) / clip.name)
            result = Path(scratch) / "out" / clip.name
            steps = {
                "reconstruct": ["reconstruct", str(folder), "--out", str(result.parent)],
                "evaluate": ["evaluate", str(result), "--clips", str(folder)],
                "report": ["report", str(result), "--clips", str(folder)],
                "view": ["view", str(result), "--clips", str(folder)],
            }
            for step, words in steps.items():
                seconds, megabytes = _measured(words)
                rows.append([f"{name}, {len(large.faces)} faces", step, f"{seconds:.0f}", f"{megabytes:.0f}"])
                if step == "report":
                    rows[-1].append(f"{(result / 'report.html').stat().st_size / 1e6:.1f}")
    return table(
        ["mesh", "command", "CPU s", "peak memory, MB", "page, MB"], [[*row, *[""] * (5 - len(row))] for row in rows]
    )


def soup(mesh: Mesh) -> Mesh:
    """Triangles that share nothing, strewn about the surface of a mesh."""
    middles = surface_points(mesh, SOUP)[:, None]
    corners = middles + np.random.default_rng(0).normal(scale=0.001, size=(SOUP, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * SOUP).reshape(-1, 3))


def _measured(words: list[str]) -> tuple[float, float]:
    """Processor time [s] and most memory [MB] of a command, in a process of its own; one that serves a page is told to
    end when it says that the page can be opened."""
    child = subprocess.Popen([sys.executable, "-m", "getagrip", *words], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    end = 0
    for line in child.stdout:
        if line.startswith("open http"):
            child.terminate()
            end = -signal.SIGTERM
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != end:
        raise subprocess.CalledProcessError(child.returncode, words)
    return used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6
