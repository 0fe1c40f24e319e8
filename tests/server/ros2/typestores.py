"""Messages of any type for tests, and the same ones as rosbags has them."""

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from usarmjx.server.rosbridge.definitions import INTERFACES, RosVersion
from usarmjx.server.rosbridge.encodings import FORMATS, split_kind

SPAN = {"int8": 100, "int16": 9_000, "int32": 10**9, "int64": 10**18}


def typestore(version):
    """The types of one version as rosbags has them; of ROS 2 also those of services."""
    store = get_typestore(Stores.ROS2_KILTED if version == RosVersion.ROS2 else Stores.ROS1_NOETIC)
    if version == RosVersion.ROS2:
        for kind in INTERFACES:
            full = version.type_name(kind)
            if full not in store.fielddefs:
                text = "\n".join(f"{its} {name}" for name, its in version.fields(kind).items())
                read = get_types_from_msg(text, full)
                # It puts `msg` in front of the last part, and of names of types in the package of a service.
                store.register({_of_service(name): fields for name, fields in read.items()})
    return store


def _of_service(name):
    return name.replace("/srv/msg/", "/srv/")


def sample(version, kind, random):
    """A message with random values; lists have up to four items."""
    base, is_list, length = split_kind(kind)
    if is_list:
        count = length or int(random.integers(0, 2 if "<=" in kind else 5))
        if base in ("uint8", "byte", "char"):
            return random.bytes(count)
        return [sample(version, base, random) for _ in range(count)]
    if base == "string":
        return "".join(random.choice(list("abcdé_/"), int(random.integers(0, 7))))
    if base == "bool":
        return bool(random.integers(0, 2))
    if base in ("float32", "float64"):
        return float(np.float32(random.normal()))
    if base in FORMATS:
        return int(random.integers(0, 200 if base in ("uint8", "byte", "char") else SPAN.get(base, 60_000)))
    return {name: sample(version, its, random) for name, its in version.fields(base).items()}


def foreign(store, version, kind, value):
    """The message as an object of rosbags."""
    base, is_list, _ = split_kind(kind)
    if is_list and base in FORMATS:
        if isinstance(value, bytes):
            return np.frombuffer(value, np.uint8)
        return np.array(value, np.dtype(FORMATS[base]))
    if is_list:
        return [foreign(store, version, base, one) for one in value]
    if base in FORMATS or base == "string":
        return value
    fields = version.fields(base)
    made = store.types[full_name(version, base)]
    return made(*(foreign(store, version, its, value[name]) for name, its in fields.items()))


def full_name(version, kind):
    """The name of a type in rosbags, which has those of ROS 2 for both versions."""
    return kind.replace("/", "/msg/") if kind.count("/") == 1 else kind
