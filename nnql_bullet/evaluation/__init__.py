"""Evaluates policies: success over worlds, differences between simulators, ablations, causes of failures."""
