"""Hand models, all ending in ``PosedHand``; ``trackers`` reads the files of hand estimators."""
