"""What a vehicle makes of its scans: point clouds, a grid map, where it is, and where actions lead."""
