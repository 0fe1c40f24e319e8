"""The parameters of the node, and the services by which ROS 2's tools read and set them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.ros2.transport import NODE
from usarmjx.server.rosbridge.definitions import RosMessage

NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)
"""Values of ParameterType that parameters have here."""
VALUE_FIELDS = {BOOL: "bool_value", INTEGER: "integer_value", DOUBLE: "double_value", STRING: "string_value"}
TYPE_NAMES = {BOOL: "a bool", INTEGER: "an integer", DOUBLE: "a double", STRING: "a string"}
SEPARATOR = "."
"""Separator of the parts of a parameter's name."""


@dataclass(frozen=True)
class NodeParameter:
    """A parameter.

    Attributes:
        about: Its description.
        get: Returns its value: a bool, an int, a float or a text.
        set: Sets it; None: it is read-only.
    """

    about: str
    get: Callable[[], bool | int | float | str]
    set: Callable[[Any], None] | None = None


def parameter_value(value: bool | int | float | str | None) -> RosMessage:
    """Return a value as a ParameterValue; None is not set."""
    kind = NOT_SET if value is None else _type_of(value)
    message: RosMessage = {
        "type": kind,
        "bool_value": False,
        "integer_value": 0,
        "double_value": 0.0,
        "string_value": "",
        "byte_array_value": b"",
        "bool_array_value": [],
        "integer_array_value": [],
        "double_array_value": [],
        "string_array_value": [],
    }
    if kind != NOT_SET:
        message[VALUE_FIELDS[kind]] = value
    return message


def _type_of(value: bool | int | float | str) -> int:
    if isinstance(value, bool):
        return BOOL
    return INTEGER if isinstance(value, int) else DOUBLE if isinstance(value, float) else STRING


class ParameterServices:
    """The services of a node's parameters.

    Args:
        parameters: Returns the present parameters, by their names.
    """

    def __init__(self, parameters: Callable[[], Mapping[str, NodeParameter]]) -> None:
        self._parameters = parameters

    def services(self) -> dict[str, tuple[str, Callable[[RosMessage], RosMessage]]]:
        """Return the type and the function of each service, by its name."""
        found = {
            "get_parameters": ("GetParameters", self._get),
            "get_parameter_types": ("GetParameterTypes", self._types),
            "set_parameters": ("SetParameters", self._set),
            "set_parameters_atomically": ("SetParametersAtomically", self._set_all),
            "describe_parameters": ("DescribeParameters", self._describe),
            "list_parameters": ("ListParameters", self._list),
        }
        return {
            f"/{NODE}/{name}": (f"rcl_interfaces/srv/{kind}", function)
            for name, (kind, function) in found.items()
        }

    def _get(self, request: RosMessage) -> RosMessage:
        known = self._parameters()
        return {
            "values": [
                parameter_value(known[name].get() if name in known else None) for name in request["names"]
            ]
        }

    def _types(self, request: RosMessage) -> RosMessage:
        known = self._parameters()
        return {
            "types": [_type_of(known[name].get()) if name in known else NOT_SET for name in request["names"]]
        }

    def _set(self, request: RosMessage) -> RosMessage:
        return {"results": [self._set_one(one) for one in request["parameters"]]}

    def _set_all(self, request: RosMessage) -> RosMessage:
        """Set all parameters, or none if one of them cannot be set."""
        for one in request["parameters"]:
            if reason := self._refusal(one):
                return {"result": {"successful": False, "reason": reason}}
        for one in request["parameters"]:
            self._set_one(one)
        return {"result": {"successful": True, "reason": ""}}

    def _set_one(self, one: RosMessage) -> RosMessage:
        reason = self._refusal(one)
        found = self._parameters().get(one["name"])
        if not reason and found is not None and found.set is not None:
            try:
                found.set(one["value"][VALUE_FIELDS[one["value"]["type"]]])
            except UsageError as error:
                reason = str(error)
        return {"successful": not reason, "reason": reason}

    def _refusal(self, one: RosMessage) -> str:
        """Return why a parameter cannot be set; empty if it can."""
        name, known = one["name"], self._parameters()
        if name not in known:
            return f"no parameter {clip(name)}; known: {', '.join(known)}"
        if known[name].set is None:
            return f"{name} is read-only"
        wanted = _type_of(known[name].get())
        return "" if one["value"]["type"] == wanted else f"{name} is {TYPE_NAMES[wanted]}"

    def _describe(self, request: RosMessage) -> RosMessage:
        known = self._parameters()
        return {"descriptors": [_descriptor(name, known.get(name)) for name in request["names"]]}

    def _list(self, request: RosMessage) -> RosMessage:
        """List the parameters below some prefixes, as deep as asked; 0: all."""
        prefixes, depth = request["prefixes"], request["depth"]
        names = [name for name in self._parameters() if _is_below(name, prefixes, depth)]
        above = {name.rpartition(SEPARATOR)[0] for name in names}
        return {"result": {"names": names, "prefixes": sorted(above - {""})}}


def _is_below(name: str, prefixes: list[str], depth: int) -> bool:
    if not prefixes:
        return depth == 0 or name.count(SEPARATOR) < depth
    below = [prefix for prefix in prefixes if name == prefix or name.startswith(prefix + SEPARATOR)]
    return any(depth == 0 or name[len(prefix) :].count(SEPARATOR) <= depth for prefix in below)


def _descriptor(name: str, found: NodeParameter | None) -> RosMessage:
    return {
        "name": name,
        "type": NOT_SET if found is None else _type_of(found.get()),
        "description": "" if found is None else found.about,
        "additional_constraints": "",
        "read_only": found is not None and found.set is None,
        "dynamic_typing": False,
        "floating_point_range": [],
        "integer_range": [],
    }
