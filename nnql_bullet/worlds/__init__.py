"""Worlds: what stands where, how it is drawn from a seed, and whether it can be crossed."""
