"""Synthetic clips with ground truth."""
