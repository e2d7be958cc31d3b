"""Stable grasps of labelled motion (Eq. 2): finding them, their best hinge, the paper's study."""
