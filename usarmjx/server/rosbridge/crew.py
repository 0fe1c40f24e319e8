"""The robots of one rosbridge client: those that it let appear, and those that it drives."""

import logging

from usarmjx.base.errors import UsageError
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.server.adapter import Client
from usarmjx.server.arrivals import appear
from usarmjx.server.net import BotServer
from usarmjx.server.protocol.commands import Init
from usarmjx.server.protocol.grammar import clip
from usarmjx.server.rosbridge.velocity import drive_keys, read_twist
from usarmjx.server.worlds.robot import Robot
from usarmjx.sim.control import CommandUpdate

log = logging.getLogger(__name__)


class RosCrew:
    """What a client has; the robots that it let appear go when it goes.

    Args:
        server: The world's server.
        peer: What the log calls the client.
    """

    def __init__(self, server: BotServer, peer: str) -> None:
        self._server, self._peer = server, peer
        self._own: list[Client] = []
        self._driven: list[Robot] = []

    @property
    def is_empty(self) -> bool:
        """Whether it has let no robot appear that is still there."""
        self.forget_lost()
        return not self._own

    def spawn(self, init: Init, spec: RobotSpec) -> Robot:
        """Let a robot appear, and report without a connection.

        Raises:
            UsageError: There is no room for it, or its name is taken.
        """
        world = self._server.world
        if init.name.lower() in {robot.name.lower() for robot in world.robots.values()}:
            raise UsageError(f"there is a robot {init.name} already")
        robot = appear(world, init, spec)
        own = Client(world, self._peer)
        own.adopt(robot, robot.spawn_time)
        self._server.guests.append(own)
        self._own.append(own)
        log.info("%s: spawned %s as %r", self._peer, spec.name, robot.name)
        return robot

    def remove(self, name: str) -> None:
        """Take a robot out of the world that this client let appear.

        Raises:
            UsageError: It has none of that name.
        """
        own = next((one for one in self._own if one.robot and one.robot.name.lower() == name.lower()), None)
        if own is None:
            raise UsageError(f"you have let no robot {clip(name)} appear")
        self._let_go(own)

    def let_one_go(self) -> None:
        """Take one of its robots out of the world: all at once would hold up the others."""
        if self._own:
            self._let_go(self._own[0])

    def forget_lost(self) -> None:
        """Forget robots that are gone, or that somebody else has been given."""
        for own in [one for one in self._own if one.robot is None or one.lost]:
            self._own.remove(own)
            self._dismiss(own)

    def drive(self, robot: Robot, twist: object) -> None:
        """Let a robot move as a Twist says, until it is told otherwise.

        Raises:
            UsageError: It is no Twist, or somebody else drives the robot.
        """
        if robot.obeys is not None:
            raise UsageError(f"{robot.name} is driven from the page")
        if self._server.world.robots.get(robot.slot) is not robot:
            raise UsageError(f"a policy drives {robot.name}: /simulator/spawn with that name takes it over")
        keys = drive_keys(robot.spec, read_twist(twist))
        self._server.world.update_command(robot, CommandUpdate(drive=keys))
        if robot not in self._driven:
            self._driven.append(robot)

    def stop_driven(self) -> None:
        """Stop the robots that it has driven."""
        world = self._server.world
        for robot in self._driven:
            if world.robots.get(robot.slot) is robot and robot.obeys is None:
                still = dict.fromkeys(robot.spec.drive.keys, 0.0)
                world.update_command(robot, CommandUpdate(drive=still))
        self._driven.clear()

    def _let_go(self, own: Client) -> None:
        self._own.remove(own)
        self._dismiss(own)
        if own.robot is not None and not own.lost:
            own.leave()

    def _dismiss(self, own: Client) -> None:
        if own in self._server.guests:
            self._server.guests.remove(own)
