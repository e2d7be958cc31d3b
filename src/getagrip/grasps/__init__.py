"""Stable grasps of labelled motion: finding them, their best hinge, the study of them."""
