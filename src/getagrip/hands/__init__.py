"""Hand models, all ending in ``PosedHand``, and hands fitted to joints in 3D or in images."""
