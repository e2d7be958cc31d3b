"""Former names of the modules that plug-ins and the documentation's examples import, kept for one release."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType

NEW_NAMES = {
    "clip.naming": "clip.match_frames",
    "datasets.dataset": "readers.datasets.dataset",
    "datasets.dexycb.reader": "readers.datasets.dexycb.dexycb_clips",
    "datasets.synthetic.scene": "synthetic.scene",
    "datasets.synthetic.scene_options": "synthetic.scene_options",
    "evaluation": "metrics.evaluate",
    "evaluation.comparison": "metrics.evaluate.comparison",
    "evaluation.metric": "metrics.evaluate.metric",
    "evaluation.tables": "metrics.evaluate.results",
    "finding": "result.findings",
    "fitting.initial_poses": "fitting.solver.initial_poses",
    "fitting.solve": "fitting.solver.solve",
    "grasps.approximation": "stable_grasps.axis",
    "grasps.definition": "stable_grasps.definition",
    "grasps.stable": "stable_grasps.find",
    "grasps.study": "stable_grasps.study",
    "hands.fit": "hands.fit_joints",
    "hands.trackers.estimates": "readers.trackers.estimates",
    "hands.trackers.tracker": "readers.trackers.tracker",
    "io.videos": "io.images",
    "pictures.report": "report.pictures.result_picture",
    "segmentation.found": "timelines.detect.detect_segments",
    "timelines.reconstruct": "reconstruct",
}
"""Old and new names within the package, for modules that pages import."""


class _FormerModules:
    """A finder of former names, after all other finders."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return the spec of a former module or its package; None for other names."""
        former = name.removeprefix("getagrip.")
        if name == former or not any(f"{one}.".startswith(f"{former}.") for one in NEW_NAMES):
            return None
        return ModuleSpec(name, self, is_package=True)  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> None:
        """Leave the module's creation to Python."""

    def exec_module(self, module: ModuleType) -> None:
        """Make the module look up its names in the new one, with a ``DeprecationWarning``."""
        new = NEW_NAMES.get(module.__name__.removeprefix("getagrip."))

        def look_up(name: str) -> object:
            if new is None or name.startswith("__"):
                raise AttributeError(f"module {module.__name__!r} has no attribute {name!r}")
            text = f"{module.__name__} is now getagrip.{new}; its former name goes with the next release"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            return getattr(import_module(f"getagrip.{new}"), name)

        module.__dict__["__getattr__"] = look_up


sys.meta_path.append(_FormerModules())
