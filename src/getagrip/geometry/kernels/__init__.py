"""Compiled loops of the fit: silhouettes and contours, nearest points, depth."""
