"""ROS 2 node: the fixes of an Isodyn session as sensor_msgs/NavSatFix and geometry_msgs/PoseWithCovarianceStamped.

ISODYN_URL=http://... ISODYN_KEY=isk_... ros2 run ... isodyn_node --ros-args -p session:=ses_...
"""

import threading

import isodyn_client as isodyn
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from isodyn_client.bridges import Georeference, SessionFeed, nav_sat_fix, pose_with_covariance
from rclpy.node import Node
from rosidl_runtime_py.set_message import set_message_fields
from sensor_msgs.msg import NavSatFix


class IsodynNode(Node):
    """Follows the session named by the parameter ``session`` and publishes every fix once."""

    def __init__(self) -> None:
        super().__init__("isodyn")
        self.session_id = self.declare_parameter("session", "").value
        self.on_earth = self.create_publisher(NavSatFix, "fix", 10)
        self.on_level = self.create_publisher(PoseWithCovarianceStamped, "pose", 10)

    def follow(self) -> None:
        """Publish until the session ends; runs in a thread of its own, for it waits for the network."""
        with isodyn.Client() as client:
            feed = SessionFeed(client, self.session_id, on_trouble=lambda e: self.get_logger().warning(str(e)))
            place = None
            for told in (one for batch in feed.batches() for one in batch):
                self._publish(self.on_level, PoseWithCovarianceStamped(), pose_with_covariance(told.fix))
                if told.anchor is not None:
                    place = place or Georeference(told.anchor)
                    self._publish(self.on_earth, NavSatFix(), nav_sat_fix(place.place(told.fix)))

    def _publish(self, publisher, message, fields) -> None:
        set_message_fields(message, fields)
        publisher.publish(message)


def main() -> None:
    """Run the node until it is stopped or the session ends."""
    rclpy.init()
    node = IsodynNode()
    threading.Thread(target=node.follow, daemon=True).start()
    rclpy.spin(node)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
