"""Draws recordings as videos and pictures: cameras, renderers of solid bodies, ground and light, text."""
