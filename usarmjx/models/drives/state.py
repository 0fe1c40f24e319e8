"""Where a robot is and how it moves, as drives and sensors see it."""

from flax import struct

from usarmjx.base.arrays import Array


class RobotState(struct.PyTreeNode, kw_only=True):
    """Where a robot is and how it moves.

    Attributes:
        pos: Chassis origin in the world [m] (3,).
        quat: Chassis orientation, w first (4,).
        linear: Velocity of the chassis origin, world axes [m/s] (3,).
        angular: Angular velocity, chassis axes [rad/s] (3,).
        joint_pos: Joint positions in the order of `models.build.parts.parts_of` [rad or m] (joints,).
        joint_vel: Joint velocities [rad/s or m/s] (joints,).
    """

    pos: Array
    quat: Array
    linear: Array
    angular: Array
    joint_pos: Array
    joint_vel: Array
