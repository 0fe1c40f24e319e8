"""Services of a served world: what topics there are, and robots that come and go."""

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.base.errors import UsageError
from usarmjx.base.rotations import mat_from_quat
from usarmjx.base.transforms import angles_from_mat
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.server.protocol.commands import Init
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.topics import WorldTopics

SPAWN, REMOVE = "/simulator/spawn", "/simulator/remove"
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
"""What a robot may be called that appears by a service: so its topics and frames are called, too."""


class TopicServices:
    """The services that tell of topics, as rosapi has them.

    Args:
        topics: The topics.
        version: Whose names types have.
        now: Returns the simulated time [s].
    """

    def __init__(self, topics: WorldTopics, version: RosVersion, now: Callable[[], float]) -> None:
        self._topics, self._version, self._now = topics, version, now
        self._services: dict[str, Callable[[Mapping[str, Any]], RosMessage]] = {
            "/rosapi/topics": self._list,
            "/rosapi/topics_and_raw_types": self._list_raw,
            "/rosapi/topics_for_type": self._of_type,
            "/rosapi/topic_type": self._type,
            "/rosapi/services": lambda args: {"services": self.names()},
            "/rosapi/get_time": lambda args: {"time": self._version.stamp(self._now())},
        }

    def names(self) -> list[str]:
        """Return the names of all services."""
        return [*self._services, SPAWN, REMOVE]

    def call(self, service: str, args: Mapping[str, Any]) -> RosMessage:
        """Return the values that a service answers.

        Raises:
            UsageError: There is no such service.
        """
        found = self._services.get(service)
        if found is None:
            raise UsageError(f"no service {clip(service)}; there is: {', '.join(self.names())}")
        return found(args)

    def _list(self, args: Mapping[str, Any]) -> RosMessage:
        del args
        topics = self._topics.all().values()
        return {
            "topics": [topic.name for topic in topics],
            "types": [self._version.type_name(topic.type) for topic in topics],
        }

    def _list_raw(self, args: Mapping[str, Any]) -> RosMessage:
        texts = [self._version.text(topic.type) for topic in self._topics.all().values()]
        return {**self._list(args), "typedefs_full_text": texts}

    def _of_type(self, args: Mapping[str, Any]) -> RosMessage:
        wanted = str(args.get("type", "")).replace("/msg/", "/")
        return {"topics": [topic.name for topic in self._topics.all().values() if topic.type == wanted]}

    def _type(self, args: Mapping[str, Any]) -> RosMessage:
        topic = self._topics.all().get(str(args.get("topic", "")))
        return {"type": self._version.type_name(topic.type) if topic else ""}


def read_spawn(args: Mapping[str, Any]) -> tuple[Init, RobotSpec]:
    """Return the INIT and the class of a robot that is to appear.

    Args:
        args: `class`; and, if wanted, `name`, and `pose`, a geometry_msgs/Pose, or `start`, the tag of a
            start pose.

    Raises:
        UsageError: Something is wrong with them.
    """
    kind, name = str(args.get("class", "")), args.get("name") or ""
    if kind not in ROBOTS:
        raise UsageError(f"unknown robot {clip(kind)}; known: {', '.join(ROBOTS.names())}")
    if name and not (isinstance(name, str) and NAME.fullmatch(name)):
        raise UsageError(f"a name has up to 40 letters, digits and _, not {clip(str(name))}")
    spec, pose = ROBOTS.get(kind), args.get("pose")
    start = str(args.get("start") or "")
    if pose is None:
        return Init(spec.name, name, None, None, start), spec
    if start:
        raise UsageError("give either pose or start")
    place = _numbers(pose, "position", "xyz")
    x, y, z, w = _numbers(pose, "orientation", "xyzw")
    length = float(np.linalg.norm((w, x, y, z)))
    if length < 1e-6:
        raise UsageError("an orientation of length 0 is none")
    with numpy_backend():
        angles = angles_from_mat(np.asarray(mat_from_quat(np.array((w, x, y, z)) / length)))
    return Init(spec.name, name, flip_wire_vector(place), flip_wire_angles(angles.tolist())), spec


def _numbers(pose: Any, part: str, axes: str) -> list[float]:  # noqa: ANN401 - JSON
    values = pose.get(part) if isinstance(pose, dict) else None
    if not isinstance(values, dict):
        raise UsageError(f"a pose has {part} with {', '.join(axes)}")
    numbers = [values.get(axis, 0.0) for axis in axes]
    if not all(type(one) in (int, float) and abs(one) < 1e6 for one in numbers):
        raise UsageError(f"{part} of a pose has numbers {', '.join(axes)}")
    return [float(one) for one in numbers]
