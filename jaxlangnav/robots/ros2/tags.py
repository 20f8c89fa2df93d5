"""Tags that ``apriltag_ros`` finds, as looks: bookkeeping, without ROS.

Places come as transforms on ``/tf``, among all others of the robot. That there is nothing in a
picture is told by the list of what was found in it alone, which goes by another topic.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from jaxlangnav.robots.robot import Detection
from jaxlangnav.robots.ros2.conversions import detections_of_tags, seconds_of

StampedDetections = tuple[float, list[Detection]]
"""When it was taken, seconds of the robot's clock, and what was seen from the base frame."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TagSetup:
    """What tags mean on one robot, and what of them is used."""

    types: Mapping[str, int]
    """Frame of a tag, such as "tag36h11:7", to an index into the navigator's ``type_names``."""
    range: float
    """Metres beyond which a thing is left out: what the belief is told of the detector."""
    field_of_view: float
    """Radians, full angle about straight ahead, likewise."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """x, y, heading of the camera in the base frame, metres and radians."""
    depth: float = 0.0
    """Metres from a tag to the middle of the thing behind it."""


def read_tag_types(texts: Sequence[str], type_names: Sequence[str]) -> dict[str, int]:
    """Read what tags are on.

    Args:
        texts: "tag36h11:7=hydrant": the tag's frame and the name of a type.
        type_names: the navigator's.

    Returns:
        Frames to indices of types.

    Raises:
        ValueError: no such text, no such type, or no tag at all; one line.
    """
    types = {}
    for text in texts:
        frame, _, name = text.rpartition("=")
        if not frame or name not in type_names:
            raise ValueError(
                f"tag {text!r} is none: give a frame and a type such as tag36h11:7=hydrant; types "
                f"are {', '.join(type_names)}"
            )
        types[frame] = type_names.index(name)
    if not types:
        raise ValueError("no tag is known: say what they are on by --tags tag36h11:7=hydrant")
    return types


class TagLooks:
    """Makes looks out of two topics."""

    def __init__(self, setup: TagSetup) -> None:
        """Begin with nothing."""
        self._setup = setup
        self._picture: tuple[str, float] | None = None

    def of_transforms(self, message: Any) -> StampedDetections | None:
        """Read a tf2_msgs/TFMessage; None where its transforms are of other things than tags.

        Raises:
            ValueError: a tag is nowhere; one line.
        """
        setup = self._setup
        ours = [one for one in message.transforms if self._is_tag(one)]
        if not ours:
            return None
        found = detections_of_tags(ours, setup.types, mount=setup.mount, depth=setup.depth)
        used = [
            one
            for one in found
            if one.range <= setup.range and abs(one.bearing) <= 0.5 * setup.field_of_view
        ]
        return seconds_of(ours[0].header.stamp), used

    def of_found(self, message: Any) -> StampedDetections | None:
        """Read an apriltag_msgs/AprilTagDetectionArray.

        A look at nothing; None where tags were found: their places come as transforms.
        """
        stamp = seconds_of(message.header.stamp)
        self._picture = message.header.frame_id, stamp
        return None if len(message.detections) else (stamp, [])

    def _is_tag(self, one: Any) -> bool:
        """Tell whether a transform is of a tag, one of no type that is known too."""
        header = one.header
        picture = header.frame_id, seconds_of(header.stamp)
        return one.child_frame_id in self._setup.types or picture == self._picture
