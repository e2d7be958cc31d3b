"""A local web page on which people mark stable grasps and label frames.

``tasks`` says what to look through; ``footage`` and ``video`` show its frames. What people enter are
``marks`` (where a grasp is) and ``keyframes`` (joints and polygons on some of its frames): ``versions`` keeps every
change that was ever made of them, ``store`` puts them into a file. ``labelling`` makes ``labels`` of a grasp's key
frames and has ``drafting`` fill in the frames between, in the ``background``: ``clicked_hands`` and ``steadied_hands``
fit hands, ``propagated_masks`` makes masks (a step of it is in ``carried_masks``, by ``object_motion``, ``colour_cut``
and ``seen_ground``; two of a frame are joined in ``merged_masks``, and ``fine_border`` draws their border), whose key
frames ``strokes`` completes; ``frame_wanted`` says where to draw next. ``found_hands`` are what a tracker has found
before (``finding_hands``). ``labelled`` writes the files of a clip. ``project`` joins all this and ``server`` gives it
to the page; ``export`` and ``agreement`` read what is kept.
"""
