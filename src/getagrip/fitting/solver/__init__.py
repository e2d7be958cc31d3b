"""The solver: starting poses, coarse-to-fine search, Levenberg-Marquardt and Adam."""
