"""Inputs of a benchmark, changed on purpose: noise, estimated masks, simulated evidence, mistakes."""
