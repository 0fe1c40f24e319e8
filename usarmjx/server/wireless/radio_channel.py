"""The radio of a served world: who is where in it, and how strongly they hear each other now.

What is asked once per control step is computed once; everything is compiled when the server starts, for
lots of one size, so that no question makes the world wait for a compiler.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.transforms import Vec3, flip_vector
from usarmjx.comms.antenna import MIN_ANTENNA_HEIGHT, antenna_of
from usarmjx.comms.attenuation import RadioSettings, received_power
from usarmjx.comms.walls import arena_solids, count_walls, with_boxes
from usarmjx.models.build.doors import door_boxes
from usarmjx.models.drives.state import RobotState
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.server.wireless.channel import Presence
from usarmjx.server.worlds.served_world import Robot, ServedWorld

PAIR_BATCH_SIZE = 16
"""So many pairs are computed at a time."""


class RadioChannel:
    """The radio of one served world; a `channel.RadioAccess`.

    Antennas and solids are those of the batch's radio: doors count where they stand, robots and loose objects
    weaken no link.

    Args:
        world: The world.
        settings: The constants.

    Attributes:
        cutoff: Below this power there is no link [dBm].

    Raises:
        UnsupportedGeomError: The arena has a solid of a type that cannot be counted.
    """

    def __init__(self, world: ServedWorld, settings: RadioSettings) -> None:
        self.cutoff = settings.cutoff
        self._world = world
        self._time = -1.0
        self._states: dict[Robot, RobotState] = {}
        self._links: dict[tuple[Robot, Robot], tuple[float, int]] = {}
        with _on_cpu():
            ends, doors = (
                np.zeros((PAIR_BATCH_SIZE, 3), np.float32),
                np.zeros(len(world.arena.doors), np.float32),
            )
            run = jax.jit(partial(_links, settings, world.arena))
            self._run = run.lower(ends, ends, doors).compile()
        self._run(ends, ends, doors)

    def present(self) -> list[Presence]:
        """Return all robots in the world, in the order of their slots."""
        return [
            Presence(robot.name, _vec3(self._state(robot).pos), self._world.battery(robot) <= 0)
            for robot in self._robots()
        ]

    def has_robot(self, name: str) -> bool:
        """Return whether a robot of that name is in the world."""
        return self._find(name) is not None

    def signal_strength(self, one: str, other: str) -> float | None:
        """Return the power received between two robots [dBm]; None if either is not in the world."""
        link = self._link(one, other)
        return None if link is None else link[0]

    def obstacles(self, one: str, other: str) -> int | None:
        """Return how many solids lie between two robots; None if either is not in the world."""
        link = self._link(one, other)
        return None if link is None else link[1]

    def obstacles_between(self, start: Vec3, end: Vec3) -> int:
        """Return how many solids lie between two positions, in our axes [m]."""
        return self._compute([(start, end)])[0][1]

    def precompute(self, pairs: Iterable[tuple[str, str]]) -> None:
        """Compute many pairs at once that will be asked for in this control step."""
        found = {_ordered(self._find(one), self._find(other)) for one, other in pairs}
        wanted = [pair for pair in found if pair is not None and pair not in self._now()]
        ends = [(self._antenna(one), self._antenna(other)) for one, other in wanted]
        for pair, link in zip(wanted, self._compute(ends), strict=True):
            self._links[pair] = link

    def _robots(self) -> Iterator[Robot]:
        return (robot for _, robot in sorted(self._world.robots.items()))

    def _find(self, name: str) -> Robot | None:
        wanted = name.lower()
        return next((robot for robot in self._robots() if robot.name.lower() == wanted), None)

    def _now(self) -> dict[tuple[Robot, Robot], tuple[float, int]]:
        """Return the links computed in this control step."""
        if self._time != self._world.time:
            self._time = self._world.time
            self._states.clear()
            self._links.clear()
        return self._links

    def _state(self, robot: Robot) -> RobotState:
        """Return where a robot is, fetched once per control step."""
        self._now()
        if robot not in self._states:
            self._states[robot] = self._world.state(robot)
        return self._states[robot]

    def _antenna(self, robot: Robot) -> Vec3:
        return antenna_position(robot, self._state(robot), self._world.arena.floor)

    def _link(self, one: str, other: str) -> tuple[float, int] | None:
        pair = _ordered(self._find(one), self._find(other))
        if pair is None:
            return None
        if pair not in self._now():
            self._links[pair] = self._compute([(self._antenna(pair[0]), self._antenna(pair[1]))])[0]
        return self._links[pair]

    def _compute(self, ends: Sequence[tuple[Vec3, Vec3]]) -> list[tuple[float, int]]:
        """Return the power [dBm] and the number of solids between pairs of positions."""
        out: list[tuple[float, int]] = []
        doors = self._world.door_angles()
        for first in range(0, len(ends), PAIR_BATCH_SIZE):
            lot = ends[first : first + PAIR_BATCH_SIZE]
            positions = np.zeros((2, PAIR_BATCH_SIZE, 3), np.float32)
            positions[:, : len(lot)] = np.swapaxes(np.array(lot, np.float32), 0, 1)
            power, walls = jax.device_get(self._run(*positions, doors))
            out += [(float(p), int(w)) for p, w in zip(power[: len(lot)], walls, strict=False)]
        return out


def _ordered(one: Robot | None, other: Robot | None) -> tuple[Robot, Robot] | None:
    """Return two robots in the order of their slots: a link is the same both ways."""
    if one is None or other is None:
        return None
    return (one, other) if one.slot <= other.slot else (other, one)


def _links(
    settings: RadioSettings, arena: ArenaSpec, start: jax.Array, end: jax.Array, doors: jax.Array
) -> tuple[jax.Array, jax.Array]:
    solids = with_boxes(arena_solids(arena), *door_boxes(arena, doors, jnp))
    walls = count_walls(solids, start, end)
    return received_power(settings, jnp.linalg.norm(end - start, axis=-1), walls), walls


def antenna_position(robot: Robot, state: RobotState, floor: float) -> Vec3:
    """Return where a robot's antenna is, as `comms.antenna.antenna_positions` does, without compiling [m]."""
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, np.array(flip_vector(antenna_of(robot.spec))), np.float64(state.quat))
    x, y, z = _vec3(turned + state.pos)
    return (x, y, max(z, floor + MIN_ANTENNA_HEIGHT))


def _vec3(values: Array) -> Vec3:
    x, y, z = (float(value) for value in values)
    return (x, y, z)


@contextmanager
def _on_cpu() -> Iterator[None]:
    """Compile for the CPU where there is one: a handful of pairs is not worth a trip to an accelerator."""
    try:
        device = jax.devices("cpu")[0]
    except RuntimeError:  # JAX was told to use the accelerator only
        yield
        return
    with jax.default_device(device):
        yield
