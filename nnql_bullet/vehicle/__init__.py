"""The vehicle: its description in URDF and TOML, its limits, and the controller of its wheels."""
