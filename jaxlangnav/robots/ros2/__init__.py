"""The navigator as a ROS 2 node: words, odometry and detections in, goals and status out.

``conversions`` and ``inbox`` know nothing of ROS and are tested without it; ``robot`` is the door
``Robot`` over any ``Bus``; ``node`` and ``simulation`` are what needs ``jaxlangnav[ros2]``.
"""
