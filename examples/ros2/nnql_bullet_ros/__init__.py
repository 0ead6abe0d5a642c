"""Drives a vehicle by a policy of nnql-bullet in ROS 2."""
