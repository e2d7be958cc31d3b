"""Benchmarks on whole sequences: finding their grasps, and reconstructing them as timelines."""
