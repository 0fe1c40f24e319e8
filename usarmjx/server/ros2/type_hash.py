"""Hashes of types, as ROS 2 compares them at discovery (RIHS01, REP 2016).

A hash is the SHA-256 of a type's description in JSON, with the descriptions of all types in it. A service's
description has its request, its response and an event of both.
"""

import json
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from typing import Any

from usarmjx.server.rosbridge.definitions import RosVersion

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
        "referenced_type_descriptions": [described[n] for n in sorted(described)],
    }
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
            "capacity": int(size.removeprefix("<=") or 0),
            "string_capacity": int(bound or 0),
            "nested_type_name": RosVersion.ROS2.type_name(base) if "/" in base else "",
        },
    }
