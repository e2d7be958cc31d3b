"""Benchmarks from the pixels of images with known poses: each stage of a draft beside the truth."""
