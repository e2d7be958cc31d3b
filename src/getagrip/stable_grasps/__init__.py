"""Stable grasps of labelled motion (Eq. 2): their detection, their best hinge, the paper's study."""
