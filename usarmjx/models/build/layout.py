"""Names to indices, once: where a robot's bodies, joints and actuators lie in the compiled model."""

from dataclasses import dataclass

import mujoco

from usarmjx.models.build.parts import joint_names, parts_of
from usarmjx.models.spec.robot import HOLD, RobotSpec

Ids = tuple[int, ...]


@dataclass(frozen=True)
class RobotIndex:
    """Indices of one robot in an MjModel.

    Bodies are in the order chassis, then parts (`models.build.parts.parts_of`); joints in that order without
    the chassis; actuators likewise, but only of the parts with a motor.

    Attributes:
        body: Body ids.
        root_qpos: Where the free joint's 7 numbers start in qpos.
        root_dof: Where its 6 numbers start in qvel.
        qpos: qpos addresses of the joints.
        dof: qvel addresses of the joints.
        actuator: Ids of the actuators that pull towards a target.
        activation: Addresses of their activations: the targets.
        hold: Ids of the actuators that hold the joints; input 1, or 0 for a torque order.
    """

    body: Ids
    root_qpos: int
    root_dof: int
    qpos: Ids
    dof: Ids
    actuator: Ids
    activation: Ids
    hold: Ids


def index_robot(model: mujoco.MjModel, robot: RobotSpec, prefix: str) -> RobotIndex:
    """Resolve the names of the robot that was composed with `prefix`."""
    names = [prefix + name for name in joint_names(robot)]
    joints = [model.joint(name) for name in names]
    motors = [prefix + part.name for part in parts_of(robot) if part.motor is not None]
    pulls = [model.actuator(name).id for name in motors]
    return RobotIndex(
        body=(model.body(f"{prefix}chassis").id, *(model.body(name).id for name in names)),
        root_qpos=int(model.joint(f"{prefix}root").qposadr[0]),
        root_dof=int(model.joint(f"{prefix}root").dofadr[0]),
        qpos=tuple(int(joint.qposadr[0]) for joint in joints),
        dof=tuple(int(joint.dofadr[0]) for joint in joints),
        actuator=tuple(pulls),
        activation=tuple(int(model.actuator_actadr[pull]) for pull in pulls),
        hold=tuple(model.actuator(name + HOLD).id for name in motors),
    )
