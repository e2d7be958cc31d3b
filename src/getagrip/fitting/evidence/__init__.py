"""Kinds of evidence, a file each: what pixels say about a clip, and the terms that it gives (``clip.modality``)."""
