"""Methods and ablations on a dataset, as tables with intervals; the paper's dataset tables.

``sources`` says which clips, ``variants`` what is tried on each of them, in which settings of the ``ablations``;
``trials`` does it, ``comparison`` makes means and differences of the scores with their intervals, and ``tables`` and
``plots`` show them.
"""
