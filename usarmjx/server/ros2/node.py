"""The services of a world in ROS 2: robots that appear and vanish, and a reset."""

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.server.gamebots.server import BotServer
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.definitions import RosMessage
from usarmjx.server.rosbridge.interfaces import EMPTY
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
