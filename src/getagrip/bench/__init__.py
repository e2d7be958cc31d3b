"""Methods and ablations on a dataset, as tables with intervals; the paper's dataset tables.

``sources`` finds the clips, ``ablations`` defines variants, ``inputs`` changes clips, ``job`` runs trials.
``comparison`` computes means and differences of scores with intervals; ``tables`` and ``figures`` present them.
"""
