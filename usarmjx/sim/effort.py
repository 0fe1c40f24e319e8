"""What the servos at a robot's joints exert, from the engine's state: no engine need be asked."""

import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.models.build.body_plan import KinematicTree
from usarmjx.models.build.servos import actuated_servos
from usarmjx.models.drives.state import RobotState


def joint_efforts(plan: KinematicTree, state: RobotState, act: Array, hold: Array) -> Array:
    """Return the torque or force that acts on each joint [N m or N] (..., joints); 0 without a motor.

    Args:
        plan: Body plan of the robot class.
        state: The robots; all arguments have the same leading axes (...,).
        act: Activations of their pulling actuators (..., actuators).
        hold: Inputs of their holding actuators (..., actuators).
    """
    here, servos = actuated_servos(plan)
    pos, vel = state.joint_pos[..., here], state.joint_vel[..., here]
    wanted = servos.stiffness * act - hold * (servos.stiffness * pos + servos.damping * vel)
    most = servos.stiffness * np.maximum(servos.windup_limit, servos.brake_limit)
    exerted = xp.clip(wanted, -most, most)
    places = np.zeros((len(plan.actuated), len(plan.parts) - 1), np.float32)
    places[np.arange(len(plan.actuated)), plan.actuated] = 1.0
    return exerted @ places
