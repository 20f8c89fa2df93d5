"""Libraries of the extra ``ros2``, loaded when they are needed."""

import importlib
from typing import Any

from jaxlangnav.viz.style import require


def ros(module: str) -> Any:
    """Load a module of ROS 2.

    Args:
        module: such as "rclpy" or "nav_msgs.msg".

    Returns:
        The module.

    Raises:
        MissingExtraError: it is not installed.
    """
    require(module.split(".")[0], extra="ros2")
    return importlib.import_module(module)
