"""A local web page on which people mark where stable grasps start and end.

``tasks`` says what to look through, ``footage`` and ``video`` show its frames, ``store`` keeps every change of a mark
that was ever made, ``project`` joins them and ``server`` gives them to the page; ``export`` and ``agreement`` read what
is kept.
"""
