"""Reproduce the paper's tables by running other commands in turn: one file for each dataset."""
