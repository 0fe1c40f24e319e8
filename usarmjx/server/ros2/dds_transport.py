"""ROS 2 over DDS, by Cyclone DDS: names, types and qualities as `rmw_cyclonedds_cpp` writes them.

Topics of other implementations of DDS match, too; services do not: only Cyclone's ROS 2 puts the identity of
a request before its fields.

The binding would serialise messages of these classes by itself, at a hundred times the cost of
`rosbridge.encodings`, whose bytes are written instead.
"""

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, TypeAlias

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.core import (
    DDSException,
    Entity,
    GuardCondition,
    InstanceState,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.pub import Publisher as DdsPublisher
from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from usarmjx.base.errors import UsageError, quoted
from usarmjx.server.ros2.transport import (
    DEFAULT,
    ENCLAVE,
    LATCHED,
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
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.encodings import CDR_HEADER, MessageBytes

# The functions below are in the binding's compiled part, which has no types; its methods call them, too.
# pyright: reportPrivateUsage=false, reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportUnknownArgumentType=false


Writer: TypeAlias = DataWriter[IdlStruct]
Reader: TypeAlias = DataReader[IdlStruct]
ANY_STATE = SampleState.Any | ViewState.Any | InstanceState.Any
MOST_TAKEN = 64
"""Most samples that are taken of a reader at once."""


def write_raw(writer: Writer, data: bytes) -> bool:
    """Write a message's CDR; return False if slow readers had no room for it."""
    # The binding wants whole words of 4 bytes; CDR readers ignore what follows the message.
    return ddspy_write(writer._ref, data + bytes(-len(data) % 4)) == 0


def take_raw(reader: Reader) -> Iterator[bytes]:
    """Yield the CDR of messages that have come; none of a reader that has just been deleted."""
    # The compiled part returns a negative code in place of a list if the reader is gone.
    samples: Any = ddspy_take(reader._ref, ANY_STATE, MOST_TAKEN)
    if not isinstance(samples, int):
        # Samples without valid data only tell that a writer is gone.
        yield from (bytes(data) for data, about in samples if about.valid_data)


def delete(entity: Entity) -> None:
    """Delete an entity and all that it has."""
    # The binding deletes an entity when Python forgets it; then a second deletion does nothing.
    entity.__del__()


# Some of the library's own types are missing.
# pyright: reportUnknownMemberType=false
PRIMITIVES: dict[str, Any] = {
    "bool": bool,
    "int8": types.int8,
    "uint8": types.uint8,
    "byte": types.uint8,
    "char": types.uint8,
    "int16": types.int16,
    "uint16": types.uint16,
    "int32": types.int32,
    "uint32": types.uint32,
    "int64": types.int64,
    "uint64": types.uint64,
    "float32": types.float32,
    "float64": types.float64,
    "string": str,
}
REQUEST_HEADER = {"guid": "uint64", "seq": "int64"}
"""Fields before those of requests and replies, by which Cyclone's ROS 2 knows which belong together."""
HEADER_BYTES = 16
log = logging.getLogger(__name__)
DISCOVERY, DISCOVERY_TYPE = "ros_discovery_info", "rmw_dds_common/ParticipantEntitiesInfo"
"""Topic on which participants tell which nodes they have, and its type."""
WAIT_NS = 200_000_000
"""Longest wait of the reading thread [ns]."""
PATIENCE_MS = 10
"""Longest wait of a reliable writer for slow readers [ms]; then the message is dropped."""
CLIENT_WAIT = 0.1
"""Longest wait for the discovery of the reader of a client's replies [s]."""
LOOPBACK = (
    '<Interfaces><NetworkInterface address="127.0.0.1" multicast="true"/></Interfaces>'
    "<AllowMulticast>true</AllowMulticast>"
)
CONFIG = (
    "<CycloneDDS><Domain><General>{general}</General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>99</MaxAutoParticipantIndex>{peers}</Discovery></Domain></CycloneDDS>"
)
"""Configuration of a domain; what CYCLONEDDS_URI says comes after it."""


@cache
def idl_type(kind: str) -> type[IdlStruct]:
    """Return the class of a type, by its short name; parts of services begin with `REQUEST_HEADER`."""
    fields = dict(RosVersion.ROS2.fields(kind))
    if "/srv/" in kind:
        fields = {**REQUEST_HEADER, **fields}
    full = dds_type(kind)
    return make_idl_struct(full.replace("::", "_"), full, {name: _field(its) for name, its in fields.items()})


def _field(kind: str) -> Any:  # noqa: ANN401 - an annotation of the binding
    item, bracket, length = kind.partition("[")
    base, _, bound = item.partition("<=")
    found = PRIMITIVES.get(base) or idl_type(base)
    if bound:
        found = types.bounded_str[int(bound)]
    if not bracket:
        return found
    size = length[:-1]
    if not size:
        return types.sequence[found]
    if size.startswith("<="):
        return types.sequence[found, int(size[2:])]
    return types.array[found, int(size)]


def domain_config(*, is_local: bool) -> str:
    """Return the configuration of a domain, on this machine's loopback or on its network."""
    # Multicast over the loopback is not possible on every system: the peer is asked directly, too.
    peers = "<Peers><Peer address='localhost'/></Peers>" if is_local else ""
    config = CONFIG.format(general=LOOPBACK if is_local else "", peers=peers)
    more = os.environ.get("CYCLONEDDS_URI", "")
    # Cyclone reads a list of configurations, of which later ones win: the user's own comes last.
    return f"{config},{more}" if more else config


def dds_qos(qos: Qos, user_data: str) -> DdsQos:
    """Return a quality in the words of DDS, with what an endpoint says of itself to others."""
    history = Policy.History.KeepLast(qos.depth)
    policies: list[Any] = [
        history,
        Policy.Reliability.Reliable(duration(milliseconds=PATIENCE_MS))
        if qos.is_reliable
        else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.is_latched else Policy.Durability.Volatile,
        # A closing writer would otherwise dispose its instances, which readers of ROS take for data.
        Policy.WriterDataLifecycle(autodispose=False),
        # Readers of ROS 2 know only the first version of CDR, and the bytes are written in that form.
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(user_data.encode()),
    ]
    if qos.is_latched:
        # This policy, not the writer's history, bounds the samples for late readers.
        policies.append(Policy.DurabilityService(0, history, -1, -1, -1))
    return DdsQos(*policies)


def gid(entity: Entity) -> RosMessage:
    """Return the identity of an endpoint or participant as ROS 2 spells it."""
    return {"data": entity.guid.bytes}


class CyclonePublisher:
    """A writer of one topic.

    Args:
        writer: The writer.
        close: Forgets it.
    """

    def __init__(self, writer: Writer, close: Callable[[], None]) -> None:
        self._writer, self.close = writer, close

    def write(self, data: bytes) -> bool:
        """Send a message's CDR; return False if slow readers had no room for it."""
        return write_raw(self._writer, data)

    def has_readers(self) -> bool:
        """Return whether anybody reads it."""
        return self._writer.get_publication_matched_status().current_count > 0


class CycloneEndpoints:
    """Some endpoints that leave together.

    Args:
        close: Forgets them.
    """

    def __init__(self, close: Callable[[], None]) -> None:
        self.close = close


class DdsTransport:
    """The participant of a domain.

    Args:
        domain: Its number.
        is_local: Whether only participants on this machine are found, through its loopback.

    Raises:
        UsageError: There is no such domain here, or no network for it.
    """

    def __init__(self, domain: int, *, is_local: bool) -> None:
        try:
            self._domain = Domain(domain, domain_config(is_local=is_local))
            self._participant = DomainParticipant(
                domain, qos=DdsQos(Policy.Userdata(f"enclave={ENCLAVE};".encode()))
            )
        except DDSException as error:
            raise UsageError(f"cannot join DDS domain {domain}: {quoted(error)}") from error
        self._publisher, self._subscriber = DdsPublisher(self._participant), Subscriber(self._participant)
        self._writers: dict[object, list[Writer]] = {}
        self._readers: dict[object, list[Reader]] = {}
        self._services = 0
        self._takers: dict[ReadCondition, tuple[Reader, Callable[[bytes], None]]] = {}
        self._lock, self._closing = threading.Lock(), GuardCondition(self._participant)
        self._waiting = WaitSet(self._participant)
        self._waiting.attach(self._closing)
        self._bytes = MessageBytes(RosVersion.ROS2)
        # Latched: a participant that comes later must learn of the nodes, too.
        self._graph = self._writer(DISCOVERY, DISCOVERY_TYPE, LATCHED, "")
        self._thread = threading.Thread(target=self._read, name="ROS 2 readers", daemon=True)
        self._thread.start()

    def publisher(self, topic: str, kind: str, qos: Qos) -> CyclonePublisher:
        """Return a publisher of a topic with messages of a type, by its short name."""
        writer = self._writer(f"rt{topic}", kind, qos, f"typehash={message_hash(kind)};")
        self._writers[writer] = [writer]
        return CyclonePublisher(writer, lambda: self._forget(writer))

    def subscription(self, topic: str, kind: str, qos: Qos, take: TakeMessage) -> CycloneEndpoints:
        """Subscribe to a topic with messages of a type, by its short name."""
        reader = self._reader(f"rt{topic}", kind, qos, f"typehash={message_hash(kind)};")
        self._readers[reader] = [reader]
        self._attach(reader, take)
        return CycloneEndpoints(lambda: self._forget(reader))

    def service(self, name: str, kind: str, take: TakeRequest) -> CycloneEndpoints:
        """Offer a service of a type such as `std_srvs/srv/Empty`."""
        self._services += 1
        # Unique in the domain: the participant's part of a GUID, and a number of our own for the entity.
        prefix = self._participant.guid.bytes[:12] + self._services.to_bytes(4, "big")
        user_data = f"serviceid={'.'.join(f'{one:x}' for one in prefix)};typehash={service_hash(kind)};"
        writer = self._writer(f"rr{name}Reply", f"{kind}_Response", DEFAULT, user_data)
        reader = self._reader(f"rq{name}Request", f"{kind}_Request", DEFAULT, user_data)
        # Both under the reader's key, so that a service is forgotten as a whole.
        self._writers[reader], self._readers[reader] = [writer], [reader]
        self._attach(reader, lambda data: take(data, self._reply(writer, data)))
        return CycloneEndpoints(lambda: self._forget(reader))

    def announce(self) -> None:
        """Tell other nodes which endpoints this node has."""
        node = {
            "node_namespace": NAMESPACE,
            "node_name": NODE,
            "reader_gid_seq": [gid(one) for readers in self._readers.values() for one in readers],
            "writer_gid_seq": [gid(one) for writers in self._writers.values() for one in writers],
        }
        message = {"gid": gid(self._participant), "node_entities_info_seq": [node]}
        write_raw(self._graph, self._bytes.whole(DISCOVERY_TYPE, message))

    def close(self) -> None:
        """Leave the domain."""
        # Ends the wait of the reading thread at once.
        self._closing.set(True)
        # Before anything is deleted: the thread may be inside a call on a reader.
        self._thread.join(5.0)
        with self._lock:
            self._takers.clear()
        self._writers.clear()
        self._readers.clear()
        # Deleting a participant deletes all that it has.
        for entity in (self._participant, self._domain):
            delete(entity)

    def _writer(self, name: str, kind: str, qos: Qos, user_data: str) -> Writer:
        topic = Topic(self._participant, name, idl_type(kind))
        return DataWriter(self._publisher, topic, qos=dds_qos(qos, user_data))

    def _reader(self, name: str, kind: str, qos: Qos, user_data: str) -> Reader:
        topic = Topic(self._participant, name, idl_type(kind))
        return DataReader(self._subscriber, topic, qos=dds_qos(qos, user_data))

    def _attach(self, reader: Reader, take: Callable[[bytes], None]) -> None:
        condition = ReadCondition(reader, ANY_STATE)
        with self._lock:
            self._takers[condition] = reader, take
            self._waiting.attach(condition)

    def _forget(self, key: Writer | Reader) -> None:
        with self._lock:
            for condition, (reader, _) in list(self._takers.items()):
                if reader is key:
                    self._waiting.detach(condition)
                    del self._takers[condition]
        for entity in (*self._writers.pop(key, []), *self._readers.pop(key, [])):
            delete(entity)

    def _reply(self, writer: Writer, request: bytes) -> Reply:
        """Return what writes the reply to a request: with the same identity, which comes first."""
        identity = request[len(CDR_HEADER) : len(CDR_HEADER) + HEADER_BYTES]

        def reply(data: bytes) -> None:
            # A client may be found before the reader of its replies is.
            until = time.monotonic() + CLIENT_WAIT
            while not writer.get_publication_matched_status().current_count and time.monotonic() < until:
                time.sleep(0.005)
            write_raw(writer, data[: len(CDR_HEADER)] + identity + data[len(CDR_HEADER) :])

        return reply

    def _read(self) -> None:
        """Take what comes, until the transport closes."""
        while not self._closing.read():
            # Not without end: readers that are attached during a wait count from the next one on.
            self._waiting.wait(WAIT_NS)
            # Only for the copy: a callback that subscribes would wait for this lock for ever.
            with self._lock:
                found = list(self._takers.values())
            for reader, take in found:
                for data in take_raw(reader):
                    take(data)
