"""Replay of recordings: the same inputs at the same steps must give the same world to the bit."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.transforms import Vec3
from usarmjx.recording.inputs import (
    SINGLE,
    ConveyorsSet,
    Input,
    Interrupted,
    LooseAdded,
    LoosePlaced,
    LooseRemoved,
    OrdersGiven,
    RobotAdded,
    RobotPlaced,
    RobotRedescribed,
    RobotRemoved,
    StepState,
    VacuumSet,
    WorldReset,
    WorldSetup,
    versions,
)
from usarmjx.recording.reader import Recording
from usarmjx.sim.batch import Batch, BatchState, put_robot
from usarmjx.sim.calibration import build_calibrated
from usarmjx.sim.configure import update_robot_spec
from usarmjx.sim.scene import Scene, build_scene
from usarmjx.sim.single_world import SingleWorld

PARTS = ("qpos", "qvel", "act")
"""Compared arrays of the physics."""
WORDS = {"qpos": "position", "qvel": "velocity", "act": "servo"}
"""Names of the arrays in reports."""


@dataclass(frozen=True)
class ReplayResult:
    """Result of a replay.

    Attributes:
        steps: Control steps that are the same.
        difference: The first difference, in words; empty without one.
        note: Further information, in words.
    """

    steps: int
    difference: str = ""
    note: str = ""


class _Replayed(Protocol):
    """A world that is replayed."""

    @property
    def scene(self) -> Scene: ...

    def apply(self, given: Input) -> None: ...

    def step(self) -> None: ...

    def state(self) -> Mapping[str, np.ndarray]: ...


class _ReplayedSingle:
    """A `SingleWorld` that is replayed."""

    def __init__(self, setup: WorldSetup) -> None:
        (arena,) = setup.arenas
        # Without robots: they come with the recorded inputs, at their steps.
        scene = build_scene(arena, (), setup.physics)
        self._world = SingleWorld(scene, setup.seed, setup.number, setup.seats)

    @property
    def scene(self) -> Scene:
        return self._world.scene

    def apply(self, given: Input) -> None:
        world = self._world
        match given:
            case RobotAdded():
                try:
                    world.add(given.robot, given.name, given.poses)
                except UsageError:
                    return  # the recorded world had no room, either
            case RobotRemoved():
                world.remove(given.slot)
            case RobotRedescribed():
                update_robot_spec(world, given.slot, given.robot)
            case RobotPlaced():
                world.move_robot(given.slot, _position(given.pos), given.quat)
            case LooseAdded() | LooseRemoved() | LoosePlaced() | ConveyorsSet() | VacuumSet():
                self._change_things(given)
            case WorldReset():
                world.reset()
            case OrdersGiven():
                for slot, order in given.orders.items():
                    world.edit(slot, **order)
            case _:
                pass  # inputs of batches

    def _change_things(
        self, given: LooseAdded | LooseRemoved | LoosePlaced | ConveyorsSet | VacuumSet
    ) -> None:
        match given:
            case VacuumSet():
                self._world.suck(given.slot, given.effecter, closes=given.closes)
            case ConveyorsSet():
                self._world.set_conveyors(given.share, given.name)
            case LooseAdded():
                with suppress(UsageError):  # the recorded world had no room, either
                    self._world.add_loose(given.thing, held=given.held)
            case LooseRemoved():
                self._world.remove_loose(given.number)
            case LoosePlaced():
                self._world.move_loose(given.number, _position(given.pos), given.quat)

    def step(self) -> None:
        self._world.step()

    def state(self) -> Mapping[str, np.ndarray]:
        data = self._world.engine.data
        return {part: np.asarray(getattr(data, part)) for part in PARTS}


def _position(pos: np.ndarray) -> Vec3:
    x, y, z = pos.tolist()
    return x, y, z


def state_arrays(state: BatchState) -> list[Any]:
    """Return the arrays of a batch's physics and worlds; random keys as their data."""
    worlds, arena = state.worlds, state.worlds.arena_state
    # Typed keys have no bytes of their own.
    keyed = worlds.replace(key=jax.random.key_data(worlds.key))
    if arena is not None:  # notes are a task's own
        keyed = keyed.replace(arena_state=arena.replace(notes={}))
    return jax.tree.leaves((state.physics, keyed))


class ReplayedBatch:
    """A world of a batch, replayed with all the others, which have no inputs."""

    def __init__(self, setup: WorldSetup) -> None:
        arena = setup.arenas[0] if len(setup.arenas) == 1 else setup.arenas
        self.scene = build_scene(
            arena,
            setup.roster,
            setup.physics,
            radio=setup.radio,
            mail=setup.mail,
            vary=setup.vary,
            spare=setup.spare,
        )
        scene, seed, first, shuffle = self.scene, setup.seed, setup.first, setup.shuffle
        # Engine planar needs figures of each robot; those that are missing here are measured first.
        self._batch = build_calibrated(
            lambda: Batch(scene, setup.worlds, engine=setup.kind, seed=seed, first=first, shuffle=shuffle)
        )
        self._number, self._repeat, self._state = setup.number, setup.repeat, self._batch.reset()
        if setup.start is not None:
            engine, everywhere = self._batch.engine, jnp.ones(setup.worlds, bool)
            # All worlds start so, as only the recorded one is compared.
            start = jnp.tile(jnp.asarray(setup.start), (setup.worlds, 1))
            self._state = self._state.replace(physics=engine.reset(engine.start(), everywhere, start))
        self._reset_bad = setup.reset_bad
        if setup.snapshot:
            self.restore(setup.snapshot)
        # Steps before the recording began: the state then follows from them and need not be stored.
        for _ in range(setup.steps_before):
            self._state = self._batch.step(self._state)

    @property
    def batch(self) -> Batch:
        """The batch."""
        return self._batch

    @property
    def batch_state(self) -> BatchState:
        """Its present state."""
        return self._state

    def restore(self, arrays: Sequence[np.ndarray]) -> None:
        """Set the state of the batch; see `state_arrays`.

        Raises:
            UsageError: The arrays are of another scene or version.
        """
        state = self._state
        known = state_arrays(state)
        wanted, given = ([(np.shape(one), np.dtype(one.dtype)) for one in some] for some in (known, arrays))
        if wanted != given:
            raise UsageError("the state that the recording begins with is of another version or scene")
        arena = state.worlds.arena_state
        blank = state.worlds.replace(key=jax.random.key_data(state.worlds.key))
        if arena is not None:
            blank = blank.replace(arena_state=arena.replace(notes={}))
        # An engine of the host keeps its physics in NumPy arrays that it writes to, all others in JAX's.
        host = isinstance(jax.tree.leaves(state.physics)[0], np.ndarray)
        count, tree = len(jax.tree.leaves(state.physics)), jax.tree.structure((state.physics, blank))
        as_here = [np.array(one) if host and i < count else jnp.asarray(one) for i, one in enumerate(arrays)]
        physics, worlds = jax.tree.unflatten(tree, as_here)
        worlds = worlds.replace(key=jax.random.wrap_key_data(worlds.key))
        if arena is not None:
            worlds = worlds.replace(arena_state=worlds.arena_state.replace(notes=arena.notes))
        self._state = state.replace(physics=physics, worlds=worlds)

    def apply(self, given: Input) -> None:
        """Apply an input."""
        match given:
            case RobotPlaced():
                where = self._number, given.slot, given.pos, given.quat
                self._state = put_robot(self._batch, self._state, *where)
            case WorldReset():
                here = np.arange(self._batch.worlds) == self._number
                self._state = self._batch.reset_where(self._state, jnp.asarray(here))
            case OrdersGiven():
                for slot, order in given.orders.items():
                    self._order(slot, order)
            case _:
                pass  # inputs of worlds of engine c

    def _order(self, slot: int, order: Mapping[str, Any]) -> None:
        group, member = self.scene.group_of(slot)
        state, at = self._state.worlds.groups[group], (self._number, member)
        new = {
            name: jax.tree.map(lambda old, value: old.at[at].set(value), getattr(state, name), value)
            for name, value in order.items()
        }
        self._state = self._batch.with_group(self._state, group, state.replace(**new))

    def step(self) -> None:
        """Make the control steps of a call."""
        batch = self._batch
        if not self._reset_bad:
            self._state = batch.run(self._state, self._repeat, reset_bad=False)
            return
        # As it was recorded: compiled as one, steps are rounded otherwise than one by one.
        self._state = batch.step(self._state) if self._repeat == 1 else batch.run(self._state, self._repeat)

    def state(self) -> Mapping[str, np.ndarray]:
        """Return the physics of the world: `PARTS` by name."""
        physics = self._batch.physics(self._state)
        return {part: np.asarray(getattr(physics, part))[self._number] for part in PARTS}


def check_recording(recording: Recording, number: int) -> ReplayResult:
    """Replay a world of a recording, and compare every control step.

    Args:
        recording: The recording.
        number: Number of the world.

    Raises:
        UsageError: The recording cannot be replayed; gives the reason.
    """
    setup = recording.setup(number)
    if setup.why_not:
        raise UsageError(f"{recording.path}: world {number} cannot be computed again: {setup.why_not}")
    replayed: _Replayed = _ReplayedSingle(setup) if setup.kind == SINGLE else ReplayedBatch(setup)
    steps = 0
    for message in recording.messages(("inputs", "states"), number):
        if isinstance(message.value, Interrupted):
            why = f"from {message.time:.2f} s on nothing is: {message.value.reason}"
            return ReplayResult(steps, _damage(recording), why)
        if not isinstance(message.value, StepState):
            replayed.apply(message.value)
            continue
        # Inputs are written before the state of the step that they act in.
        while steps < message.value.step:
            replayed.step()
            steps += setup.repeat
        found = first_difference(replayed.scene, message.value, replayed.state())
        if found:
            return ReplayResult(steps - setup.repeat, difference=found, note=_other_versions(setup))
    return ReplayResult(steps, _damage(recording))


def _damage(recording: Recording) -> str:
    """Return what cannot be compared, in words; empty if all can be."""
    damaged = recording.damaged
    return f"{damaged} damaged parts cannot be compared" if damaged else ""


def _other_versions(setup: WorldSetup) -> str:
    """Return the versions that differed when a world was recorded, in words."""
    here = versions()
    others = [
        f"{name} {version}, here {here.get(name)}"
        for name, version in setup.versions.items()
        if here.get(name) != version
    ]
    return f"recorded with {'; '.join(others)}" if others else ""


def first_difference(scene: Scene, recorded: StepState, computed: Mapping[str, np.ndarray]) -> str:
    """Return the first number that is not the same to the bit, in words; empty if all are.

    Args:
        scene: The replayed scene.
        recorded: The recorded state.
        computed: The replayed state: `PARTS` by name.
    """
    when = f"at {recorded.time:.2f} s (step {recorded.step})"
    for part in PARTS:
        before, now = np.asarray(getattr(recorded, part)), computed[part]
        if before.shape != now.shape or before.dtype != now.dtype:
            return f"{when}: {before.shape[0]} numbers of {part} recorded, {now.shape[0]} computed"
        # Bytes, not numbers: -0.0 equals 0.0, and a NaN does not equal itself.
        differs = np.frombuffer(before.tobytes(), np.uint8) != np.frombuffer(now.tobytes(), np.uint8)
        if differs.any():
            index = int(np.argmax(differs)) // before.itemsize
            owner = _owner(scene, part, index)
            values = f"{before[index]!r} recorded, {now[index]!r} computed".replace("np.float", "float")
            return f"{when}: {owner}, {WORDS[part]}: {values}"
    return ""


def _owner(scene: Scene, part: str, index: int) -> str:
    """Return robot and joint of a number."""
    model = scene.model
    if part == "act":
        name = model.actuator(int(np.argmax(model.actuator_actadr == index))).name
    else:
        addresses = model.jnt_qposadr if part == "qpos" else model.jnt_dofadr
        # A joint may have several numbers: the last address up to the index is its own.
        joint = int(np.searchsorted(addresses, index, side="right")) - 1
        name = model.joint(joint).name or model.body(int(model.jnt_bodyid[joint])).name
    # Names of robots' parts begin with the slot's prefix, as of `scene.prefix_of`.
    owner, _, rest = name.partition("/")
    if owner[:1] == "r" and owner[1:].isdecimal():
        entry = scene.roster[int(owner[1:])]
        joint_name = "its pose" if rest == "root" else f"joint {rest}"
        return f"{entry.name or entry.spec.name + owner[1:]}, {joint_name}"
    return name
