"""Hand-object stable grasp reconstruction: the pose of a rigid object held in a hand, over a video clip.

::

    import getagrip

    clip, masks = getagrip.synthesise("mug")         # or read_clip(folder) and read_masks(clip)
    result = getagrip.reconstruct(clip, masks)
    print(getagrip.evaluate(result, clip, masks).metrics)

The public names and their modules are listed in ``__init__.pyi``. Each is loaded when it is first used, so that
``import getagrip`` takes no time.
"""

from getagrip.io import processes

if processes.is_program():  # before anything else takes time
    processes.exit_on_interrupt()

import sys
from types import ModuleType

import lazy_loader

from getagrip import moved as moved  # finds modules under their former names

__version__ = "0.1.0"
_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _Package(ModuleType):
    """The root package, in which a module never takes the place of a public name: ``reconstruct`` is the function."""

    def __setattr__(self, name: str, value: object) -> None:
        if name not in self.__all__ or not isinstance(value, ModuleType):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> object:
    """Load a public name. Raises ``AttributeError`` with the names most like it, or with the module's import."""
    if name in __all__ or name.startswith("__"):
        return _public(name)
    import difflib
    import importlib.util

    if not name.startswith("_") and importlib.util.find_spec(f"{__name__}.{name}") is not None:
        advice = f"it is a module: import {__name__}.{name}"
    else:
        alike = difflib.get_close_matches(name, __all__) or __all__
        advice = f"choose from {', '.join(alike)}"
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; {advice}")
