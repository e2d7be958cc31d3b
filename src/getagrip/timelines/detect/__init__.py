"""Stable grasps found in masks: when the object lies still, and when a hand holds it, by the evidence of our own fits.

No label of the object in 3D is read. ``found.find_segments`` takes these steps:

- ``image_motion``: how far the object's contour moves in the image beyond what the camera's motion explains;
- ``hinge_fits``: wherever it moves, fits of the object to the hand, each tried in the frames around its own, too;
- ``semi_markov``: from both, what each state costs in every window of frames, the segmentation that costs least, and
  how much more the next best would cost;
- ``found.stable_in``: Eq. 2 on the reconstructed contacts, which says where in a grasped segment the grasp is stable.
"""
