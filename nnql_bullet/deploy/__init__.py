"""Policies on a real vehicle: scans and odometry in, wheel speeds out, without torch, Numba or a simulator.

from nnql_bullet.deploy import Controller, Odometry, Scan

controller = Controller("paper", shield=True)
command = controller.step(scan, odometry, target=(20.0, 3.0), now=clock())
drive_wheels(command.left, command.right)
"""

from nnql_bullet.deploy.controller import Command, Controller
from nnql_bullet.deploy.scans import Scan
from nnql_bullet.deploy.watch import Odometry, WatchOptions

__all__ = ["Command", "Controller", "Odometry", "Scan", "WatchOptions"]
