"""Clips with impossible troubles, in every method: ``python -m benchmarks.adversarial N``.

Each case is drawn from its number: a synthetic clip, up to three troubles, a method. It runs in a process of its own,
within limits of time and memory. It has to end in a result that is finite, reads back and is not called converged
where it does not meet the masks, or in an error of one line. ``--from K`` begins at another number, ``--only NAME`` has
one method. What fails is printed with its number; the exit status is 1 if anything does.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from getagrip.checks import LEAST_IOU
from getagrip.clip import Clip, Masks
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.errors import GetagripError
from getagrip.experiments.wrong_inputs import MISTAKES, Mistake
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.reconstruct import reconstruct
from getagrip.geometry.mesh import Mesh
from getagrip.result import Reconstruction, read_result, write_result

CATEGORIES = ("mug", "can", "plate", "scissors", "box")
SECONDS, MEGABYTES = 120.0, 3000
"""Limits of a case; small clips take a second or two."""
SCENE = SceneOptions(size=(160, 120), focal=150.0)


def behind(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The hand behind the camera in some frames."""
    T = clip.hand.T_cam_hand.copy()
    T[rng.random(len(T)) < 0.5, 2, 3] *= -1.0
    return replace(clip, hand=replace(clip.hand, T_cam_hand=T)), masks


def through(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The hand so near that the camera's plane cuts hand and object."""
    T = clip.hand.T_cam_hand.copy()
    T[:, 2, 3] = rng.uniform(-0.05, 0.1)
    return replace(clip, hand=replace(clip.hand, T_cam_hand=T)), masks


def giant_focal(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """A focal length of a million pixels, or of one."""
    K = clip.K.copy()
    K[:, [0, 1], [0, 1]] = rng.choice([1e6, 1.0])
    return replace(clip, K=K), masks


def contradicting(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The mask here in one frame and there in the next."""
    shown = masks.object.copy()
    shown[::2] = np.roll(shown[::2], shown.shape[2] // 3, axis=2)
    return clip, Masks(shown, masks.ignore & ~shown)


def leaving(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The object leaves the image after the first two frames, or but for a column of pixels."""
    shown = masks.object.copy()
    shown[2:, :, : rng.choice([shown.shape[2], shown.shape[2] - 1])] = False
    shown[2:, :, -1:] |= masks.object[2:].any(axis=2, keepdims=True) & bool(rng.random() < 0.5)
    return clip, Masks(shown, masks.ignore & ~shown)


def all_ignored(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Nothing known but the object's pixels."""
    return clip, Masks(masks.object, ~masks.object)


def whole_image(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """The object covers every pixel."""
    return clip, Masks(np.ones_like(masks.object), np.zeros_like(masks.ignore))


def soup(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Triangles at random where the mesh was: no surface, edges of one face or of many."""
    low, high = clip.mesh.vertices.min(axis=0), clip.mesh.vertices.max(axis=0)
    vertices = rng.uniform(low, high, (60, 3))
    faces = np.array([rng.choice(60, 3, replace=False) for _ in range(200)])
    return replace(clip, mesh=Mesh(vertices, faces)), masks


def inside_out(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Half of the faces wound the other way."""
    faces = clip.mesh.faces.copy()
    turned = rng.random(len(faces)) < 0.5
    faces[turned] = faces[turned, ::-1]
    return replace(clip, mesh=Mesh(clip.mesh.vertices, faces)), masks


def one_triangle(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """One triangle for a mesh."""
    return replace(clip, mesh=Mesh(clip.mesh.vertices[clip.mesh.faces[0]], np.array([[0, 1, 2]]))), masks


def large_mesh(clip: Clip, masks: Masks, rng: np.random.Generator) -> tuple[Clip, Masks]:
    """Every face cut into sixteen, three times over: hundreds of thousands of them."""
    mesh = clip.mesh
    while len(mesh.faces) < 200_000:
        mesh = quartered(mesh)
    return replace(clip, mesh=mesh), masks


def quartered(mesh: Mesh) -> Mesh:
    """Each face as four."""
    a, b, c = mesh.faces.T
    V = len(mesh.vertices)
    pairs = np.sort(np.concatenate([np.stack(ends, axis=1) for ends in ((a, b), (b, c), (c, a))]), axis=1)
    edges, of = np.unique(pairs, axis=0, return_inverse=True)
    ab, bc, ca = V + of.reshape(3, -1)
    corners = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    faces = np.concatenate([np.stack(ids, axis=1) for ids in corners])
    return Mesh(np.concatenate([mesh.vertices, mesh.vertices[edges].mean(axis=1)]), faces)


TROUBLES: dict[str, Mistake] = {
    **MISTAKES,
    "behind the camera": behind,
    "through the camera": through,
    "giant focal length": giant_focal,
    "contradicting masks": contradicting,
    "leaving the image": leaving,
    "all ignored": all_ignored,
    "whole image": whole_image,
    "soup": soup,
    "inside out": inside_out,
    "one triangle": one_triangle,
    "large mesh": large_mesh,
}


@dataclass(frozen=True)
class Case:
    """What is tried."""

    number: int
    category: str
    frames: int
    scale: str
    troubles: tuple[str, ...]
    method: str

    @staticmethod
    def draw(number: int, only: str | None = None) -> Case:
        """The case of a number."""
        rng = np.random.default_rng(number)
        troubles = tuple(sorted(rng.choice([*TROUBLES], size=rng.choice([1, 1, 2, 3]), replace=False).tolist()))
        category, scale = str(rng.choice(CATEGORIES)), str(rng.choice(["known", "free"]))
        frames = int(rng.choice([2, 3, 6, 6, 6, 60]))
        return Case(number, category, frames, scale, troubles, only or str(rng.choice([*METHODS])))

    def run(self) -> Reconstruction:
        """The result. Raises ``GetagripError``."""
        options = replace(SCENE, frames=self.frames, scale="free" if self.scale == "free" else "known")
        clip, masks = synthesise(self.category, self.number % 7, options)
        clip = replace(clip, truth=None)
        for name in self.troubles:
            clip, masks = TROUBLES[name](clip, masks, np.random.default_rng(self.number))
        slow = METHODS[self.method].slow
        return reconstruct(clip, masks, Options(method=self.method, inits=2 if slow else 6, frames=8, seed=self.number))


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
    if result.status.startswith("converged") and not np.nanmean(result.iou) >= LEAST_IOU:
        found.append(f"{result.status} with an IOU of {np.nanmean(result.iou):.2f}")
    with tempfile.TemporaryDirectory() as folder:
        read_result(write_result(result, Path(folder) / "result"))
    return found


def attempt(case: Case) -> tuple[bool, str]:
    """Whether a case ends as it may, and how it ends."""
    try:
        result = case.run()
        wrong = faults(result)
        return not wrong, "; ".join(wrong) or f"IOU {np.nanmean(result.iou):.2f}, {result.status}"
    except GetagripError as error:
        return "\n" not in str(error), f"refused: {error}"
    except Exception:  # whatever it is, it is a fault
        return False, traceback.format_exc()


def limited(case: Case, seconds: float = SECONDS, megabytes: int = MEGABYTES) -> tuple[bool, str]:
    """The same in a process of its own."""
    fork = multiprocessing.get_context("fork")
    ours, theirs = fork.Pipe()
    process = fork.Process(target=_child, args=(case, megabytes, theirs))
    process.start()
    theirs.close()
    try:
        if not ours.poll(seconds):
            return False, f"not done after {seconds:g} s"
        done: tuple[bool, str] = ours.recv()
        return done
    except EOFError:
        process.join()
        return False, f"the process died ({process.exitcode})"
    finally:
        process.kill()
        process.join()


def _child(case: Case, megabytes: int, answer: Connection) -> None:
    import resource

    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + megabytes * 2**20, resource.RLIM_INFINITY))
    answer.send(attempt(case))


def main(arguments: list[str], trial: Callable[[Case], tuple[bool, str]] = limited) -> int:
    """Try some cases, and print those that fail; 1 if any does."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.adversarial", description=__doc__)
    parser.add_argument("cases", type=int)
    parser.add_argument("--from", type=int, default=0, dest="first")
    parser.add_argument("--only", choices=[*METHODS], default=None)
    wanted = parser.parse_args(arguments)
    failed = slowest = 0.0
    for number in range(wanted.first, wanted.first + wanted.cases):
        case = Case.draw(number, wanted.only)
        began = time.perf_counter()
        fine, how = trial(case)
        took = time.perf_counter() - began
        slowest = max(slowest, took)
        failed += not fine
        print(f"{'ok  ' if fine else 'FAIL'} {case} {took:.1f} s: {how}", flush=True)
    print(f"{wanted.cases} cases, {failed:.0f} failed, the slowest took {slowest:.1f} s")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
