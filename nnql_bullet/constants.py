"""Constants of nature."""

GRAVITY = 9.81
"""Acceleration of gravity [m/s2]."""
