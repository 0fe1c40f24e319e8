"""Base class of tasks: data and small pure functions of one world, which `env.Env` maps over a batch.

`observe` sees what real sensors and the radio give; `evaluate` and `privileged` may see where everything
truly is.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.errors import SpecError
from usarmjx.base.registry import Registry
from usarmjx.base.settings import AT_LEAST_ONE, validate
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links
from usarmjx.comms.mail import Inboxes, MessageSettings
from usarmjx.engines import PhysicsState
from usarmjx.models.compile.physics import PHYSICS, Physics
from usarmjx.models.compile.randomization import DomainRandomization
from usarmjx.models.compile.victims import VictimTable
from usarmjx.models.drives.base import RobotState
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import Mount, RobotSpec
from usarmjx.sensors.base import Reading
from usarmjx.sim.actions import Actions
from usarmjx.sim.radio import mailboxes
from usarmjx.sim.ray_geometry import start_poses, victims_of
from usarmjx.sim.scene import Scene, build_scene
from usarmjx.sim.world import Stream, World, clock_of, episode_key, robot_states
from usarmjx.train.envs.layout import NO_VECTOR, ActionVector, ObservationLayout
from usarmjx.train.envs.presence import Presence
from usarmjx.train.envs.recipe import (
    SPARE_ROOM,
    Arenas,
    GeneratedArenas,
    resolve_arenas,
    spec_of,
    with_sensors,
)
from usarmjx.train.envs.state import Memory

ObservationArrays = tuple[jax.Array, ...]
"""Per agent group (worlds, robots, obs_size)."""
ActionArrays = tuple[jax.Array, ...]
"""Per agent group (worlds, robots, action_size)."""
Carry: TypeAlias = Any
"""A policy's own between two steps: any tree of arrays (worlds, ...)."""


@dataclass(frozen=True)
class Policy:
    """A policy of all groups of an environment.

    Attributes:
        initial_carry: Returns the carry at the start of an episode, for a number of worlds.
        act: Returns the carry and the actions from the carry, the observations and a random key. It is pure.
    """

    initial_carry: Callable[[int], Carry]
    act: Callable[[Carry, ObservationArrays, jax.Array], tuple[Carry, ActionArrays]]


TimeLimit = Literal["end", "truncation"]
"""Meaning of the time limit: the end of an episode, or a mere cut."""


class TeamMaps(NamedTuple):
    """Maps that the robots of a task are building.

    Attributes:
        low: x and y of the middle of their first square [m].
        cell: Side of a square [m].
        squares: State of each square in the robots' maps, as in `mapping.maps` (robots, i, j).
    """

    low: tuple[float, float]
    cell: float
    squares: jax.Array


class TaskView(struct.PyTreeNode, kw_only=True):
    """View of one world for a task's functions at one moment. Groups are numbered as `scene.groups`.

    Attributes:
        world: Everything but the physics: arena, commands, sensors' memory, links, mail, status.
        physics: Positions and velocities.
        readings: Per group and sensor what it last reported (robots, ...).
        scene: The scene of the world.
    """

    world: World
    physics: PhysicsState
    readings: tuple[tuple[Reading, ...], ...]
    scene: Scene = struct.field(pytree_node=False)

    @property
    def time(self) -> jax.Array:
        """Simulated time since the episode began [s] ()."""
        return jnp.asarray(clock_of(self.scene, self.world).seconds)

    @property
    def key(self) -> jax.Array:
        """A random key of this moment, for tasks that draw at every step."""
        # A stream of its own: what tasks draw here changes no other random numbers.
        return jax.random.fold_in(episode_key(self.world, Stream.TASK_STEP), self.world.step)

    def sensor(self, group: int, kind: str) -> jax.Array:
        """Return the last reading of the first sensor of a type (robots, ...), as in `sensors`.

        Raises:
            UnknownNameError: The robots have none, or the task does not ask for it; lists those there are.
        """
        return jnp.asarray(self.readings[group][self.scene.groups[group].suite.index(kind)].value)

    def is_fresh(self, group: int, kind: str) -> jax.Array:
        """Return whether that was measured now, not at an earlier scan (robots,)."""
        return jnp.asarray(self.readings[group][self.scene.groups[group].suite.index(kind)].fresh)

    def robots(self, group: int) -> RobotState:
        """Return the true states of a group's robots; leading axis over them. Not for `observe`."""
        return robot_states(self.scene.groups[group], self.physics)

    @property
    def links(self) -> Links:
        """The radio links as they are now.

        Raises:
            SpecError: The task has no radio.
        """
        if self.world.links is None:
            raise SpecError("this task has no radio: give it a radio=RadioSettings(...)")
        return self.world.links

    @property
    def mail(self) -> Inboxes:
        """Messages received since the last observation, by slot.

        Raises:
            UsageError: The task has no mail.
        """
        return mailboxes(self.scene, self.world)

    @property
    def starts(self) -> jax.Array:
        """Start poses of the world's arena: x, y, z [m] above its floor, yaw [rad] (starts, 4)."""
        return jnp.asarray(start_poses(self.scene, self.world.arena_state))

    @property
    def victims(self) -> VictimTable:
        """The victims of the world's arena. Not for `observe`."""
        return victims_of(self.scene, self.world.arena_state)


class StepResult(NamedTuple):
    """Evaluation of a step by the task.

    Attributes:
        memory: The task's memory from now on.
        reward: Per group (robots,).
        terminated: Whether the episode is over, for a reason other than time ().
        score: The task's score of the episode so far ().
        metrics: Numbers to look at, the same names always, () each.
    """

    memory: Memory
    reward: tuple[jax.Array, ...]
    terminated: jax.Array
    score: jax.Array
    metrics: dict[str, jax.Array]


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """A task: its fields are what `make` lets one override; its functions are pure and of one world.

    Agent groups are those of `scene.groups` whose robots are agents, in that order.

    Attributes:
        about: Description in a sentence.
        needs_solver: The part of it that needs an engine with a contact solver, which `planar` lacks.
        arena: Arenas: a name or description of one, several of them, `GeneratedArenas`, the name of a kind of
            generated arenas (`maze`), or `floor`, which is empty.
        sensors: Types of sensors that the robots keep, and mounts that each is given; None: all their own.
        physics: Solver and time settings, or their name in `PHYSICS`.
        repeat: Control steps per action. `make` changes it where it sets other physics, so that an action
            lasts as long.
        episode_steps: Actions until the time is up.
        time_limit: Effect of the time limit on learners. `end`: the limit is part of the task; agents observe
            the time that is left, and learners count no reward after it. `truncation`: the limit only cuts
            the episode; learners add the estimated value of its last state.
        radio: Constants of the robots' radios; None: they have none.
        mail: Sizes of the messages over the radio; None: there are none.
        shuffle: Draw start poses at each reset instead of taking them in the arena's order.
        vary: Domain randomization between worlds and episodes; None: none.
    """

    about: ClassVar[str] = ""
    needs_solver: ClassVar[str] = ""
    decides: ClassVar[bool] = False
    """Whether the task remembers actions, see `decide`."""
    reports_itself: ClassVar[bool] = False
    """Whether no message of `act` depends on actions: robots that clients drive send theirs, too."""

    arena: Arenas = "floor"
    sensors: tuple[str | Mount, ...] | None = None
    physics: Physics | str = "reference"
    repeat: Annotated[int, AT_LEAST_ONE] = 10
    episode_steps: Annotated[int, AT_LEAST_ONE] = 100
    time_limit: TimeLimit = "truncation"
    radio: RadioSettings | None = None
    mail: MessageSettings | None = None
    shuffle: bool = True
    vary: DomainRandomization | None = None

    def __post_init__(self) -> None:
        """Check the settings; a subclass with a `__post_init__` of its own calls this one.

        Raises:
            SpecError: A value that is not allowed; names the field and what is.
        """
        validate(self)

    @property
    @abstractmethod
    def robots(self) -> Sequence[str | RobotSpec]:
        """The roster: class names or descriptions, in slot order."""

    @property
    def equipment(self) -> Sequence[str | Mount] | None:
        """The sensors that are read: types that each robot keeps, mounts that it is given; None: all."""
        return self.sensors

    @property
    def arenas(self) -> Arenas:
        """The arenas, names that only tasks know resolved; generated ones are for the first robot."""
        return resolve_arenas(self.arena, spec_of(self.robots[0]).name, len(self.robots))

    @property
    def physics_settings(self) -> Physics:
        """The solver and time settings."""
        return PHYSICS.get(self.physics) if isinstance(self.physics, str) else self.physics

    @property
    def scripted(self) -> Sequence[str]:
        """Classes of robots that are no agents: those that cannot drive, unless a task says more."""
        return ("ComStation",)

    def scene(self) -> Scene:
        """Return the scene.

        Raises:
            UsageError: See `build_scene`.
        """
        robots = with_sensors(self.robots, self.equipment)
        arenas, spare = self.arenas, 0.0
        if isinstance(arenas, GeneratedArenas):
            # Room in the arrays for arenas that are generated later and may have more solids.
            arenas, spare = arenas.arenas(), SPARE_ROOM * arenas.renewable
        physics = self.physics_settings
        scene = build_scene(
            arenas, robots, physics, radio=self.radio, mail=self.mail, vary=self.vary, spare=spare
        )
        if scene.arenas is None:
            return scene
        # After the scene is built, as notes may need its groups.
        notes = self.arena_notes(scene, scene.arenas.arenas)
        return replace(scene, arenas=replace(scene.arenas, states=scene.arenas.states.replace(notes=notes)))

    def arena_notes(self, scene: Scene, arenas: Sequence[ArenaSpec]) -> dict[str, np.ndarray]:
        """Return the task's notes on arenas beside their state in the worlds, by name (arenas, ...).

        Worlds have it as `arena_state.notes`; by default it is nothing.

        Args:
            scene: The scene, so far.
            arenas: The arenas of the worlds, or those that replace them later.
        """
        del scene, arenas
        return {}

    def agent_groups(self, scene: Scene) -> tuple[int, ...]:
        """Return which of `scene.groups` are agents, by index."""
        # Names of classes match without case, as in USARSim.
        idle = {name.lower() for name in self.scripted}
        return tuple(g for g, group in enumerate(scene.groups) if group.robot.name.lower() not in idle)

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """Return the action size of each agent group; actions are numbers from -1 to 1."""
        return tuple(len(drive_keys(scene.groups[group].robot)) for group in self.agent_groups(scene))

    @property
    def rivals(self) -> tuple[int, ...]:
        """Agents of the only group that play against the others, by index; by default there are none.

        A league drives them by past policies of the others, see `Config.league`.
        """
        return ()

    @property
    def discrete(self) -> bool:
        """Whether actions are choices, see `AgentGroup.discrete`; by default they are not."""
        return False

    @property
    def vector(self) -> ActionVector:
        """Numbers of an action behind those of its choices, see `AgentGroup.vector`; by default none."""
        return NO_VECTOR

    @property
    def turn_length(self) -> int:
        """Steps for which actions are of one of two kinds in turn; 0: all are of one kind, as by default."""
        return 0

    def layout(self, scene: Scene) -> ObservationLayout | None:
        """Return the parts of an observation, see `AgentGroup.layout`; by default they are not known."""
        del scene
        return None

    def decide(self, view: TaskView, memory: Memory, actions: tuple[jax.Array, ...]) -> Memory:
        """Return the task's memory of actions, before `act`; by default nothing of them.

        It is called if the class says that it `decides`. Arguments are those of `act`.
        """
        del view, actions
        return memory

    def act(self, view: TaskView, memory: Memory, actions: tuple[jax.Array, ...]) -> Actions:
        """Return the commands of the robots until the next action.

        By default each action is a share of what a key of DRIVE can do.

        Args:
            view: The world.
            memory: The task's memory.
            actions: Per group (robots, action_size), finite and from -1 to 1.
        """
        del memory
        groups = zip(self.agent_groups(view.scene), actions, strict=True)
        return Actions(
            drive={group: drive_all(view.scene.groups[group].robot, action) for group, action in groups}
        )

    def privileged(self, view: TaskView, memory: Memory) -> jax.Array:
        """Return the critics' privileged observations (privileged_size,); by default none."""
        del view, memory
        return jnp.zeros(0)

    def team(self, scene: Scene, key: jax.Array) -> jax.Array | None:
        """Return which robots an episode begins with, by slot (robots,); by default None: all of them.

        Args:
            scene: The scene.
            key: A key of that episode.
        """
        del scene, key
        return None

    def presence(self, view: TaskView, memory: Memory) -> Presence | None:
        """Return which robots take part from now on; by default None: all of them, always.

        It is called at the start of an episode and after each action. A robot that is not present any more is
        parked; one that is present again joins at its start pose, and is alive after the next action.
        """
        del view, memory
        return None

    def started_at(self, memory: Memory, steps: jax.Array) -> Memory:
        """Return the memory of episodes that count as begun some steps ago, so that they end so much earlier.

        A task that counts its own steps sets its count. By default nothing changes.

        Args:
            memory: Memory of all worlds at the start of their episodes (worlds, ...).
            steps: Steps before (worlds,).
        """
        del steps
        return memory

    @property
    def for_baseline(self) -> "Task":
        """This task with all in view that its baseline drives by; by default itself."""
        return self

    def baseline_obs(self, scene: Scene, memory: Memory, obs: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        """Return the agents' observations in `for_baseline`, per group (robots, obs_size).

        A teacher sees them, the policy does not. By default they are those of all agents.

        Args:
            scene: The scene.
            memory: The task's memory.
            obs: Observations in this task, per group (robots, obs_size).
        """
        del scene, memory
        return obs

    def maps(self, scene: Scene, memory: Memory) -> TeamMaps | None:
        """Return the maps that the robots are building, by slot; None: they build none."""
        del scene, memory
        return None

    @abstractmethod
    def start(self, view: TaskView, key: jax.Array) -> Memory:
        """Return the task's memory at the start of an episode, from a key of that episode."""

    @abstractmethod
    def observe(self, view: TaskView, memory: Memory) -> tuple[jax.Array, ...]:
        """Return the observations of the agents, per group (robots, obs_size)."""

    @abstractmethod
    def evaluate(self, view: TaskView, memory: Memory) -> StepResult:
        """Return the evaluation of the step that ended with this view."""


def drive_keys(robot: RobotSpec) -> tuple[str, ...]:
    """Return the keys of DRIVE that do something to a robot, in their order."""
    # An action without effect would only add variance to the policy's gradient.
    return tuple(key for key, limit in robot.drive.full_scale.items() if limit > 0)


def drive_all(robot: RobotSpec, actions: jax.Array) -> dict[str, jax.Array]:
    """Return numbers for `drive_keys` (...) from actions from -1 to 1 (..., keys)."""
    full = robot.drive.full_scale
    return {key: actions[..., i] * full[key] for i, key in enumerate(drive_keys(robot))}


TASKS: Registry[Task] = Registry("task", versioned=True)
"""Tasks by name, each with its default settings; a bare name is that of the newest version."""
