"""Neural-network Q-learning for an industrial three-wheeled vehicle, proved in contact physics."""

__version__ = "0.1.0"
