"""Timelines: one motion of the object, from the table into the hands and back, for a clip with segments."""
