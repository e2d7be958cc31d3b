"""Compiled loops of the fit: silhouettes, contours, nearest points. ``reference`` is their specification in numpy."""
