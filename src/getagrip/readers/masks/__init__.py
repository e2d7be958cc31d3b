"""Masks in other programs' files: images, arrays, polygons and run lengths."""
