"""Scores of which every metric in the tables of benchmarks has the same value."""

from __future__ import annotations

from getagrip.bench.grasp_job import GraspVariantScore


def score(variant: str, value: float, failed: bool = False) -> GraspVariantScore:
    """A score of which every metric in the tables has the same value."""
    kinds = ("sca", "truth_sca", "sca_add", "sca_add_sym", "sca_iou_80", "sca_iou_60")
    keys = ["iou", "add_success", "add_sym_success", *(f"{kind}_object_10mm" for kind in kinds)]
    return GraspVariantScore(variant, {} if failed else dict.fromkeys(keys, value), 1.0, 2.0, False, "stopped", failed)
