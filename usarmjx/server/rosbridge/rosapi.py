"""The services of rosapi, as web clients of ROS call them: topics, nodes, types and parameters."""

import json
from collections.abc import Callable, Mapping
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import BUILTIN, RosMessage, RosVersion
from usarmjx.server.rosbridge.republisher import REPUBLISH
from usarmjx.server.rosbridge.robot_description import urdf
from usarmjx.server.rosbridge.services import REMOVE, SPAWN
from usarmjx.server.rosbridge.topics import WorldTopics

NODE = "/usarmjx"
"""Name of the one node."""
DESCRIPTION = "/robot_description"
MOST_PARAMETERS = 256
"""Most parameters that clients may add."""
LONGEST_VALUE = 65_536
"""Longest value of a parameter [characters of JSON]."""
EXAMPLES = {"string": "", "bool": "false", "float32": "0.0", "float64": "0.0"}
_FURTHER_TYPES = {
    SPAWN: "usarmjx_msgs/Spawn",
    REMOVE: "usarmjx_msgs/Remove",
    REPUBLISH: "tf2_web_republisher/RepublishTFs",
}
"""Types of the services that are not rosapi's."""

ServiceFunction = Callable[[Mapping[str, Any]], RosMessage]


class Parameters:
    """The parameters of a served world: those of its robots, and those that clients set.

    Args:
        topics: The topics, which know the robots and their names.
    """

    def __init__(self, topics: WorldTopics) -> None:
        self._topics = topics
        self._set: dict[str, Any] = {"/use_sim_time": True}

    def names(self) -> list[str]:
        """Return the names of all parameters."""
        robots = [f"/{name}{DESCRIPTION}" for name in self._topics.robots()]
        return [*self._set, *([DESCRIPTION] if robots else []), *robots]

    def get(self, name: str) -> object:
        """Return a value; None if there is no such parameter.

        `robot_description` is that of the first robot, `R1/robot_description` that of R1.
        """
        full = _full(name)
        if full in self._set:
            return self._set[full]
        robots = self._topics.robots()
        owner = full.removesuffix(DESCRIPTION).strip("/") if full.endswith(DESCRIPTION) else None
        if owner is None or not robots:
            return None
        robot = robots.get(owner) if owner else next(iter(robots.values()))
        return None if robot is None else urdf(robot.spec)

    def set(self, name: str, text: str) -> None:
        """Set a parameter to a value in JSON.

        Raises:
            UsageError: It is no JSON, too long, or there are too many parameters.
        """
        full = _full(name)
        if len(text) > LONGEST_VALUE:
            raise UsageError(f"{clip(full)} has {len(text)} characters; at most {LONGEST_VALUE} are kept")
        if full not in self._set and len(self._set) >= MOST_PARAMETERS:
            raise UsageError(f"there are {MOST_PARAMETERS} parameters already")
        try:
            self._set[full] = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise UsageError(f"the value of {clip(full)} is no JSON: {error}") from error

    def delete(self, name: str) -> None:
        """Delete a parameter that a client may have set."""
        self._set.pop(_full(name), None)


def _full(name: str) -> str:
    # ROS 2's rosapi puts a node in front: `/usarmjx:use_sim_time`.
    return "/" + name.rpartition(":")[2].strip("/")


class RosApi:
    """The services of rosapi.

    Args:
        topics: The topics.
        version: Version of the types' names.
        now: Returns the simulated time [s].
    """

    def __init__(self, topics: WorldTopics, version: RosVersion, now: Callable[[], float]) -> None:
        self._topics, self._version, self._now = topics, version, now
        self._parameters = Parameters(topics)
        self._services: dict[str, ServiceFunction] = {
            **self._of_topics(),
            **self._of_nodes(),
            **self._of_parameters(),
        }

    def names(self) -> list[str]:
        """Return the names of all services."""
        return [*self._services, *_FURTHER_TYPES]

    def call(self, service: str, args: Mapping[str, Any]) -> RosMessage:
        """Return the values of a service's answer.

        Raises:
            UsageError: There is no such service, or an argument is not valid.
        """
        found = self._services.get(service)
        if found is None:
            raise UsageError(f"no service {clip(service)}; known: {', '.join(self.names())}")
        return found(args)

    def _of_topics(self) -> dict[str, ServiceFunction]:
        return {
            "/rosapi/topics": self._list,
            "/rosapi/topics_and_raw_types": self._list_raw,
            "/rosapi/topics_for_type": self._of_type,
            "/rosapi/topic_type": self._type,
            "/rosapi/publishers": lambda args: {"publishers": self._nodes_of(args, drives=False)},
            "/rosapi/subscribers": lambda args: {"subscribers": self._nodes_of(args, drives=True)},
            "/rosapi/message_details": self._details,
            "/rosapi/action_servers": lambda args: {"action_servers": ["/tf2_web_republisher"]},
            "/rosapi/get_time": self._time,
        }

    def _of_nodes(self) -> dict[str, ServiceFunction]:
        return {
            "/rosapi/nodes": lambda args: {"nodes": [NODE]},
            "/rosapi/node_details": self._node,
            "/rosapi/services": lambda args: {"services": self.names()},
            "/rosapi/service_type": lambda args: {"type": self._service_type(_text(args, "service"))},
            "/rosapi/service_node": lambda args: {
                "node": NODE if _text(args, "service") in self.names() else ""
            },
            "/rosapi/service_providers": lambda args: {
                "providers": [NODE] if self._services_for(_text(args, "service")) else []
            },
            "/rosapi/services_for_type": lambda args: {"services": self._services_for(_text(args, "type"))},
        }

    def _of_parameters(self) -> dict[str, ServiceFunction]:
        return {
            "/rosapi/get_param": self._get_parameter,
            "/rosapi/set_param": self._set_parameter,
            "/rosapi/has_param": lambda args: {
                "exists": self._parameters.get(_text(args, "name")) is not None
            },
            "/rosapi/delete_param": self._delete_parameter,
            "/rosapi/search_param": self._search,
            "/rosapi/get_param_names": lambda args: {"names": self._parameters.names()},
        }

    # Topics

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

    def _nodes_of(self, args: Mapping[str, Any], *, drives: bool) -> list[str]:
        topic = self._topics.all().get(_text(args, "topic"))
        return [NODE] if topic is not None and topic.is_listened_to == drives else []

    def _details(self, args: Mapping[str, Any]) -> RosMessage:
        """Return the fields of a type and of the types in it; none for an unknown one."""
        asked = _text(args, "type")
        waiting, definitions = [asked.replace("/msg/", "/")], list[RosMessage]()
        seen = set(waiting)
        while waiting:
            name = waiting.pop(0)
            try:
                fields = self._version.fields(name)
            except KeyError:
                raise UsageError(f"no type {clip(asked)} is known here") from None
            definitions.append(_definition(name, fields, long="/msg/" in asked))
            inner = [base for base in (kind.partition("[")[0] for kind in fields.values()) if "/" in base]
            waiting += [base for base in dict.fromkeys(inner) if base not in seen]
            seen.update(inner)
        return {"typedefs": definitions}

    def _time(self, args: Mapping[str, Any]) -> RosMessage:
        del args
        # Clients such as roslibpy's `get_time` read ROS 1's names of either server.
        return {"time": RosVersion.ROS2.stamp(self._now()) | RosVersion.ROS1.stamp(self._now())}

    # Nodes and services

    def _node(self, args: Mapping[str, Any]) -> RosMessage:
        if _text(args, "node") not in (NODE, NODE[1:]):
            return {"subscribing": [], "publishing": [], "services": []}
        topics = self._topics.all().values()
        return {
            "subscribing": [topic.name for topic in topics if topic.is_listened_to],
            "publishing": [topic.name for topic in topics if not topic.is_listened_to],
            "services": self.names(),
        }

    def _service_type(self, service: str) -> str:
        if service in _FURTHER_TYPES:
            return _FURTHER_TYPES[service]
        if service not in self._services:
            return ""
        words = service.rpartition("/")[2].split("_")
        name = "".join(word.capitalize() for word in words)
        return f"rosapi_msgs/srv/{name}" if self._version == RosVersion.ROS2 else f"rosapi/{name}"

    def _services_for(self, kind: str) -> list[str]:
        return [name for name in self.names() if self._service_type(name) == kind]

    # Parameters

    def _get_parameter(self, args: Mapping[str, Any]) -> RosMessage:
        value = self._parameters.get(_text(args, "name"))
        default = str(args.get("default") or args.get("default_value") or "null")
        return {"value": default if value is None else json.dumps(value), "successful": value is not None}

    def _set_parameter(self, args: Mapping[str, Any]) -> RosMessage:
        self._parameters.set(_text(args, "name"), _text(args, "value"))
        return {"successful": True}

    def _delete_parameter(self, args: Mapping[str, Any]) -> RosMessage:
        self._parameters.delete(_text(args, "name"))
        return {"successful": True}

    def _search(self, args: Mapping[str, Any]) -> RosMessage:
        name = _text(args, "name")
        return {"global_name": _full(name) if self._parameters.get(name) is not None else ""}


def _text(args: Mapping[str, Any], key: str) -> str:
    value = args.get(key, "")
    if not isinstance(value, str):
        raise UsageError(f"{key} is {clip(str(value))}, expected a text")
    return value


def _definition(name: str, fields: Mapping[str, str], *, long: bool) -> RosMessage:
    """Return the fields of a type as rosapi's TypeDef: -1 is no list, 0 one of any length."""
    bases, lengths = list[str](), list[int]()
    for kind in fields.values():
        base, bracket, length = kind.partition("[")
        bases.append(base)
        lengths.append(-1 if not bracket else int(length[:-1] or 0))
    spelled = [base.replace("/", "/msg/") if long else base for base in bases]
    spelled = [
        BUILTIN.get(base, text) if not long else text for base, text in zip(bases, spelled, strict=True)
    ]
    return {
        "type": name.replace("/", "/msg/") if long else name,
        "fieldnames": list(fields),
        "fieldtypes": spelled,
        "fieldarraylen": lengths,
        "examples": [
            "[]" if length >= 0 else "{}" if "/" in base else EXAMPLES.get(base, "0")
            for base, length in zip(bases, lengths, strict=True)
        ],
        "constnames": [],
        "constvalues": [],
    }
