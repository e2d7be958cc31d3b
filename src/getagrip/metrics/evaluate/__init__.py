"""Evaluation of results against ground truth (docs/metrics.md).

- ``results``: result folders of this package, means over clips, printed tables;
- ``external``: poses of other systems, and a mesh per frame from systems without a CAD model.
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
