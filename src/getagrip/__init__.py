"""Hand-object stable grasp reconstruction.

A clip in, a reconstruction out::

    from getagrip import Options, read_clip, read_masks, write_result
    from getagrip.fitting.reconstruct import reconstruct

    clip = read_clip("clips/pour-01")
    result = reconstruct(clip, read_masks(clip), Options())

The names here are loaded when they are first used, so that ``import getagrip`` takes no time.
"""

from __future__ import annotations

from importlib import import_module, metadata
from typing import TYPE_CHECKING, Any

from getagrip.errors import GetagripError, InputError, UsageError

if TYPE_CHECKING:
    from getagrip.clip import Clip, HandTrack, Masks, Truth, read_clip, read_masks, write_clip
    from getagrip.fitting.options import Options
    from getagrip.geometry.mesh import Mesh, read_mesh, write_mesh
    from getagrip.result import Axis, Candidates, Reconstruction, read_result, write_result

__version__ = metadata.version("getagrip")
__all__ = [
    "Axis",
    "Candidates",
    "Clip",
    "GetagripError",
    "HandTrack",
    "InputError",
    "Masks",
    "Mesh",
    "Options",
    "Reconstruction",
    "Truth",
    "UsageError",
    "read_clip",
    "read_masks",
    "read_mesh",
    "read_result",
    "write_clip",
    "write_mesh",
    "write_result",
]

_HOMES = {
    "getagrip.clip": ("Clip", "HandTrack", "Masks", "Truth", "read_clip", "read_masks", "write_clip"),
    "getagrip.geometry.mesh": ("Mesh", "read_mesh", "write_mesh"),
    "getagrip.fitting.reconstruct": ("Options",),
    "getagrip.result": ("Axis", "Candidates", "Reconstruction", "read_result", "write_result"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(module), name)
    raise AttributeError(f"module 'getagrip' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
