"""The transport of ROS 2's messages: tasks of a middleware; names, qualities and type hashes that it uses.

A hash is the SHA-256 of a type's description in JSON, with the descriptions of all types in it. A service's
description has its request, its response and an event of both.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from typing import Any, Protocol, TypeAlias

from usarmjx.server.rosbridge.definitions import RosVersion

NODE, NAMESPACE, ENCLAVE = "usarmjx", "/", "/"
"""Name of the node, its namespace and its enclave."""
TakeMessage: TypeAlias = Callable[[bytes], None]
"""Takes the bytes of a message; is called in another thread."""
TakeRequest: TypeAlias = "Callable[[bytes, Reply], None]"
"""Takes the bytes of a request, and what sends its reply; is called in another thread."""
Reply: TypeAlias = Callable[[bytes], None]
"""Sends the bytes of a reply; may be called in any thread."""
NUMBERS = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    # ROS 2's `char` is a uint8 in its description, too.
    "char": 3,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
NESTED, BOUNDED_STRING = 1, 21
ARRAY, BOUNDED_SEQUENCE, SEQUENCE = 48, 96, 144
"""Number that a list adds to that of its items' type."""


@dataclass(frozen=True)
class Qos:
    """Quality of service of a topic, in the words of ROS 2.

    Attributes:
        depth: Messages that are kept for a slow reader.
        is_latched: Whether late readers get them, too: `transient_local`.
        is_reliable: Whether lost messages are sent again.
    """

    depth: int = 10
    is_latched: bool = False
    is_reliable: bool = True


DEFAULT, LATCHED = Qos(), Qos(depth=1, is_latched=True)
SENSOR, CLOCK = Qos(depth=5), Qos(depth=1)
"""Qualities of sensors and of the clock.

They are reliable, although ROS 2's own sensors usually are not: a reliable writer serves readers of either
kind, and one that is not serves none that asks for reliability, such as a display of RViz.
"""
COMMANDS = Qos(depth=10)
"""Quality of readers of commands: a command that is sent as soon as its writer has found them is not lost."""


class Publisher(Protocol):
    """A publisher of one topic. One thread calls all methods, that of the worker."""

    def write(self, data: bytes) -> bool:
        """Send a message's CDR; return False if it was dropped."""
        ...

    def has_readers(self) -> bool:
        """Return whether anybody reads it."""
        ...

    def close(self) -> None:
        """Leave the graph."""


class Closable(Protocol):
    """A subscription or a service."""

    def close(self) -> None:
        """Leave the graph."""


class Transport(Protocol):
    """A middleware in one domain. One thread calls all methods, that of the worker."""

    def publisher(self, topic: str, kind: str, qos: Qos) -> Publisher:
        """Return a publisher of a topic with messages of a type, by its short name."""
        ...

    def subscription(self, topic: str, kind: str, qos: Qos, take: TakeMessage) -> Closable:
        """Subscribe to a topic with messages of a type, by its short name."""
        ...

    def service(self, name: str, kind: str, take: TakeRequest) -> Closable:
        """Offer a service of a type such as `std_srvs/srv/Empty`."""
        ...

    def announce(self) -> None:
        """Tell other nodes what this node has; after each change."""

    def close(self) -> None:
        """Leave the domain."""


def dds_type(kind: str) -> str:
    """Return ROS 2's name in DDS of a type, such as `nav_msgs::msg::dds_::Odometry_`."""
    package, group, name = RosVersion.ROS2.type_name(kind).split("/")
    return f"{package}::{group}::dds_::{name}_"


@cache
def message_hash(kind: str) -> str:
    """Return the hash of a message's type, by its short name, or of a part of a service."""
    return _hash(RosVersion.ROS2.type_name(kind), RosVersion.ROS2.fields(kind), {})


@cache
def service_hash(kind: str) -> str:
    """Return the hash of a service's type, such as `std_srvs/srv/Empty`."""
    request, response, event = (f"{kind}_{part}" for part in ("Request", "Response", "Event"))
    events = {
        "info": "service_msgs/ServiceEventInfo",
        "request": f"{request}[<=1]",
        "response": f"{response}[<=1]",
    }
    fields = {"request_message": request, "response_message": response, "event_message": event}
    return _hash(kind, fields, {event: events})


def _hash(name: str, fields: Mapping[str, str], more: Mapping[str, Mapping[str, str]]) -> str:
    described: dict[str, Any] = {}
    waiting = [(name, fields)]
    while waiting:
        # In any order: the descriptions are sorted below.
        full, own = waiting.pop()
        if full in described:
            continue
        described[full] = {"type_name": full, "fields": [_field(*one) for one in own.items()]}
        for kind in own.values():
            base = kind.partition("[")[0]
            if "/" in base:
                inner = more.get(base) or RosVersion.ROS2.fields(base)
                waiting.append((RosVersion.ROS2.type_name(base), inner))
    top = described.pop(name)
    whole = {
        "type_description": top,
        # Sorted by name, as the specification of hashes (REP 2016) demands.
        "referenced_type_descriptions": [described[n] for n in sorted(described)],
    }
    # The default separators of `json.dumps`, comma and blank, are those of the specification.
    return f"RIHS01_{sha256(json.dumps(whole).encode()).hexdigest()}"


def _field(name: str, kind: str) -> dict[str, Any]:
    item, bracket, rest = kind.partition("[")
    base, _, bound = item.partition("<=")
    size = rest[:-1]
    added = 0
    if bracket:
        added = SEQUENCE if not size else BOUNDED_SEQUENCE if size.startswith("<=") else ARRAY
    number = NESTED if "/" in base else BOUNDED_STRING if bound else NUMBERS[base]
    return {
        "name": name,
        "type": {
            "type_id": added + number,
            # 0 for single values and for lists of any length.
            "capacity": int(size.removeprefix("<=") or 0),
            "string_capacity": int(bound or 0),
            "nested_type_name": RosVersion.ROS2.type_name(base) if "/" in base else "",
        },
    }
