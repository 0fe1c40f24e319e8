"""A bag of ROS 2 as rosbag2 writes it: a folder with messages in CDR in an MCAP file, and `metadata.yaml`."""

from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml
from mcap.writer import CompressionType, Writer

from usarmjx.base.errors import UsageError
from usarmjx.base.files import atomic_write
from usarmjx.server.ros2.transport import Qos
from usarmjx.server.ros2.type_hash import message_hash
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.serialization import MessageBytes

VERSION = 9
"""Version of `metadata.yaml`: that of Jazzy, Kilted and later."""
PROFILE, SCHEMA_ENCODING, MESSAGE_ENCODING = "ros2", "ros2msg", "cdr"
NANO = 10**9
FOREVER = {"sec": 9223372036, "nsec": 854775807}
SEPARATOR = "=" * 80


def message_definition(kind: str) -> str:
    """Return the definition of a type with all types in it, as rosbag2 stores it: with short names."""
    listed, waiting, parts = {kind}, [kind], list[str]()
    while waiting:
        name = waiting.pop(0)
        fields = RosVersion.ROS2.fields(name)
        body = "".join(f"{its} {field}\n" for field, its in fields.items())
        parts.append(body if name == kind else f"{SEPARATOR}\nMSG: {name}\n{body}")
        for base in (its.partition("[")[0] for its in fields.values()):
            if "/" in base and base not in listed:
                listed.add(base)
                waiting.append(base)
    return "".join(parts)


def offered_qos(qos: Qos) -> dict[str, Any]:
    """Return a quality as `metadata.yaml` has it."""
    return {
        "history": "keep_last",
        "depth": qos.depth,
        "reliability": "reliable" if qos.is_reliable else "best_effort",
        "durability": "transient_local" if qos.is_latched else "volatile",
        "deadline": dict(FOREVER),
        "lifespan": dict(FOREVER),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(FOREVER),
        "avoid_ros_namespace_conventions": False,
    }


class BagWriter:
    """Writer of a bag; a context manager.

    Args:
        folder: The new folder.

    Raises:
        UsageError: There is something of that name already.
    """

    def __init__(self, folder: Path) -> None:
        if folder.exists():
            raise UsageError(f"{folder} exists already: a bag is a new folder")
        folder.mkdir(parents=True)
        self._folder, self._file = folder, f"{folder.stem}_0.mcap"
        self._stream = (folder / self._file).open("wb")
        self._writer = Writer(self._stream, compression=CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library="usarmjx")
        self._bytes = MessageBytes(RosVersion.ROS2)
        self._schemas: dict[str, int] = {}
        self._topics: dict[str, dict[str, Any]] = {}
        self._channels: dict[str, int] = {}
        self._first = self._last = -1

    @property
    def topics(self) -> dict[str, int]:
        """The number of messages so far, by topic."""
        return {name: one["message_count"] for name, one in self._topics.items()}

    def write(self, topic: str, kind: str, message: RosMessage, time: float, qos: Qos) -> None:
        """Write a message of a type, by its short name, at a simulated time [s]."""
        stamp = round(time * NANO)
        if topic not in self._channels:
            self._channels[topic] = self._channel(topic, kind, qos)
        data = self._bytes.whole(kind, message)
        self._writer.add_message(self._channels[topic], stamp, data, stamp)
        self._topics[topic]["message_count"] += 1
        self._first = stamp if self._first < 0 else min(self._first, stamp)
        self._last = max(self._last, stamp)

    def _channel(self, topic: str, kind: str, qos: Qos) -> int:
        name, quality = RosVersion.ROS2.type_name(kind), [offered_qos(qos)]
        if kind not in self._schemas:
            text = message_definition(kind).encode()
            self._schemas[kind] = self._writer.register_schema(name, SCHEMA_ENCODING, text)
        self._topics[topic] = {
            "topic_metadata": {
                "name": topic,
                "type": name,
                "serialization_format": MESSAGE_ENCODING,
                "offered_qos_profiles": quality,
                "type_description_hash": message_hash(kind),
            },
            "message_count": 0,
        }
        about = {
            "offered_qos_profiles": yaml.safe_dump(quality, sort_keys=False),
            "topic_type_hash": message_hash(kind),
        }
        return self._writer.register_channel(topic, MESSAGE_ENCODING, self._schemas[kind], about)

    def close(self) -> None:
        """Complete the file, and write `metadata.yaml`."""
        self._writer.finish()
        self._stream.close()
        count = sum(self.topics.values())
        start = {"nanoseconds_since_epoch": max(self._first, 0)}
        lasted = {"nanoseconds": max(self._last - self._first, 0)}
        about = {
            "version": VERSION,
            "storage_identifier": "mcap",
            "duration": lasted,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": list(self._topics.values()),
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file],
            "files": [
                {"path": self._file, "starting_time": start, "duration": lasted, "message_count": count}
            ],
            "custom_data": None,
            "ros_distro": "usarmjx",
        }
        with atomic_write(self._folder / "metadata.yaml") as fresh:
            fresh.write_text(
                yaml.dump({"rosbag2_bagfile_information": about}, Dumper=_NoAliases, sort_keys=False),
                encoding="utf-8",
            )

    def __enter__(self) -> Self:
        """Write until the end of `with`."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the bag."""
        self.close()


class _NoAliases(yaml.SafeDumper):
    """Writes equal values twice: rosbag2's reader knows no aliases."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ANN401 - any value of YAML
        del data
        return True
