"""The transport of ROS 2's messages: tasks of a middleware, and the names and qualities that it uses."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from usarmjx.server.rosbridge.definitions import RosVersion

NODE, NAMESPACE, ENCLAVE = "usarmjx", "/", "/"
"""Name of the node, its namespace and its enclave."""

TakeMessage: TypeAlias = Callable[[bytes], None]
"""Takes the bytes of a message; is called in another thread."""
TakeRequest: TypeAlias = "Callable[[bytes, Reply], None]"
"""Takes the bytes of a request, and what sends its reply; is called in another thread."""
Reply: TypeAlias = Callable[[bytes], None]
"""Sends the bytes of a reply; may be called in any thread."""


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
