"""Libraries of the extra ``ros2``, loaded when they are needed."""

import importlib
import importlib.util
from typing import Any

from jaxlangnav.viz.style import MissingExtraError, require

NO_WHEELS = ("apriltag_msgs", "tf2_msgs", "vision_msgs")
"""Packages of messages that a ROS 2 installation has and PyPI has not."""


def ros(module: str) -> Any:
    """Load a module of ROS 2.

    Args:
        module: such as "rclpy" or "nav_msgs.msg".

    Returns:
        The module.

    Raises:
        MissingExtraError: it is not installed.
    """
    package = module.split(".")[0]
    if package in NO_WHEELS and importlib.util.find_spec(package) is None:
        raise MissingExtraError(
            f"{package} is not installed, and no wheel: source a ROS 2 installation that has it "
            f"(apt-get install ros-$ROS_DISTRO-{package.replace('_', '-')})"
        )
    require(package, extra="ros2")
    return importlib.import_module(module)
