"""HOT3D."""
