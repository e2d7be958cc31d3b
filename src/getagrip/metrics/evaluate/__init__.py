"""Results against ground truth (docs/metrics.md).

- ``results``: a result folder of ours;
- ``meshes``: a mesh for each frame, as systems give them that know no CAD;
- ``tables``: means over clips, and what is printed.
"""

from getagrip.metrics.evaluate.external import evaluate_meshes
from getagrip.metrics.evaluate.results import (
    Evaluation,
    clip_of,
    contact_tables,
    evaluate,
    evaluate_result,
    read_result_and_clip,
    read_result_clip_masks,
    results_table,
    summary,
)

__all__ = [
    "Evaluation",
    "clip_of",
    "contact_tables",
    "evaluate",
    "evaluate_meshes",
    "evaluate_result",
    "read_result_and_clip",
    "read_result_clip_masks",
    "results_table",
    "summary",
]
