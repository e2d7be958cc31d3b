"""Synthetic clips with ground truth: a generic hand that grasps and moves a procedural object."""
