"""ROS 2 over Zenoh: keys, attachments and liveliness tokens as `rmw_zenoh_cpp` writes them."""

# The library's own types leave many results out.
# pyright: reportUnknownMemberType=false

import json
import os
import struct
import time
from collections.abc import Callable
from hashlib import blake2b
from typing import Any

import zenoh
from zenoh.ext import CacheConfig, MissDetectionConfig, declare_advanced_publisher

from usarmjx.base.errors import UsageError, quoted
from usarmjx.server.ros2.transport import (
    DEFAULT,
    ENCLAVE,
    NAMESPACE,
    NODE,
    Qos,
    Reply,
    TakeMessage,
    TakeRequest,
    dds_type,
    message_hash,
    service_hash,
)

ADMIN_SPACE = "@ros2_lv"
"""First part of the keys of liveliness tokens."""
NODE_TOKEN, PUBLISHER, SUBSCRIPTION, SERVICE = "NN", "MP", "MS", "SS"
"""Kinds of entities in tokens."""
DEFAULT_DEPTH = 42
"""Depth that a token leaves out: that of rmw_zenoh's default quality."""
BEST_EFFORT, TRANSIENT_LOCAL = "2", "1"
HEARTBEAT = 0.5
"""Interval of the heartbeats by which late readers of a latched topic notice that they miss a message [s]."""
GID_BYTES = 16
ROUTER_PORT = 7447
CONFIG_VARIABLE = "ZENOH_SESSION_CONFIG_URI"
OWN_CONFIG = {
    "mode": "peer",
    "connect/endpoints": [f"tcp/localhost:{ROUTER_PORT}"],
    "connect/timeout_ms": 0,
    "connect/exit_on_failure": False,
    "listen/endpoints": ["tcp/localhost:0"],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    # Publishers that keep messages for late readers are refused without it.
    "timestamping/enabled": True,
}
"""Configuration unless `CONFIG_VARIABLE` names another: as rmw_zenoh's, by a router on this machine."""


def mangled(name: str) -> str:
    """Return a name as one part of a key."""
    return name.replace("/", "%")


def qos_text(qos: Qos) -> str:
    """Return a quality as tokens have it: only what differs from rmw_zenoh's default."""
    reliability = "" if qos.is_reliable else BEST_EFFORT
    durability = TRANSIENT_LOCAL if qos.is_latched else ""
    depth = "" if qos.depth == DEFAULT_DEPTH else str(qos.depth)
    return f"{reliability}:{durability}:,{depth}:,:,:,,"


def attachment(sequence: int, stamp: int, gid: bytes) -> bytes:
    """Return what goes with a message: its number, its time [ns] and its writer's identity."""
    return struct.pack("<qqB", sequence, stamp, len(gid)) + gid


def request_identity(data: bytes) -> tuple[int, bytes]:
    """Return the number of a request and its client's identity, of what goes with it; zeros without them."""
    if len(data) != struct.calcsize("<qqB") + GID_BYTES:
        return 0, bytes(GID_BYTES)
    return struct.unpack_from("<q", data)[0], data[-GID_BYTES:]


class ZenohPublisher:
    """A publisher of one topic.

    Args:
        publisher: The publisher.
        gid: Its identity.
        close: Forgets it.
    """

    def __init__(self, publisher: Any, gid: bytes, close: Callable[[], None]) -> None:  # noqa: ANN401
        self._publisher, self._gid, self.close, self._sequence = publisher, gid, close, 0

    def write(self, data: bytes) -> bool:
        """Send a message's CDR."""
        self._sequence += 1
        self._publisher.put(data, attachment=attachment(self._sequence, time.time_ns(), self._gid))
        return True

    def has_readers(self) -> bool:
        """Return whether anybody reads it; a publisher that keeps messages for late ones does not know."""
        status = getattr(self._publisher, "matching_status", None)
        return status is None or status.matching


class ZenohEndpoint:
    """A subscription or a service.

    Args:
        close: Forgets it.
    """

    def __init__(self, close: Callable[[], None]) -> None:
        self.close = close


class ZenohTransport:
    """A session in one domain.

    Args:
        domain: Its number.
        endpoints: Endpoints to connect to in place of the router on this machine.
        listen: Endpoints to listen at in place of a free port of the loopback.

    Raises:
        UsageError: The configuration is not valid, or the session cannot be opened.
    """

    def __init__(self, domain: int, endpoints: tuple[str, ...] = (), listen: tuple[str, ...] = ()) -> None:
        self._domain, self._ids = domain, 0
        try:
            self._session = zenoh.open(_config(endpoints, listen))
        except zenoh.ZError as error:
            raise UsageError(f"cannot open a Zenoh session: {quoted(error)}") from error
        self._node = self._token(NODE_TOKEN, "0")

    def publisher(self, topic: str, kind: str, qos: Qos) -> ZenohPublisher:
        """Return a publisher of a topic with messages of a type, by its short name."""
        key, token = self._names(PUBLISHER, topic, dds_type(kind), message_hash(kind), qos)
        reliability = zenoh.Reliability.RELIABLE if qos.is_reliable else zenoh.Reliability.BEST_EFFORT
        # Dropping, not blocking: a slow subscriber must not stop the thread of all topics.
        how: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.DROP, "reliability": reliability}
        if qos.is_latched:
            made = declare_advanced_publisher(
                self._session,
                key,
                cache=CacheConfig(max_samples=qos.depth),
                publisher_detection=True,
                sample_miss_detection=MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT),
                **how,
            )
        else:
            made = self._session.declare_publisher(key, **how)
        return ZenohPublisher(made, _gid(token), self._keep(made, token))

    def subscription(self, topic: str, kind: str, qos: Qos, take: TakeMessage) -> ZenohEndpoint:
        """Subscribe to a topic with messages of a type, by its short name."""
        key, token = self._names(SUBSCRIPTION, topic, dds_type(kind), message_hash(kind), qos)
        made = self._session.declare_subscriber(key, lambda sample: take(sample.payload.to_bytes()))
        return ZenohEndpoint(self._keep(made, token))

    def service(self, name: str, kind: str, take: TakeRequest) -> ZenohEndpoint:
        """Offer a service of a type such as `std_srvs/srv/Empty`."""
        key, token = self._names(SERVICE, name, dds_type(kind), service_hash(kind), DEFAULT)

        def answer(query: zenoh.Query) -> None:
            if query.payload is not None:
                take(query.payload.to_bytes(), _reply_to(query, key))

        # Clients of rmw_zenoh ask complete queryables only.
        made = self._session.declare_queryable(key, answer, complete=True)
        return ZenohEndpoint(self._keep(made, token))

    def announce(self) -> None:
        """Do nothing: each endpoint has a token of its own."""

    def close(self) -> None:
        """Leave the domain."""
        self._session.close()

    def _names(self, entity: str, name: str, kind: str, type_hash: str, qos: Qos) -> tuple[str, str]:
        """Return the key of an endpoint's data, and that of its token."""
        self._ids += 1
        key = f"{self._domain}/{name.strip('/')}/{kind}/{type_hash}"
        about = "/".join((mangled(name), kind, type_hash, qos_text(qos)))
        return key, self._token_key(entity, str(self._ids), about)

    def _token_key(self, entity: str, number: str, about: str = "") -> str:
        zid = str(self._session.zid())
        parts = [ADMIN_SPACE, str(self._domain), zid, "0", number, entity]
        parts += [mangled(ENCLAVE), mangled(NAMESPACE), NODE]
        return "/".join([*parts, about] if about else parts)

    def _token(self, entity: str, number: str) -> Any:  # noqa: ANN401 - the library has a type of it
        return self._session.liveliness().declare_token(self._token_key(entity, number))

    def _keep(self, made: Any, token: str) -> Callable[[], None]:  # noqa: ANN401 - some declaration
        """Announce an endpoint; return what forgets it."""
        announced = self._session.liveliness().declare_token(token)

        def close() -> None:
            announced.undeclare()
            made.undeclare()

        return close


def _config(endpoints: tuple[str, ...], listen: tuple[str, ...]) -> zenoh.Config:
    # The variable of rmw_zenoh: a user's file is used whole, as there.
    file = os.environ.get(CONFIG_VARIABLE, "")
    if file:
        return zenoh.Config.from_file(file)
    config = zenoh.Config()
    # A copy: tests and several sessions have endpoints of their own.
    own = dict(OWN_CONFIG)
    if endpoints:
        own["connect/endpoints"] = list(endpoints)
    if listen:
        own["listen/endpoints"] = list(listen)
    for key, value in own.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _gid(token: str) -> bytes:
    """Return an identity that follows from an endpoint's token; rmw_zenoh takes another hash for its own."""
    return blake2b(token.encode(), digest_size=GID_BYTES).digest()


def _reply_to(query: zenoh.Query, key: str) -> Reply:
    """Return what replies to a query: with the number and the client of its request."""
    request = query.attachment.to_bytes() if query.attachment is not None else b""
    sequence, client = request_identity(request)

    def reply(data: bytes) -> None:
        query.reply(key, data, attachment=attachment(sequence, time.time_ns(), client))
        # A query ends when it is dropped: garbage collection may take long.
        query.drop()

    return reply
