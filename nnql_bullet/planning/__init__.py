"""Ways to goals beyond sight: a plan through the whole world, and the point on it that a vehicle drives at."""
