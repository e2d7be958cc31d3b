"""Rigid motions, cameras, meshes, and what a camera sees of them."""
