"""Readers of datasets, and synthetic clips: each gives clips with ground truth where it has it."""
