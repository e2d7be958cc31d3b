"""Results: the object in the hand in every frame, and the folder that holds it."""

from getagrip.result.data import Axis, Candidates, FrameKind, Reconstruction, Status
from getagrip.result.folder import RESULT_FILES, is_result, software_versions, write_result
from getagrip.result.reading import read_result, read_result_record
from getagrip.result.segments import SegmentResult

__all__ = [
    "RESULT_FILES",
    "Axis",
    "Candidates",
    "FrameKind",
    "Reconstruction",
    "SegmentResult",
    "Status",
    "is_result",
    "read_result",
    "read_result_record",
    "software_versions",
    "write_result",
]
