"""Simulators move the vehicles; they all have one interface."""
