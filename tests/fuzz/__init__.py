"""Fuzzing of every reader (``make fuzz MINUTES=n``): see SECURITY.md."""
