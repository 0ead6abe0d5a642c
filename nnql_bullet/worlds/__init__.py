"""Worlds: their obstacles, how they are drawn from a seed, and whether a vehicle can cross them."""
