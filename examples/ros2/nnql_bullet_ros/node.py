"""The node: LaserScan and Odometry in, Twist out; all that it decides is in `nnql_bullet.deploy`."""

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan

from nnql_bullet.deploy import Controller, WatchOptions
from nnql_bullet_ros.messages import PARAMETERS, driven, fill


class Drive(Node):
    """Drives to the last pose that came on `goal_pose`."""

    def __init__(self) -> None:
        super().__init__("nnql_bullet_drive")
        given = {name: self.declare_parameter(name, value).value for name, value in PARAMETERS.items()}
        policy, vehicle, shield, speed, rate = (given.pop(name) for name in list(PARAMETERS)[:5])
        watch = WatchOptions(**given)
        self._controller = Controller(policy, vehicle or None, shield, speed=speed or None, watch=watch)
        self._scan = self._odometry = self._target = None
        self._reason = ""
        self.create_subscription(LaserScan, "scan", self._on_scan, qos_profile_sensor_data)
        self.create_subscription(Odometry, "odom", self._on_odometry, qos_profile_sensor_data)
        self.create_subscription(PoseStamped, "goal_pose", self._on_goal, 1)
        self._twists = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_timer(1 / rate, self._on_time)

    def _on_scan(self, message: LaserScan) -> None:
        self._scan = message

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry = message

    def _on_goal(self, message: PoseStamped) -> None:
        wanted = self._controller.watch.odometry_frame
        if message.header.frame_id != wanted:
            self.get_logger().error(f"goal_pose is in the frame '{message.header.frame_id}', not in '{wanted}'")
            self._target = None
            return
        self._target = message.pose.position.x, message.pose.position.y

    def _on_time(self) -> None:
        now = 1e-9 * self.get_clock().now().nanoseconds
        command = driven(self._controller, self._scan, self._odometry, self._target, now)
        self._twists.publish(fill(Twist(), command))
        if command.reason != self._reason:
            self._reason = command.reason
            self.get_logger().info(f"stops: {command.reason}" if command.reason else "drives")


def main() -> None:
    """Runs the node until it is interrupted."""
    rclpy.init()
    node = Drive()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
