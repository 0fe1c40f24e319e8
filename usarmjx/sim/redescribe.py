"""A robot whose description changes while it runs: its figures, and settings of what it carries."""

import mujoco
import numpy as np

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.models.build.compose import add_robot, chassis_shapes, remove_robot
from usarmjx.models.build.layout import RobotIndex, index_robot
from usarmjx.models.build.parts import joint_names, parts_of
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.suite import suite_of
from usarmjx.sim.robot_group import prefix_of
from usarmjx.sim.scene import parking_position
from usarmjx.sim.single_world import SingleWorld


def redescribe(world: SingleWorld, slot: int, robot: RobotSpec) -> None:
    """Give a robot another description; where it is, how it moves and what it was told stay.

    Args:
        world: The world.
        slot: The robot.
        robot: The description: the same parts, sensors, cameras and effecters, with other figures.

    Raises:
        UsageError: It has other parts or sensors than the robot, or a setting that is wrong.
        SpecError: MuJoCo cannot build it, or settings do not go together. Nothing has changed after either.
    """
    before = world.roster[slot].spec
    if _names(robot) != _names(before):
        raise UsageError(f"a running {before.name} keeps its parts and what it carries")
    suite_of(robot)  # raises what is wrong with a setting
    if _solids(robot) == _solids(before):
        world.replace_robot(slot, robot)
        return
    present = before
    try:
        _rebuild(world, slot, before, robot)
        present = robot
    finally:
        world.replace_robot(slot, present)


def _names(robot: RobotSpec) -> object:
    mounts = (robot.sensors, robot.cameras, robot.effecters)
    names = [[(mount.kind, mount.name, mount.parent) for mount in some] for some in mounts]
    return joint_names(robot), [part.motor is None for part in parts_of(robot)], robot.drive.keys, names


def _solids(robot: RobotSpec) -> object:
    """Return what of a class is in the model, and a little more."""
    return chassis_shapes(robot), parts_of(robot)


def _rebuild(world: SingleWorld, slot: int, before: RobotSpec, after: RobotSpec) -> None:
    """Build a robot's solids and motors anew where it is."""
    engine, prefix = world.engine, prefix_of(slot)
    place = parking_position(world.scene.arena, slot)

    def put(robot: RobotSpec, spec: mujoco.MjSpec) -> None:
        if spec.body(f"{prefix}chassis") is not None:
            remove_robot(spec, prefix)
        add_robot(spec, robot, prefix, place)

    def rows(robot: RobotSpec) -> list[tuple[np.ndarray, list[int]]]:
        """Return what of the robot's is in the engine's state now, with its places in there."""
        index, data = index_robot(engine.model, robot, prefix), engine.data
        dofs, pulls = _dofs(index), [*index.actuator_ids, *index.hold_actuator_ids]
        free = [*range(index.root_qposadr, index.root_qposadr + 7), *index.qposadr]
        return [
            (data.qpos, free),
            (data.qvel, dofs),
            (data.qacc_warmstart, dofs),
            (data.act, list(index.actadr)),
            (data.ctrl, pulls),
        ]

    values = [array[places].copy() for array, places in rows(before)]
    present = before
    try:
        engine.edit(lambda spec: put(after, spec), lambda spec: put(before, spec))
        present = after
    except ValueError as error:  # of MuJoCo
        raise SpecError(f"a {before.name} cannot be built so: {error}") from error
    finally:
        for (array, places), value in zip(rows(present), values, strict=True):
            array[places] = value
        mujoco.mj_kinematics(engine.model, engine.data)


def _dofs(index: RobotIndex) -> list[int]:
    return [*range(index.root_dofadr, index.root_dofadr + 6), *index.dofadr]
