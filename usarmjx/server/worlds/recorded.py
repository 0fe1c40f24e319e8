"""What served worlds tell their recorders, and what they were made of."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from usarmjx.recording.file import RecordingFile
from usarmjx.recording.inputs import SINGLE, WorldSetup
from usarmjx.recording.recorder import Look, WorldRecorder
from usarmjx.recording.versions import versions
from usarmjx.sim.batch import Batch

if TYPE_CHECKING:
    import mujoco

    from usarmjx.engines.base import PhysicsState
    from usarmjx.server.worlds.robot import Robot
    from usarmjx.server.worlds.served_world import ServedWorld
    from usarmjx.sim.world import GroupState

ORDER_FIELDS = ("command", "active", "battery_start", "drowned")
"""Fields of a `GroupState` by which worlds of a batch are told what to do."""


def record_worlds(worlds: "Sequence[ServedWorld]", path: Path) -> RecordingFile:
    """Record served worlds, from now on, in a file that is to be closed at the end.

    Raises:
        UsageError: The file is there already.
        WriteError: It cannot be written.
    """
    about = {**versions(), "arenas": ", ".join(dict.fromkeys(world.arena.name for world in worlds))}
    file = RecordingFile(path, about, several=len(worlds) > 1)
    for number, world in enumerate(worlds):
        world.recorder = WorldRecorder(file, world.setup(), number)
    return file


def single_setup(world: "ServedWorld", origin: tuple[int, int, int]) -> WorldSetup:
    """Return what a world of engine `c` was made of, by its seed, its number and its seats."""
    seed, number, seats = origin
    return WorldSetup(
        kind=SINGLE,
        arenas=(world.arena,),
        physics=world.scene.physics,
        seed=seed,
        number=number,
        seats=seats,
        versions=versions(),
        why_not="it had begun before the recording did" if world.robots or world.time else "",
    )


def batch_setup(batch: Batch, number: int, steps_before: int) -> WorldSetup:
    """Return what a batch was made of, of which one world is recorded."""
    scene = batch.scene
    seed, first, shuffle = batch.origin
    return WorldSetup(
        kind=batch.engine.name,
        arenas=(scene.arena,) if scene.arenas is None else tuple(scene.arenas.arenas),
        physics=scene.physics,
        roster=scene.roster,
        radio=scene.radio,
        mail=scene.mail,
        vary=scene.vary,
        shuffle=shuffle,
        seed=seed,
        first=first,
        number=number,
        worlds=batch.worlds,
        steps_before=steps_before,
        versions=versions(),
    )


def record_step(
    world: "ServedWorld", physics: "PhysicsState | mujoco.MjData", time: float | None = None
) -> None:
    """Tell a world's recorder that a control step was made.

    Args:
        world: The world.
        physics: Its physics, with all digits.
        time: Simulated time, where the world does not know yet [s].
    """
    recorder = world.recorder
    if recorder is None:
        return
    qpos, qvel, act = (np.asarray(one) for one in (physics.qpos, physics.qvel, physics.act))
    recorder.stepped(world.time if time is None else time, qpos, qvel, act)
    if recorder.frame_is_due:
        state, seen = world.one_world()
        recorder.look(
            Look(
                scene=world.scene,
                world=state,
                physics=seen,
                names={slot: robot.name for slot, robot in world.robots.items()},
                trace=world.traces.sketch() if world.traces.points else None,
                score=getattr(world, "score", None),
            )
        )


def keep_reading(world: "ServedWorld", robot: "Robot", sensor: int, value: np.ndarray) -> None:
    """Keep what a sensor, by index in the suite, has measured until it is reported."""
    robot.pending[sensor] = value
    if world.recorder is not None:
        world.recorder.read(robot.slot, sensor, value)


def orders_of(state: "GroupState", world: int) -> dict[str, Any]:
    """Return what a group's robots of a world of a batch have been told; leading axis over robots.

    Args:
        state: The group in all worlds (worlds, robots, ...).
        world: Index of the world.
    """
    return {
        name: jax.tree.map(lambda x: np.asarray(x)[world], getattr(state, name)) for name in ORDER_FIELDS
    }
