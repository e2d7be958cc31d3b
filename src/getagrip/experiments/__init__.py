"""Methods x metrics on a dataset: one command from clips to the paper's tables.

``sources`` says which clips, ``settings`` what is tried on each of them, ``trials`` does it, ``comparison`` makes means
and differences of the scores, ``statistics`` their intervals, and ``tables`` and ``plots`` show them.
"""
