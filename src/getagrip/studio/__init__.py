"""A local web page on which people mark stable grasps and label frames.

``server`` answers the requests of ``page`` by methods of ``project``: tasks and their frames, marks, and labels of one
grasp (``labelling``, whose slow work runs in ``jobs``). ``store`` holds marks (where a grasp is) and labels (joints and
polygons on key frames), with their history, and writes their files. ``masks`` propagates labels from key frames to all
frames, ``hands`` detects and lifts hands. ``detect_grasps`` finds the grasps in a draft, and ``next_step`` advises on
what to label next, and what a result looks like.
"""
