"""Training: the loop, and what it leaves to go on from."""
