"""Lazy loading of the libraries of the extra ``robot``; errors name what to install.

Offscreen rendering needs EGL, a system library that pip cannot install.
"""

import importlib
import importlib.util
import os
import sys
from typing import Any

from jaxlangnav.viz.style import MissingExtraError, require

ROS_ONLY_PACKAGES = ("apriltag_msgs", "tf2_msgs", "vision_msgs")
"""Message packages that are part of ROS 2 installations, but not on PyPI."""


def load_ros(module: str) -> Any:
    """Load a module of ROS 2, such as "nav_msgs.msg", or raise a ``MissingExtraError``."""
    package = module.split(".")[0]
    if package in ROS_ONLY_PACKAGES and importlib.util.find_spec(package) is None:
        raise MissingExtraError(
            f"{package} is not installed, and no wheel: source a ROS 2 installation that has it "
            f"(apt-get install ros-$ROS_DISTRO-{package.replace('_', '-')})"
        )
    require(package, extra="ros2")
    return importlib.import_module(module)


def ros_class(name: str) -> Any:
    """Load a ROS 2 message class, such as "nav_msgs/msg/Odometry"."""
    package, _, class_name = name.partition("/msg/")
    return getattr(load_ros(f"{package}.msg"), class_name)


SYSTEM_PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri"
"""Debian and Ubuntu packages that offscreen rendering needs."""
_BACKEND = "MUJOCO_GL"  # environment variable of the rendering backend; read on import of MuJoCo


def mujoco() -> Any:
    """Load MuJoCo for offscreen rendering; a missing extra or library raises."""
    if "mujoco" in sys.modules and os.environ.get(_BACKEND) is None:
        raise MissingExtraError(
            f"mujoco was imported before jaxlangnav.robots could ask it to render off screen: set "
            f"{_BACKEND}=egl in the environment"
        )
    os.environ.setdefault(_BACKEND, "egl")
    try:
        return require("mujoco", extra="robot")
    except (ImportError, AttributeError, OSError) as error:
        raise _rendering_error(error) from error


def renderer(model: Any, height: int, width: int) -> Any:
    """Open a ``mujoco.Renderer``, sizes in pixels, or raise a ``MissingExtraError``."""
    try:
        return mujoco().Renderer(model, height, width)
    except Exception as error:  # PyOpenGL raises whatever it meets first
        raise _rendering_error(error) from error


def opencv() -> Any:
    """Load OpenCV, the module ``cv2``, or raise a ``MissingExtraError``."""
    return require("cv2", extra="robot")


def check_libraries() -> None:
    """Check that the libraries for physics, cameras and tags are installed and work.

    Raises:
        MissingExtraError: a Python library is not installed, or offscreen rendering does not work.
    """
    opencv()
    require("pupil_apriltags", extra="robot")
    renderer(mujoco().MjModel.from_xml_string("<mujoco/>"), 8, 8).close()


def _rendering_error(error: BaseException) -> MissingExtraError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return MissingExtraError(
        f"rendering off screen needs EGL, which does not work here ({reason[:120]}): "
        f"apt-get install {SYSTEM_PACKAGES}"
    )
