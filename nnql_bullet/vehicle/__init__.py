"""The vehicle: what its URDF and TOML say, and how a commanded turn becomes wheel speeds."""
