"""From a clip with segments to one motion of the object from table to hand and back."""
