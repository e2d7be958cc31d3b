"""Methods x metrics on a dataset: one command from clips to the paper's tables.

``sources`` says which clips, ``settings`` what is tried on each of them, ``trials`` does it, ``statistics`` draws means
and their intervals from the scores, and ``tables`` and ``plots`` show them; ``command`` is the whole on one page.
"""
