"""Scores of a reconstruction: masks, pose and contact. They are independent of the minimised energy."""
