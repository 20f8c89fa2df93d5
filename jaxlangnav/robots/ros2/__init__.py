"""The navigator as a ROS 2 node: words, odometry and detections in, goals and status out.

``conversions``, ``inbox`` and ``headway`` know nothing of ROS and are tested without it; ``robot``
is the door ``Robot`` over any ``Bus``; ``node`` and ``serve`` are what needs ``jaxlangnav[ros2]``.
"""
