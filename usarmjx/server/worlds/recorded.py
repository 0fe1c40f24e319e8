"""What served worlds tell their recorders, and what they were made of."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links
from usarmjx.recording.file import RecordingFile
from usarmjx.recording.inputs import SINGLE, WorldSetup, versions
from usarmjx.recording.recorder import WorldRecorder, WorldSnapshot

if TYPE_CHECKING:
    import mujoco

    from usarmjx.engines.base import PhysicsState
    from usarmjx.server.worlds.robot import Robot
    from usarmjx.server.worlds.served_world import ServedWorld


def record_worlds(
    worlds: "Sequence[ServedWorld]", path: Path, radio: RadioSettings | None = None
) -> RecordingFile:
    """Record served worlds, from now on, in a file that is to be closed at the end.

    Args:
        worlds: The worlds.
        path: The file.
        radio: Constants of the radio that their server has; None: links are kept of worlds with a radio of
            their own only.

    Raises:
        UsageError: The file is there already.
        WriteError: It cannot be written.
    """
    about = {**versions(), "arenas": ", ".join(dict.fromkeys(world.arena.name for world in worlds))}
    file = RecordingFile(path, about, several=len(worlds) > 1)
    for number, world in enumerate(worlds):
        world.recorder = WorldRecorder(file, world.setup(), number, radio=radio)
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
            WorldSnapshot(
                scene=world.scene,
                world=state,
                physics=seen,
                names={slot: robot.name for slot, robot in world.robots.items()},
                trace=world.traces.sketch() if world.traces.points else None,
                score=getattr(world, "score", None),
                links=_links(world, recorder.radio),
            )
        )


def _links(world: "ServedWorld", radio: RadioSettings | None) -> Links | None:
    """Return the links of robots that have their radio by the server."""
    if radio is None or world.scene.radio is not None or len(world.robots) < 2:
        return None
    return world.links(radio)


def keep_reading(world: "ServedWorld", robot: "Robot", sensor: int, value: np.ndarray) -> None:
    """Keep what a sensor, by index in the suite, has measured until it is reported."""
    robot.pending[sensor] = value
    robot.latest[sensor] = world.time, value
    if world.recorder is not None:
        world.recorder.read(robot.slot, sensor, value)
