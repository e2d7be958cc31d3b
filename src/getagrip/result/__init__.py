"""Results: the object in the hand in every frame, and the folder that holds it."""

from getagrip.result.data import Axis, Candidates, FrameKind, Reconstruction, Status
from getagrip.result.folder import FILES, is_result, software, write_result
from getagrip.result.reading import read_record, read_result
from getagrip.result.segments import SegmentResult

__all__ = [
    "FILES",
    "Axis",
    "Candidates",
    "FrameKind",
    "Reconstruction",
    "SegmentResult",
    "Status",
    "is_result",
    "read_record",
    "read_result",
    "software",
    "write_result",
]
