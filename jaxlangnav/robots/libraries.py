"""Libraries of the extra ``robot``, loaded when they are needed, and what to install if they lack.

Rendering off screen goes through EGL, which is the system's, not pip's.
"""

import importlib
import importlib.util
import os
import sys
from typing import Any

from jaxlangnav.viz.style import MissingExtraError, require

NO_WHEELS = ("apriltag_msgs", "tf2_msgs", "vision_msgs")
"""Packages of messages that a ROS 2 installation has and PyPI has not."""


def ros(module: str) -> Any:
    """Load a module of ROS 2, such as "nav_msgs.msg", or raise a ``MissingExtraError``."""
    package = module.split(".")[0]
    if package in NO_WHEELS and importlib.util.find_spec(package) is None:
        raise MissingExtraError(
            f"{package} is not installed, and no wheel: source a ROS 2 installation that has it "
            f"(apt-get install ros-$ROS_DISTRO-{package.replace('_', '-')})"
        )
    require(package, extra="ros2")
    return importlib.import_module(module)


def ros_message(name: str) -> Any:
    """Load the class of a message of ROS 2, such as "nav_msgs/msg/Odometry"."""
    package, _, kind = name.partition("/msg/")
    return getattr(ros(f"{package}.msg"), kind)


SYSTEM_PACKAGES = "libegl1 libegl-mesa0 libgl1-mesa-dri"
"""Debian and Ubuntu packages that rendering off screen needs."""
_BACKEND = "MUJOCO_GL"  # environment variable: how to render; read as MuJoCo is imported


class MissingSystemLibraryError(ValueError):
    """Rendering off screen does not work here; says what to install."""


def mujoco() -> Any:
    """Load MuJoCo, set up to render off screen; a missing extra or library raises."""
    if "mujoco" in sys.modules and os.environ.get(_BACKEND) is None:
        raise MissingSystemLibraryError(
            f"mujoco was imported before jaxlangnav.robots could ask it to render off screen: set "
            f"{_BACKEND}=egl in the environment"
        )
    os.environ.setdefault(_BACKEND, "egl")
    try:
        return require("mujoco", extra="robot")
    except (ImportError, AttributeError, OSError) as error:
        raise _no_rendering(error) from error


def renderer(model: Any, height: int, width: int) -> Any:
    """Open a ``mujoco.Renderer``, sizes in pixels, or raise a ``MissingSystemLibraryError``."""
    try:
        return mujoco().Renderer(model, height, width)
    except Exception as error:  # PyOpenGL raises whatever it meets first
        raise _no_rendering(error) from error


def opencv() -> Any:
    """Load OpenCV, the module ``cv2``, or raise a ``MissingExtraError``."""
    return require("cv2", extra="robot")


def apriltags() -> Any:
    """Load the detector of AprilTags, or raise a ``MissingExtraError``."""
    return require("pupil_apriltags", extra="robot")


def check_libraries() -> None:
    """Make sure that everything for physics, cameras and tags is there, before anything is run.

    Raises:
        MissingExtraError: a Python library is not installed.
        MissingSystemLibraryError: rendering off screen does not work.
    """
    opencv()
    apriltags()
    model = mujoco().MjModel.from_xml_string("<mujoco/>")
    renderer(model, 8, 8).close()


def _no_rendering(error: BaseException) -> MissingSystemLibraryError:
    """Say what rendering off screen needs."""
    why = " ".join(str(error).split()) or type(error).__name__
    return MissingSystemLibraryError(
        f"rendering off screen needs EGL, which does not work here ({why[:120]}): "
        f"apt-get install {SYSTEM_PACKAGES}"
    )
