"""The method: from a clip to the poses of the object in the hand."""
