"""Indices of a robot's bodies, joints and actuators in the compiled model, looked up by name once."""

from dataclasses import dataclass

import mujoco

from usarmjx.models.compile.parts import joint_names, parts_of
from usarmjx.models.types.robot import HOLD_SUFFIX, RobotSpec

Ids = tuple[int, ...]
"""Indices of a robot's items, in the order of `RobotIndex`."""


@dataclass(frozen=True)
class RobotIndex:
    """Indices of one robot in an MjModel.

    Bodies are in the order chassis, then parts (`models.compile.parts.parts_of`); joints in that order
    without the chassis; actuators likewise, but only of the parts with a motor.

    Attributes:
        body_ids: Body ids.
        root_qposadr: Address of the free joint's 7 numbers in qpos.
        root_dofadr: Address of its 6 numbers in qvel.
        qposadr: qpos addresses of the joints.
        dofadr: qvel addresses of the joints.
        actuator_ids: Ids of the actuators that pull towards a target.
        actadr: Addresses of their activations: the targets.
        hold_actuator_ids: Ids of the actuators that hold the joints; input 1, or 0 in torque mode.
    """

    body_ids: Ids
    root_qposadr: int
    root_dofadr: int
    qposadr: Ids
    dofadr: Ids
    actuator_ids: Ids
    actadr: Ids
    hold_actuator_ids: Ids


def index_robot(model: mujoco.MjModel, robot: RobotSpec, prefix: str) -> RobotIndex:
    """Resolve the names of the robot that was composed with `prefix`."""
    names = [prefix + name for name in joint_names(robot)]
    joints = [model.joint(name) for name in names]
    motors = [prefix + part.name for part in parts_of(robot) if part.motor is not None]
    pulls = [model.actuator(name).id for name in motors]
    return RobotIndex(
        body_ids=(model.body(f"{prefix}chassis").id, *(model.body(name).id for name in names)),
        root_qposadr=int(model.joint(f"{prefix}root").qposadr[0]),
        root_dofadr=int(model.joint(f"{prefix}root").dofadr[0]),
        qposadr=tuple(int(joint.qposadr[0]) for joint in joints),
        dofadr=tuple(int(joint.dofadr[0]) for joint in joints),
        actuator_ids=tuple(pulls),
        actadr=tuple(int(model.actuator_actadr[pull]) for pull in pulls),
        hold_actuator_ids=tuple(model.actuator(name + HOLD_SUFFIX).id for name in motors),
    )
