"""Methods and ablations on a dataset, as tables with intervals; the paper's dataset tables.

``sources`` says which clips, ``settings`` what is tried on each of them, ``trials`` does it, ``statistics`` draws means
and their intervals from the scores, and ``tables`` and ``plots`` show them; ``command`` is the whole on one page.
"""
