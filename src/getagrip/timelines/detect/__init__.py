"""Detection of a clip's segments in its masks, without 3D labels of the object.

``find_segments`` takes these steps:

- ``image_motion``: the motion of the object's contour in the image beyond that of the camera;
- ``grasp_evidence``: wherever the contour moves, fits of the object to the hand, each extended to the frames around it;
- ``semi_markov``: from both, the cost of each state in every window of frames, the division of least cost, and its
  margin over the next best;
- ``stable_grasps_in``: Eq. 2 on the reconstructed contacts, which divides grasped segments into stable grasps and rest.
"""
