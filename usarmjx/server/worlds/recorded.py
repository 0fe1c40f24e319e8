"""Recording of served worlds: their initial inputs, steps and readings."""

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
    worlds: "Sequence[ServedWorld]",
    path: Path,
    radio: RadioSettings | None = None,
    max_lag: float | None = None,
) -> RecordingFile:
    """Record served worlds, from now on, in a file that the caller closes at the end.

    Args:
        worlds: The worlds.
        path: The file.
        radio: Constants of the server's radio; None: links are recorded only of worlds with a radio of
            their own.
        max_lag: Age from which frames are left out [s], for worlds that keep up with a clock; None: all are
            written.

    Raises:
        UsageError: The file exists already.
        WriteError: It cannot be written.
    """
    about = {**versions(), "arenas": ", ".join(dict.fromkeys(world.arena.name for world in worlds))}
    file = RecordingFile(path, about, several=len(worlds) > 1, max_lag=max_lag)
    for number, world in enumerate(worlds):
        world.recorder = WorldRecorder(file, world.setup(), number, radio=radio)
    return file


def single_setup(world: "ServedWorld", origin: tuple[int, int, int]) -> WorldSetup:
    """Return the inputs of a world of engine `c`: seed, number and capacity."""
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
    """Record a control step, if the world is recorded.

    Args:
        world: The world.
        physics: Its physics, with all digits.
        time: Simulated time [s]; None: the world's own, which a batch updates only later.
    """
    recorder = world.recorder
    if recorder is None:
        return
    qpos, qvel, act = (np.asarray(one) for one in (physics.qpos, physics.qvel, physics.act))
    recorder.stepped(world.time if time is None else time, qpos, qvel, act)
    # The snapshot is made only for frames: it fetches the whole world from the device.
    if recorder.frame_is_due:
        state, seen = world.one_world()
        recorder.record_frame(
            WorldSnapshot(
                scene=world.scene,
                world=state,
                physics=seen,
                names={slot: robot.name for slot, robot in world.robots.items()},
                trace=world.traces.sketch() if world.traces.points else None,
                # By name: `policy_world`, whose worlds alone have a score, imports this module.
                score=getattr(world, "score", None),
                links=_links(world, recorder.radio),
            )
        )


def _links(world: "ServedWorld", radio: RadioSettings | None) -> Links | None:
    """Return the links of robots whose radio is the server's."""
    # A world with a radio of its own has its links in its state already.
    # One robot alone has no link, either.
    if radio is None or world.scene.radio is not None or len(world.robots) < 2:
        return None
    return world.links(radio)


def store_reading(
    world: "ServedWorld", robot: "Robot", sensor: int, value: np.ndarray, time: float | None = None
) -> None:
    """Store the reading of a sensor, by index in the suite, for the next report.

    Args:
        world: The world.
        robot: The robot.
        sensor: Index of its sensor.
        value: The reading.
        time: Time of the world, if it is known already [s].
    """
    robot.pending[sensor] = value
    robot.latest[sensor] = world.time if time is None else time, value
    if world.recorder is not None:
        world.recorder.read(robot.slot, sensor, value)
