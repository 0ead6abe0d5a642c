"""Processes a vehicle's scans: point clouds, a grid map, localization, and prediction of actions."""
