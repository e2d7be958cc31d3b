"""Hands from 2D: clicked joints, or the landmarks of networks, lifted to a hand in every frame."""
