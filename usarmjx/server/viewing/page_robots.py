"""The robots of one served world in the hands of somebody at the page.

They take the commands that clients have (`adapter.Client`): a robot that the page let appear is one whose
client has no connection, one that it has taken over obeys it in place of its client.
"""

import logging
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass

from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3
from usarmjx.models.build.body_plan import kinematic_tree_of
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.server.adapter import Client
from usarmjx.server.arrivals import appear
from usarmjx.server.net import BotServer
from usarmjx.server.protocol import commands as wire
from usarmjx.server.protocol.frames import flip_wire_angles, flip_wire_vector
from usarmjx.server.worlds.robot import Robot
from usarmjx.sim.scene import START_GAP
from usarmjx.view.controls import BY_CLIENT, BY_PAGE, BY_POLICY

log = logging.getLogger(__name__)

HOLD_TIME = 0.5
"""A robot that is not told again so long after it was told to drive stops [s]."""
MAX_NAME = 40
"""Longest name that a robot may get at the page."""


@dataclass(eq=False)
class Hand:
    """A robot that the page has.

    Attributes:
        client: Carries out its commands.
        own: Whether it appeared by the page, and not by a client.
        stops_at: When it stops unless told again [s]; infinite while it stands.
    """

    client: Client
    own: bool
    stops_at: float = math.inf


class PageRobots:
    """The robots of a world that the page has; all is for the thread that runs the world.

    Args:
        server: The world's server.
    """

    def __init__(self, server: BotServer) -> None:
        self._server, self._world = server, server.world
        self._hands: dict[int, Hand] = {}

    def tick(self, now: float) -> None:
        """Stop robots that have not been told again in time; forget those that are gone."""
        for slot, hand in list(self._hands.items()):
            if hand.client.robot is None or hand.client.lost:
                self._forget(slot)
            elif now >= hand.stops_at:
                self._stop(hand)

    def drivers(self) -> dict[int, str]:
        """Return who drives each robot, by slot."""
        found = dict.fromkeys(self._world.agents().values(), BY_POLICY)
        found |= dict.fromkeys(list(self._world.robots), BY_CLIENT)
        return found | dict.fromkeys(list(self._hands), BY_PAGE)

    def taken_over(self) -> frozenset[int]:
        """Return the slots of the robots that did not appear by the page."""
        return frozenset(slot for slot, hand in list(self._hands.items()) if not hand.own)

    def take_over(self, slot: int) -> None:
        """Have a robot that a client or a policy drives.

        Raises:
            UsageError: There is none.
        """
        if slot in self._hands:
            return
        robot = self._world.robots.get(slot)
        client = Client(self._world, "the page")
        if robot is None:
            agents = {place: name for name, place in self._world.agents().items()}
            if slot not in agents:
                raise UsageError(f"there is no robot {slot} to take over")
            group, _ = self._world.scene.group_of(slot)
            spec = self._world.scene.groups[group].robot
            client.adopt(self._world.spawn(spec, agents[slot], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0.0)
            self._server.guests.append(client)
        else:
            client.robot, robot.obeys = robot, client
        self._hands[slot] = Hand(client, own=False)
        log.info("the page has taken over %s", self._name(slot))

    def give_back(self, slot: int) -> None:
        """Let a robot that was taken over obey its client or policy again."""
        hand = self._hands.get(slot)
        if hand is not None and not hand.own:
            self._stop(hand)
            self._forget(slot)

    def let_go(self) -> None:
        """Stop all robots, and give back those that were taken over."""
        for slot, hand in list(self._hands.items()):
            self._stop(hand)
            self.give_back(slot)

    def drive(self, slot: int, values: Mapping[str, float]) -> None:
        """Set keys of DRIVE; without another order in time all are 0 again."""
        hand = self._hand(slot)
        self._tell(hand, wire.DriveRobot(tuple(values.items())))
        hand.stops_at = time.monotonic() + HOLD_TIME if any(values.values()) else math.inf

    def set_joint(self, slot: int, joint: str, position: float) -> None:
        """Let a joint go to a position [rad or m]."""
        self._tell(self._hand(slot), wire.MultiDrive(((joint, position),)))

    def set_light(self, slot: int, on: bool) -> None:
        """Switch a headlight."""
        self._tell(self._hand(slot), wire.DriveRobot((), light=on))

    def zoom(self, slot: int, camera: str, fov: float) -> None:
        """Set a camera's field of view [rad]."""
        self._tell(self._hand(slot), wire.SetFov(((camera, fov),)))

    def operate(self, slot: int, effecter: str, opcode: str, value: float | None) -> None:
        """Let a robot operate an effecter, as SET does."""
        hand = self._hand(slot)
        robot = self._robot(hand)
        kinds = [one.mount.kind for one in robot.effecters if one.mount.name == effecter]
        if not kinds:
            raise UsageError(f"{robot.name} has no effecter {effecter}")
        params = "" if value is None else f"{value:g}"
        self._tell(hand, wire.Set(kinds[0], effecter, opcode, params))

    def spawn(self, spec: RobotSpec, name: str, pos: Vec3, yaw: float) -> None:
        """Let a robot appear that has no client; see `WorldControls.spawn`."""
        name = name.strip()
        self._check_name(name)
        origin = (*pos[:2], pos[2] + kinematic_tree_of(spec).clearance + START_GAP)
        init = wire.Init(spec.name, name, flip_wire_vector(origin), flip_wire_angles((0.0, 0.0, yaw)))
        robot = appear(self._world, init, spec)
        client = Client(self._world, "the page")
        client.adopt(robot, robot.spawn_time)
        self._server.guests.append(client)
        self._hands[robot.slot] = Hand(client, own=True)
        log.info("the page: spawned %s as %r", spec.name, robot.name)

    def remove(self, slot: int, anyones: bool) -> None:
        """Take a robot out of the world: one that appeared by `spawn`, or anyone's.

        Raises:
            UsageError: There is none, or it is a client's.
        """
        robot, hand = self._world.robots.get(slot), self._hands.get(slot)
        if robot is None:
            raise UsageError(f"there is no robot {slot} that could leave")
        if not (anyones or (hand and hand.own)):
            raise UsageError(f"{robot.name} is a client's: it leaves only if that is confirmed")
        if hand is not None:
            self._forget(slot)
        self._world.remove(robot)

    def _check_name(self, name: str) -> None:
        """Refuse a name that is taken or cannot stand in a line."""
        if len(name) > MAX_NAME or not name.isprintable() or any(c in "{} " for c in name):
            raise UsageError(f"a robot's name has up to {MAX_NAME} characters, and no spaces or braces")
        if name.lower() in {robot.name.lower() for robot in self._world.robots.values()}:
            raise UsageError(f"there is a robot {name} already")

    def _hand(self, slot: int) -> Hand:
        hand = self._hands.get(slot)
        if hand is not None and hand.client.robot is not None and not hand.client.lost:
            return hand
        raise UsageError(f"{self._name(slot)} has a driver: take it over first")

    @staticmethod
    def _robot(hand: Hand) -> Robot:
        if hand.client.robot is None:
            raise UsageError("the robot has gone")
        return hand.client.robot

    def _tell(self, hand: Hand, command: wire.Command) -> None:
        """Carry out a command.

        Raises:
            UsageError: What was wrong with it.
        """
        session = hand.client.session
        hand.client.handle(command)
        answer = session.data_to_send().decode("latin-1")
        faults = session.take_faults()
        if faults:
            raise UsageError("; ".join(faults))
        if isinstance(command, wire.Set) and "{Status Failed}" in answer:
            raise UsageError(f"{self._robot(hand).name} cannot do {command.opcode} of {command.name} now")

    def _stop(self, hand: Hand) -> None:
        hand.stops_at = math.inf
        robot = hand.client.robot
        if robot is not None and not hand.client.lost:
            self._tell(hand, wire.DriveRobot(tuple((key, 0.0) for key in robot.spec.drive.keys)))

    def _forget(self, slot: int) -> None:
        client = self._hands.pop(slot).client
        robot, client.robot = client.robot, None
        if client in self._server.guests:
            self._server.guests.remove(client)
            if robot is not None and self._world.agents() and self._world.robots.get(slot) is robot:
                self._world.remove(robot)  # its policy has it again
        if robot is not None and robot.obeys is client:
            robot.obeys = None

    def _name(self, slot: int) -> str:
        robot = self._world.robots.get(slot)
        return f"robot {slot}" if robot is None else robot.name
