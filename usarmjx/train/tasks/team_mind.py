"""A team that chooses goals, outside a simulator: from sensors, links and messages to wheels and messages.

A controller of robots elsewhere, as one over TCP, feeds it with what these robots report. It runs the code of
the task, so that a policy sees what it saw in training. Rows are by slot: the base first, then the robots.
A row depends on its own robot's readings, and on messages that have come for it.
"""

from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.errors import UsageError
from usarmjx.comms.links import Links, no_links
from usarmjx.comms.mail import Inboxes, empty_inboxes
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.sensors.base import Reading
from usarmjx.sim.radio import mail_of
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.task import TaskView
from usarmjx.train.mapping.belief import HEADER_SIZE
from usarmjx.train.tasks.goal_team import GoalTeam
from usarmjx.train.tasks.messages import decode, encode
from usarmjx.train.tasks.team import TeamMemory

Extent = tuple[tuple[float, float], tuple[float, float]]
SENSORS = frozenset({"INS", "RangeScanner"})


class Heard(struct.PyTreeNode, kw_only=True):
    """Information that has come to the robots; it stands in for a world.

    Attributes:
        seconds: The time [s] ().
        links: Their links, as far as they know.
        mail: Their boxes.
    """

    seconds: jax.Array
    links: Links
    mail: Inboxes


class HeardView(TaskView):
    """View of robots that are elsewhere: no state of theirs is known."""

    world: Any
    physics: Any = ()

    @property
    def time(self) -> jax.Array:
        """Time since the episode began [s] ()."""
        return self.world.seconds


class Report(NamedTuple):
    """Report of the robots before an action.

    Attributes:
        seconds: The time since the episode began [s].
        poses: Poses by their INS: x, y [m], yaw [rad], y to the left (robots, 3).
        ranges: Scans of those with a scanner, all but the base [m] (scanners, beams).
        power: Power received, -inf where there is none [dBm] (robots, robots).
        letters: Of each message that has come: receiver, sender, time of sending [s], contents (numbers,).
    """

    seconds: float
    poses: np.ndarray
    ranges: np.ndarray
    power: np.ndarray
    letters: list[tuple[int, int, float, np.ndarray]]


@dataclass(frozen=True)
class Orders:
    """Commands to the robots.

    Attributes:
        seen: Their observations, those of the robots that move (robots - 1, n).
        wheels: Speeds of their left and right wheels [rad/s] (robots - 1, 2).
        letters: The message of each, the base's first (robots, numbers).
        receivers: Robots that it is for, of those that it can reach (robots, robots).
    """

    seen: np.ndarray
    wheels: np.ndarray
    letters: np.ndarray
    receivers: np.ndarray


class TeamMind:
    """The beliefs and decisions of a team.

    Args:
        task: The task; its arena counts for nothing.
        extent: The site, x and y in our axes [m]: maps cover it. Walls of generated buildings are drawn best
            if its corner is theirs.

    Raises:
        UsageError: A task whose robots need other sensors, or that choose no goals.
    """

    def __init__(self, task: GoalTeam, extent: Extent) -> None:
        robots = 1 + task.count
        (x0, x1), (y0, y1) = extent
        # A scene wants a start pose for each robot; the true ones are in the first report.
        starts = tuple(
            StartPose(tag=f"S{i}", at=(x0 + (x1 - x0) * (i + 0.5) / robots, (y0 + y1) / 2, 0.2), yaw=0.0)
            for i in range(robots)
        )
        site = ArenaSpec(name="site", starts=starts, extent=extent)
        # Nothing is simulated: an oracle has no walls to read, and all robots of the task are there.
        self.task = replace(task, arena=site, oracle=False, least_robots=0)
        self.scene: Scene = self.task.scene()
        kinds = {sensor.kind for group in self.scene.groups for sensor in group.suite.sensors}
        if kinds - SENSORS or not task.discrete:
            need = f"sensors {', '.join(sorted(kinds))}, actions={task.actions}"
            raise UsageError(f"a team outside a simulator has INS and RangeScanner, and goals; here: {need}")
        self._memory: TeamMemory | None = None
        # Compiled once for all episodes: the memory has the same shapes from the first step on.
        self._see = jax.jit(self._seen)
        self._begin = jax.jit(self._begun)
        self._obey = jax.jit(self._obeyed)
        self._show = jax.jit(self._observe)

    def another(self) -> "TeamMind":
        """Return the mind of another team on the same site, without compiling anew; it knows nothing yet."""
        # The compiled functions are bound to the first mind, but read only the task and the scene.
        other = copy(self)
        other._memory = None
        return other

    @property
    def letter_size(self) -> int:
        """Numbers of a message."""
        return self.task.letter_size(self.scene)

    def encoded(self, letter: np.ndarray) -> bytes:
        """Return the bytes of a message (numbers,): a whole map, or its parts as `messages` counts them."""
        return encode(letter, self.task.message_floats) if self.task.parts else letter.astype("<f4").tobytes()

    def decoded(self, data: bytes) -> np.ndarray:
        """Return the message of some bytes (numbers,).

        Raises:
            ValueError: They are no message of this team.
        """
        if self.task.parts:
            floats = self.task.message_floats
            return decode(data, self.letter_size - HEADER_SIZE - floats, floats)
        # Byte order of the wire, on machines of either order.
        letter = np.frombuffer(data, "<f4")
        if len(letter) != self.letter_size:
            raise ValueError(f"a message of {len(letter)} numbers, expected {self.letter_size}")
        return letter

    @property
    def squares(self) -> np.ndarray:
        """The maps of all, see `mapping.maps` (robots, i, j)."""
        return np.asarray(self._told.belief.squares)

    @property
    def _told(self) -> TeamMemory:
        assert self._memory is not None  # as `see` comes first
        return self._memory

    def see(self, report: Report) -> np.ndarray:
        """Take in a report, the first of which begins an episode; return observations (robots - 1, n)."""
        view = self._view(report)
        if self._memory is None:
            self._memory = self._begin(view)
        else:
            self._memory = self._see(view, self._memory)
        self._now = view
        return np.asarray(self._show(view, self._memory))

    def obey(self, seen: np.ndarray, choices: np.ndarray) -> Orders:
        """Return orders for the robots after they chose (robots - 1, choices)."""
        self._memory, *orders = self._obey(self._now, self._told, jnp.asarray(choices, jnp.float32))
        return Orders(seen, *map(np.asarray, orders))

    def _observe(self, view: HeardView, memory: TeamMemory) -> jax.Array:
        return self.task.observations(view, memory)[1:]

    def _view(self, report: Report) -> HeardView:
        scene, robots = self.scene, self.scene.num_robots
        poses = np.zeros((robots, 6), np.float32)
        # Sensors report x, y, z, roll, pitch, yaw; robots elsewhere are taken to stand level.
        poses[:, (0, 1, 5)] = report.poses
        # INS first, then the scanner, as `equip.mapping_robot` mounts them.
        readings = (
            (_reading(poses[:1]),),
            (_reading(poses[1:]), _reading(np.asarray(report.ranges, np.float32))),
        )
        radio = scene.radio
        assert radio is not None  # as tasks of this kind have one
        links = no_links(robots).replace(
            power=jnp.asarray(report.power, jnp.float32), in_range=jnp.asarray(report.power >= radio.cutoff)
        )
        box = Heard(
            seconds=jnp.asarray(report.seconds, jnp.float32),
            links=links,
            mail=_boxes(scene, report.letters),
        )
        return HeardView(world=box, readings=readings, scene=scene)

    def _begun(self, view: HeardView) -> TeamMemory:
        """Return the memory at the start; nothing of the building is known."""
        task, zero = self.task, jnp.zeros(())
        nothing = jnp.zeros(task.arena_grid(view.scene).shape, bool)
        memory = TeamMemory(
            belief=task.update_belief(view, task.first_belief(view), mail=False),
            step=jnp.zeros((), jnp.int32),
            skipped=jnp.zeros((), jnp.int32),
            reachable=nothing,
            explored=nothing,
            touching=jnp.zeros(view.scene.num_robots, bool),
            contacts=zero,
            unlinked=zero,
            score=zero,
        )
        memory = memory.replace(extra=task.first_state(view, memory))
        return task.offered(view, task.noticed(view, memory))

    def _seen(self, view: HeardView, memory: TeamMemory) -> TeamMemory:
        belief = self.task.update_belief(view, memory.belief)
        memory = memory.replace(belief=belief, step=memory.step + 1)
        return self.task.offered(view, self.task.noticed(view, memory))

    def _obeyed(
        self, view: HeardView, memory: TeamMemory, choices: jax.Array
    ) -> tuple[TeamMemory, jax.Array, jax.Array, jax.Array]:
        memory = self.task.decide(view, memory, (choices,))
        orders = self.task.act(view, memory, (choices,))
        (sides,) = orders.drive.values()
        assert orders.messages is not None  # as the scene has mail
        wheels = jnp.stack([sides["Left"], sides["Right"]], -1)
        return memory, wheels, jnp.asarray(orders.messages.payload), jnp.asarray(orders.messages.receivers)


def _reading(value: np.ndarray) -> Reading:
    # A report holds what was read for it: nothing is left from an earlier scan.
    return Reading(value=jnp.asarray(value), fresh=jnp.ones(len(value), bool))


def _boxes(scene: Scene, letters: list[tuple[int, int, float, np.ndarray]]) -> Inboxes:
    """Return boxes with letters; those for which there is no room are lost."""
    settings, robots = mail_of(scene), scene.num_robots
    count = np.zeros(robots, np.int32)
    sender = np.zeros((robots, settings.capacity), np.int32)
    time = np.zeros((robots, settings.capacity), np.float32)
    payload = np.zeros((robots, settings.capacity, settings.numbers), np.float32)
    # In order of sending, as the network may mix them up; arrays themselves have no order.
    for receiver, other, sent, numbers in sorted(letters, key=lambda one: one[:3]):
        place = int(count[receiver])
        if place == settings.capacity:
            continue
        sender[receiver, place], time[receiver, place] = other, sent
        payload[receiver, place], count[receiver] = numbers, place + 1
    return empty_inboxes(settings, robots).replace(
        count=jnp.asarray(count),
        sender=jnp.asarray(sender),
        time=jnp.asarray(time),
        payload=jnp.asarray(payload),
    )
