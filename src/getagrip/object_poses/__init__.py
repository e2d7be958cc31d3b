"""Poses of the object in every frame from other systems: files of them, and their place in a clip."""
