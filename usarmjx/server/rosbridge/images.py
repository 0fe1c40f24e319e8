"""What robots' cameras see, as CompressedImage."""

import base64
import json
from collections.abc import Mapping, Sequence

from usarmjx.base.errors import UsageError
from usarmjx.server.pictures.render_thread import ViewImages
from usarmjx.server.pictures.views import CompositeView, robot_view
from usarmjx.server.protocol.images import format_number, jpeg
from usarmjx.server.rosbridge.definitions import RosVersion
from usarmjx.server.rosbridge.topics import RosTopic

FORMAT = format_number("good")


def image_view(topic: RosTopic, size: tuple[int, int]) -> CompositeView:
    """Return what the camera of a topic sees, of that width and height."""
    if topic.robot is None:
        raise UsageError(f"{topic.name} shows no camera")
    return robot_view(topic.robot, topic.robot.cameras[topic.camera].mount.name, size)


def picture_texts(
    asked: Sequence[tuple[RosTopic, RosVersion]],
    views: Mapping[RosTopic, CompositeView],
    time: float,
    pictures: ViewImages,
) -> list[str]:
    """Return what is told of topics with pictures; may run in another thread.

    Args:
        asked: Topics, and whose names are spoken.
        views: What each topic shows.
        time: When that was [s].
        pictures: The pictures.
    """
    jpegs = {view: base64.b64encode(jpeg(FORMAT, pictures[view])).decode() for view in set(views.values())}
    texts: list[str] = []
    for topic, version in asked:
        header = version.header(time, topic.name.strip("/").removesuffix("/compressed"))
        message = {"header": header, "format": "jpeg", "data": jpegs[views[topic]]}
        texts.append(json.dumps({"op": "publish", "topic": topic.name, "msg": message}))
    return texts
