"""Compiled loops of the fit: silhouettes, contours, nearest points."""
