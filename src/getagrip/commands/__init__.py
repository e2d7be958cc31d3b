"""The commands, one file each: options and body."""
