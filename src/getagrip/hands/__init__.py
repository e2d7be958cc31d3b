"""Hand models: ``generic`` (ours), ``mano`` (the user's file), ``umetrack`` (HOT3D). All end in ``PosedHand``."""
