"""The navigator as a ROS 2 node: utterances, odometry and detections in, goals and status out.

``conversions`` and ``inbox`` do not depend on ROS and are tested without it; ``robot`` implements
``Robot`` over any ``Bus``; ``node`` and ``simulation`` need ``jaxlangnav[ros2]``.
"""
