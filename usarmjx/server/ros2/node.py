"""The node of a world in ROS 2: services for robots and a reset, and its parameters."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.ros2.transport import NODE
from usarmjx.server.rosbridge.definitions import EMPTY, RosMessage
from usarmjx.server.rosbridge.motion import MAP
from usarmjx.server.rosbridge.services import RosRobots, read_spawn
from usarmjx.server.rosbridge.topics import WorldTopics

UNSUPPORTED, OK, NOT_FOUND, FAILED = 0, 1, 2, 4
"""Values of simulation_interfaces/Result's result."""
SCOPE_TIME, SCOPE_STATE, SCOPE_SPAWNED, SCOPE_ALL = 1, 2, 4, 255
"""Bits of ResetSimulation's scope; 0 means all."""
WORLD_FRAMES = ("", MAP, "world")
"""Frames of a spawn pose."""
ServiceAnswer = RosMessage | Awaitable[RosMessage]
NOT_SET, BOOL, INTEGER, DOUBLE, STRING = range(5)
"""Values of ParameterType that parameters have here."""
VALUE_FIELDS = {BOOL: "bool_value", INTEGER: "integer_value", DOUBLE: "double_value", STRING: "string_value"}
TYPE_NAMES = {BOOL: "a bool", INTEGER: "an integer", DOUBLE: "a double", STRING: "a string"}
SEPARATOR = "."
"""Separator of the parts of a parameter's name."""


class WorldServices:
    """The services of a world.

    Args:
        server: The world's server.
        topics: Its topics, which know the robots' names.
        robots: Robots that ROS 2 lets appear.
        stepped: Is set and cleared in each control step.
    """

    def __init__(
        self, server: BotServer, topics: WorldTopics, robots: RosRobots, stepped: asyncio.Event
    ) -> None:
        self._server, self._topics, self._robots, self._stepped = server, topics, robots, stepped

    def services(self) -> dict[str, tuple[str, Callable[[RosMessage], ServiceAnswer]]]:
        """Return the type and the function of each service, by its name."""
        return {
            "/spawn_entity": ("simulation_interfaces/srv/SpawnEntity", self._spawn),
            "/delete_entity": ("simulation_interfaces/srv/DeleteEntity", self._delete),
            "/reset_simulation": ("simulation_interfaces/srv/ResetSimulation", self._reset),
            "/reset": ("std_srvs/srv/Empty", self._reset_plainly),
        }

    async def _spawn(self, request: RosMessage) -> RosMessage:
        """Spawn a robot of the class that the resource names."""
        try:
            init, spec = read_spawn(self._spawn_arguments(request))
            await self._server.prepare(spec)
            robot = await self._server.join(partial(self._robots.spawn, init, spec))
        except UsageError as error:
            return {"result": _result(FAILED, str(error)), "entity_name": ""}
        return {"result": _result(OK), "entity_name": self._topics.name_of(robot)}

    def _spawn_arguments(self, request: RosMessage) -> dict[str, Any]:
        resource, stamped = request["entity_resource"], request["initial_pose"]
        name, space = request["name"], request["entity_namespace"].strip("/")
        if resource["resource_string"]:
            raise UsageError("resource_string is not read: uri names a robot class, such as P2AT")
        if space not in ("", name):
            raise UsageError(f"entity_namespace is {clip(space)}; a robot's topics are below its name")
        frame = stamped["header"]["frame_id"]
        if frame.lstrip("/") not in WORLD_FRAMES:
            raise UsageError(f"initial_pose is in frame {clip(frame)}, expected {MAP}")
        taken = {robot.name.lower() for robot in self._server.world.robots.values()}
        if request["allow_renaming"] and name.lower() in taken:
            name = ""  # the world numbers robots without a name
        found: dict[str, Any] = {"class": resource["uri"], "name": name}
        pose = stamped["pose"]
        # A pose that nobody has filled in is a start of the arena.
        if frame or any(pose["position"].values()) or pose["orientation"]["w"] not in (0.0, 1.0):
            found["pose"] = pose
        return found

    def _delete(self, request: RosMessage) -> RosMessage:
        name = request["entity"].strip("/")
        robot = self._topics.robots().get(name)
        try:
            self._robots.remove(robot.name if robot is not None else name)
        except UsageError as error:
            return {"result": _result(FAILED if robot is not None else NOT_FOUND, str(error))}
        return {"result": _result(OK)}

    async def _reset(self, request: RosMessage) -> RosMessage:
        """Restart the world, or remove the robots that appeared by `/spawn_entity`."""
        scope = request["scope"] or SCOPE_ALL
        if scope == SCOPE_TIME:
            return {"result": _result(UNSUPPORTED, "time goes on: reset the state, which is 2")}
        try:
            if scope & SCOPE_SPAWNED:
                self._robots.dismiss()
                while not self._robots.is_empty:
                    await self._stepped.wait()
            if scope & SCOPE_STATE:
                await self._restart()
        except UsageError as error:
            return {"result": _result(FAILED, str(error))}
        return {"result": _result(OK)}

    async def _reset_plainly(self, request: RosMessage) -> RosMessage:
        """Restart the world; robots stay, at their starts."""
        del request
        await self._restart()
        return dict.fromkeys(EMPTY, 0)

    async def _restart(self) -> None:
        world = self._server.world
        await asyncio.get_running_loop().run_in_executor(None, world.prepare_reset)
        await self._stepped.wait()
        world.reset()


def _result(code: int, message: str = "") -> RosMessage:
    return {"result": code, "error_message": message}


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
