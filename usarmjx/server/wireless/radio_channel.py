"""The radio of a served world: positions of its robots, and the power received between them now.

The links are those of the world's own radio, computed once per control step and only on request.
"""

from collections.abc import Iterator

import numpy as np

from usarmjx.base.backend import Array, numpy_backend
from usarmjx.base.transforms import Vec3
from usarmjx.comms.attenuation import RadioSettings, received_power
from usarmjx.comms.links import Links
from usarmjx.models.drives.base import RobotState
from usarmjx.server.wireless.channel import RadioRobot
from usarmjx.server.worlds.robot import Robot
from usarmjx.server.worlds.served_world import ServedWorld


class RadioChannel:
    """The radio of one served world; a `channel.RadioAccess`.

    Doors block in their present angle, robots and loose objects weaken no link.

    Args:
        world: The world.
        settings: The constants, in a world that has no radio of its own.

    Attributes:
        cutoff: Power below which there is no link [dBm].

    Raises:
        UnsupportedGeomError: The arena has a solid of a type that cannot be counted.
    """

    def __init__(self, world: ServedWorld, settings: RadioSettings) -> None:
        self._settings = settings if world.scene.radio is None else world.scene.radio
        self.cutoff = self._settings.cutoff
        self._world = world
        self._moment: tuple[float, tuple[Robot, ...]] | None = None
        self._states: dict[Robot, RobotState] = {}
        self._links: Links | None = None
        world.solids_between((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # raises at once if solids cannot be counted

    def present(self) -> list[RadioRobot]:
        """Return all robots in the world, in the order of their slots."""
        return [
            RadioRobot(robot.name, _vec3(self._state(robot).pos), self._world.battery(robot) <= 0)
            for robot in self._robots()
        ]

    def has_robot(self, name: str) -> bool:
        """Return whether a robot of that name is in the world."""
        return self._find(name) is not None

    def signal_strength(self, one: str, other: str) -> float | None:
        """Return the power received between two robots [dBm]; None if either is not in the world.

        A robot receives itself as from the formula's least distance.
        """
        pair = self._find(one), self._find(other)
        if pair[0] is None or pair[1] is None:
            return None
        if pair[0] is pair[1]:
            with numpy_backend():
                return float(received_power(self._settings, np.zeros(()), np.zeros((), np.int32)))
        return float(self._now().power[pair[0].slot, pair[1].slot])

    def obstacles(self, one: str, other: str) -> int | None:
        """Return the number of solids between two robots; None if either is not in the world."""
        pair = self._find(one), self._find(other)
        if pair[0] is None or pair[1] is None:
            return None
        return int(self._now().walls[pair[0].slot, pair[1].slot])

    def obstacles_between(self, start: Vec3, end: Vec3) -> int:
        """Return the number of solids between two positions, in our axes [m]."""
        return self._world.solids_between(start, end)

    def _robots(self) -> Iterator[Robot]:
        return (robot for _, robot in sorted(self._world.robots.items()))

    def _find(self, name: str) -> Robot | None:
        # The world finds robots in any case, although both dialects match registered names exactly.
        wanted = name.lower()
        return next((robot for robot in self._robots() if robot.name.lower() == wanted), None)

    def _refresh(self) -> None:
        """Drop the values of an earlier control step."""
        # The robots are part of it: one that joined within a step has no place in the tables so far.
        moment = self._world.time, tuple(self._world.robots.values())
        if self._moment != moment:
            self._moment = moment
            self._states.clear()
            self._links = None

    def _now(self) -> Links:
        """Return the links of this control step."""
        self._refresh()
        if self._links is None:
            self._links = self._world.links(self._settings)
        return self._links

    def _state(self, robot: Robot) -> RobotState:
        """Return the state of a robot, fetched once per control step."""
        self._refresh()
        if robot not in self._states:
            self._states[robot] = self._world.state(robot)
        return self._states[robot]


def _vec3(values: Array) -> Vec3:
    x, y, z = (float(value) for value in values)
    return (x, y, z)
