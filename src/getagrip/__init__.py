"""Hand-object stable grasp reconstruction."""
