"""Messages' types as classes of Cyclone DDS's Python binding, which announces them to other participants.

The binding would serialise messages of these classes by itself, at a hundred times the cost of
`rosbridge.serialization`, whose bytes are written instead.
"""

from functools import cache
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct, types

from usarmjx.server.ros2.transport import dds_type
from usarmjx.server.rosbridge.definitions import RosVersion

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
