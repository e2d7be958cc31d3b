"""Results in other programs' formats."""

from getagrip.export.formats import FORMATS, export
from getagrip.export.scene import Scene

__all__ = ["FORMATS", "Scene", "export"]
