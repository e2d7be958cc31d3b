"""What each command takes and does, a file for each."""
