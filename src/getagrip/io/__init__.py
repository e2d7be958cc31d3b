"""Untrusted files and arrays, read within limits; files written whole or not at all."""
