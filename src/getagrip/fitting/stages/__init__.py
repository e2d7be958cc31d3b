"""Stages of the pipeline around the search: contradicting masks, the mesh, remaining frames, confidence."""
