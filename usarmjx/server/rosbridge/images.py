"""Pictures of robots' cameras: Image and CompressedImage."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.server.pictures.views import CompositeView, ViewImages, robot_view
from usarmjx.server.protocol.images import format_number, jpeg
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.encodings import BridgeFrame, Compression, publication
from usarmjx.server.rosbridge.motion import optical_name
from usarmjx.server.rosbridge.topics import RAW_IMAGE, RosTopic

FORMAT = format_number("good")


class PictureRequest(NamedTuple):
    """A requested picture message.

    Attributes:
        topic: Topic of its camera, compressed or raw.
        version: Version of its field names.
        compression: Its encoding.
    """

    topic: RosTopic
    version: RosVersion
    compression: Compression


def image_view(topic: RosTopic, size: tuple[int, int]) -> CompositeView:
    """Return the view of a topic's camera, of that width and height."""
    if topic.robot is None:
        raise UsageError(f"{topic.name} shows no camera")
    return robot_view(topic.robot, topic.robot.cameras[topic.camera].mount.name, size)


def picture_messages(
    asked: Sequence[PictureRequest],
    views: Mapping[RosTopic, CompositeView],
    time: float,
    pictures: ViewImages,
) -> list[BridgeFrame]:
    """Return the messages of topics with pictures; may run in another thread.

    Args:
        asked: The requests.
        views: View of each topic.
        time: Simulated time of the views [s].
        pictures: The pictures.
    """
    made: dict[PictureRequest, BridgeFrame] = {}
    for one in asked:
        if one not in made:
            topic, version, compression = one
            message = picture_message(topic, version, time, pictures[views[topic]])
            made[one] = publication(topic.name, topic.type, message, version, compression, time)
    return [made[one] for one in asked]


def picture_message(topic: RosTopic, version: RosVersion, time: float, pixels: np.ndarray) -> RosMessage:
    """Return the message of a topic with a picture (height, width, 3), taken at a simulated time [s]."""
    header = version.header(time, optical_name(topic.name.strip("/").rpartition("/")[0]))
    return {"header": header, **_image(topic.type, pixels)}


def _image(kind: str, pixels: np.ndarray) -> RosMessage:
    if kind != RAW_IMAGE:
        return {"format": "jpeg", "data": jpeg(FORMAT, pixels)}
    height, width = pixels.shape[:2]
    size = {"height": height, "width": width}
    return {
        **size,
        "encoding": "rgb8",
        "is_bigendian": 0,
        "step": 3 * width,
        "data": np.ascontiguousarray(pixels, np.uint8).tobytes(),
    }
