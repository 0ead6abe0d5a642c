"""Recordings as moving pictures: instants, cameras, renderers of solid things, the ground, what is written over it."""
