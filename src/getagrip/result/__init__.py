"""Results: the object in the hand in every frame, and the folder that holds it."""

from getagrip.result.read import read_result, read_result_record
from getagrip.result.result import Axis, Candidates, FrameKind, Reconstruction, SegmentResult, Status
from getagrip.result.write import RESULT_FILES, is_result, software_versions, write_result

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
