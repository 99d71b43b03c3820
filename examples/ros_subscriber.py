# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Print forces and whether they are valid: python ros_subscriber.py [COUNT].

Start a sensor first: ros2 launch mixtac_bringup sensor.launch.py device:=virtual
"""

import sys

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node

from mixtac_msgs.msg import ForceQuality


class Listener(Node):
    """Prints one of 250 windows; 500 come in a second."""

    def __init__(self) -> None:
        super().__init__('listener')
        self.count, self.force = 0, 0.0
        self.create_subscription(WrenchStamped, '/mixtac/force', self.on_force, 10)
        self.create_subscription(ForceQuality, '/mixtac/force_quality', self.on_quality, 10)

    def on_force(self, message: WrenchStamped) -> None:
        """Keep the latest force; one that is not valid is not published."""
        self.force = message.wrench.force.z

    def on_quality(self, message: ForceQuality) -> None:
        """Print the force, or why it is not valid."""
        self.count += 1
        if self.count % 250 == 0:
            print(f'{self.force:.3f} N' if message.valid else f'not valid: {message.reason}')


rclpy.init()
listener = Listener()
while listener.count < int((*sys.argv, 2500)[1]):
    rclpy.spin_once(listener)
