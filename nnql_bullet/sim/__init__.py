"""Simulators: what moves the vehicle, behind one seam."""
