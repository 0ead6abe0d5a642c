"""The numbers that the paper states, each with its section.

Source: "A Reinforcement Learning Method of Obstacle Avoidance for Industrial Mobile Vehicles in Unknown Environments
Using Neural Network". Options elsewhere decide what the paper leaves open; `presets.PRESETS` lists their values.
"""

from math import radians

SECTORS = 8  # II.A
SECTOR_ANGLE = radians(45.0)  # II.A
SENSOR_RANGE = 10.0  # IV [m]

TURNS = (0.0, radians(30.0), radians(60.0), radians(-30.0), radians(-60.0))  # II.B: straight, left 30, 60, right 30, 60

REWARD_SAFE_TO_NON_SAFE = -0.2  # II.C
REWARD_CLOSER = -0.4  # II.C, non-safe to non-safe
REWARD_AWAY = 0.4  # II.C, non-safe to non-safe
REWARD_WINNING = 1.0  # II.C
REWARD_FAILURE = -0.6  # II.C

HIDDEN_UNITS = 6  # IV

ARENA_SIDE = 100.0  # IV [m]
START = (20.0, 20.0)  # IV [m]
TARGET = (90.0, 90.0)  # IV [m]
SPEED = 2.0  # IV [m/s]

LEARNING_RATE = 0.1  # IV, alpha of eq. (2)
DISCOUNT = 0.15  # IV, gamma of eq. (2)
TEMPERATURE_MAX = 0.8  # IV, T of eq. (3)
TEMPERATURE_MIN = 0.01  # IV, T of eq. (3)

EPISODES = 1000  # IV.A
STEPS_PER_EPISODE = 500  # IV.A
